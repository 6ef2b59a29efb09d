//! Files that appear complete or not at all.
//!
//! A file is written under a temporary name in the same folder, written to the disk, and then
//! renamed. So a kill or a full disk leaves the file of before. The temporary file is a new one and
//! the rename replaces a symbolic link instead of following it.

use std::ffi::OsString;
use std::fs::{File, OpenOptions};
use std::io::{Error, ErrorKind, Result, Write as _};
use std::path::{Path, PathBuf};

/// How many temporary names are tried.
const ATTEMPTS: u32 = 100;

/// A file that gets its name when it is [finished](NewFile::finish). Until then it is removed when
/// this is dropped.
#[derive(Debug)]
pub struct NewFile {
    path: PathBuf,
    /// `None` for a device or a pipe, which are written directly.
    draft: Option<PathBuf>,
    file: File,
}

impl NewFile {
    /// Begins a file that will have the name `path`. A device or a pipe of this name
    /// (`/dev/stdout`) is written directly.
    ///
    /// # Errors
    /// When the temporary file cannot be made, or `path` is a folder.
    pub fn create(path: &Path) -> Result<Self> {
        if let Ok(there) = std::fs::metadata(path)
            && !there.is_file()
        {
            return Ok(Self {
                path: path.to_owned(),
                draft: None,
                file: OpenOptions::new().write(true).open(path)?,
            });
        }
        let name = path
            .file_name()
            .ok_or_else(|| Error::new(ErrorKind::InvalidInput, "the path names no file"))?;
        for attempt in 0..ATTEMPTS {
            let mut hidden = OsString::from(".");
            hidden.push(name);
            hidden.push(format!(".{}-{attempt}.new", std::process::id()));
            let draft = path.with_file_name(hidden);
            // A new file only: a symbolic link of this name is not followed.
            match OpenOptions::new().write(true).create_new(true).open(&draft) {
                Ok(file) => {
                    return Ok(Self {
                        path: path.to_owned(),
                        draft: Some(draft),
                        file,
                    });
                }
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                Err(error) => return Err(error),
            }
        }
        Err(Error::new(
            ErrorKind::AlreadyExists,
            "every temporary name of this file is taken: remove the files that end in .new",
        ))
    }

    /// A handle to write to.
    ///
    /// # Errors
    /// When the system has no handle left.
    pub fn handle(&self) -> Result<File> {
        self.file.try_clone()
    }

    /// Writes the file to the disk and gives it its name.
    ///
    /// # Errors
    /// When it cannot be written or renamed. Then the file of before stays.
    pub fn finish(mut self) -> Result<()> {
        let Some(draft) = &self.draft else {
            return Ok(());
        };
        self.file.sync_all()?;
        std::fs::rename(draft, &self.path)?;
        self.draft = None;
        Ok(())
    }
}

impl Drop for NewFile {
    fn drop(&mut self) {
        if let Some(draft) = &self.draft {
            // What is left is a hidden file that nothing reads.
            let _ = std::fs::remove_file(draft);
        }
    }
}

/// Writes a file as a whole: afterwards it has these bytes, or is what it was before.
///
/// # Errors
/// When it cannot be written.
pub fn write_file(path: &Path, bytes: impl AsRef<[u8]>) -> Result<()> {
    let new = NewFile::create(path)?;
    new.handle()?.write_all(bytes.as_ref())?;
    new.finish()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).unwrap();
        let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
        names.sort();
        names
    }

    // Fails if an unfinished file replaces the one of before, or leaves its draft.
    #[test]
    fn a_file_is_replaced_as_a_whole_or_not() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("summary.json");
        write_file(&path, "first").unwrap();
        let unfinished = NewFile::create(&path).unwrap();
        unfinished.handle().unwrap().write_all(b"sec").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "first");
        drop(unfinished);
        assert_eq!(names(folder.path()), ["summary.json"]);
        write_file(&path, "second").unwrap();
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "second");
        assert_eq!(names(folder.path()), ["summary.json"]);
        assert!(write_file(folder.path(), "x").is_err(), "a folder is no file");
    }

    // Fails if a symbolic link in the place of an output is followed.
    #[cfg(unix)]
    #[test]
    fn a_link_is_replaced_and_not_followed() {
        let folder = tempfile::tempdir().unwrap();
        let precious = folder.path().join("precious");
        std::fs::write(&precious, "precious").unwrap();
        let path = folder.path().join("report.html");
        std::os::unix::fs::symlink(&precious, &path).unwrap();
        write_file(&path, "page").unwrap();
        assert_eq!(std::fs::read_to_string(&precious).unwrap(), "precious");
        assert_eq!(std::fs::read_to_string(&path).unwrap(), "page");
    }
}
