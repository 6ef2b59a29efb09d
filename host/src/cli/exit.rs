//! How a command ends, and whether its folder can be written.

use std::path::{Path, PathBuf};
use std::process::ExitCode;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

use spherecal_job::JobError;

/// Exit codes that other programs rely on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Exit {
    /// Done.
    Done,
    /// The job failed.
    Failed,
    /// Wrong usage or input.
    Usage,
    /// Finished, but the result must not be used.
    NotTrusted,
}

impl Exit {
    /// The process's exit code.
    pub const fn code(self) -> u8 {
        match self {
            Self::Done => 0,
            Self::Failed => 1,
            Self::Usage => 2,
            Self::NotTrusted => 3,
        }
    }
}

impl From<Exit> for ExitCode {
    fn from(exit: Exit) -> Self {
        Self::from(exit.code())
    }
}

/// Why a command ended before its time.
#[derive(Debug, thiserror::Error)]
#[error("{message}")]
pub struct CliError {
    message: String,
    exit: Exit,
}

impl CliError {
    /// The user's input is at fault.
    pub fn input(error: impl std::fmt::Display) -> Self {
        Self {
            message: error.to_string(),
            exit: Exit::Usage,
        }
    }

    /// The result must not be used.
    pub fn refused(error: impl std::fmt::Display) -> Self {
        Self {
            message: error.to_string(),
            exit: Exit::NotTrusted,
        }
    }

    /// The job failed.
    pub fn job(error: impl std::fmt::Display) -> Self {
        Self {
            message: error.to_string(),
            exit: Exit::Failed,
        }
    }

    /// This program was built without what is asked for.
    pub fn feature(what: &str, feature: &str) -> Self {
        Self::input(format!(
            "{what} needs the feature `{feature}`, which this program was built without: build it with \
             --features {feature}"
        ))
    }

    /// Adds the command to type next, where the message says to continue with `--resume`.
    #[must_use]
    pub fn with_next(mut self, command: &str) -> Self {
        if self.message.contains("--resume") {
            self.message = format!("{}\nNext: {command}", self.message);
        }
        self
    }

    /// The exit code.
    pub fn exit(&self) -> Exit {
        self.exit
    }
}

impl<E: Into<JobError>> From<E> for CliError {
    fn from(error: E) -> Self {
        let error: JobError = error.into();
        if error.is_input() {
            Self::input(error)
        } else {
            Self::job(error)
        }
    }
}

/// The error of a file or folder that cannot be written.
pub(super) fn unwritten(path: &Path) -> impl Fn(std::io::Error) -> JobError + Copy + '_ {
    |source| JobError::Write {
        path: path.display().to_string(),
        source,
    }
}

/// Ctrl-C asks to stop; a second one does not wait.
///
/// # Errors
/// The system does not let the program catch Ctrl-C.
pub fn interrupt() -> Result<Arc<AtomicBool>, CliError> {
    let flag = Arc::new(AtomicBool::new(false));
    let seen = Arc::clone(&flag);
    let handler = move || {
        if seen.swap(true, Ordering::Relaxed) {
            std::process::exit(1);
        }
    };
    match ctrlc::set_handler(handler) {
        Ok(()) | Err(ctrlc::Error::MultipleHandlers) => Ok(flag),
        Err(error) => Err(CliError::job(format!("Ctrl-C cannot be caught: {error}"))),
    }
}

/// The nearest of `path` and the folders above it that exists.
pub(super) fn existing_folder(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    whole
        .ancestors()
        .find(|folder| folder.exists())
        .map_or_else(|| PathBuf::from("."), Path::to_owned)
}

/// Makes a folder inside of this one, and removes it: permissions alone do not tell, for some file systems take nothing.
pub(super) fn try_writing(folder: &Path) -> std::io::Result<()> {
    let trial = folder.join(format!(".spherecal-{}", std::process::id()));
    std::fs::create_dir(&trial)?;
    std::fs::remove_dir(&trial)
}

/// Refuses a folder of results that cannot be written.
/// Errors: the folder is a file, or cannot be made or written into.
pub(super) fn check_writable(out: &Path) -> Result<(), CliError> {
    let folder = existing_folder(out);
    if !folder.is_dir() {
        return Err(CliError::input(format!(
            "--out is {}, but {} is a file: give a folder",
            out.display(),
            folder.display()
        )));
    }
    try_writing(&folder).map_err(|error| {
        CliError::input(format!(
            "--out is {}: nothing can be written into {} ({error}): give another folder",
            out.display(),
            folder.display()
        ))
    })
}
