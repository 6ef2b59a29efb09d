//! Why the store refused or failed.

use std::path::{Path, PathBuf};

/// A row that is not as it was written.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Damage {
    /// Number of the run.
    pub run: i64,
    /// Which row, and what is wrong with it.
    pub what: String,
}

/// What can go wrong with a database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file is something else.
    #[error(
        "{path} is not a calibration database of spherecal: choose another --out folder; nothing was changed",
        path = path.display()
    )]
    NotOurs {
        /// File.
        path: PathBuf,
    },
    /// A newer version wrote it.
    #[error(
        "{path} has schema version {found}, but this program reads versions up to {expected}: \
         use the spherecal that wrote it, or choose another --out folder; nothing was changed",
        path = path.display()
    )]
    Version {
        /// File.
        path: PathBuf,
        /// Its version.
        found: i64,
        /// The version of this program.
        expected: i64,
    },
    /// Pages of the file are damaged.
    #[error(
        "{path} is damaged ({what}): keep it, {remedy}; nothing was changed",
        path = path.display(),
        remedy = of_damage(&path.display().to_string())
    )]
    Damaged {
        /// File.
        path: PathBuf,
        /// What SQLite found.
        what: String,
    },
    /// The file was removed or replaced while it was written to.
    #[error(
        "{path} was removed or replaced by another program while it was measured into: what was recorded in this \
         session is no longer there; put the file back and continue with --resume, or measure again",
        path = path.display()
    )]
    Gone {
        /// File.
        path: PathBuf,
    },
    /// There is no such file.
    #[error(
        "there is no database at {path}: give the --out folder of an earlier run, or run `spherecal run` first",
        path = path.display()
    )]
    Missing {
        /// File.
        path: PathBuf,
    },
    /// A run is not there, or lacks something.
    #[error("{path}: {what}: {remedy}", path = path.display())]
    Absent {
        /// File.
        path: PathBuf,
        /// What is not there.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// A stored value does not decode.
    #[error("{path}: {field} does not decode ({source}): the run was written by another version", path = path.display())]
    Decode {
        /// File.
        path: PathBuf,
        /// Column.
        field: &'static str,
        /// Why.
        source: serde_json::Error,
    },
    /// The folder or file cannot be made.
    #[error("{path}: {source}: check the path and its permissions", path = path.display())]
    Io {
        /// File or folder.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// Another program holds it.
    #[error(
        "{path} is locked by another program ({what}): end that program, then continue with --resume; \
         nothing that was acknowledged is lost",
        path = path.display()
    )]
    Locked {
        /// File.
        path: PathBuf,
        /// What is held.
        what: String,
    },
    /// There is no room, or the disk fails.
    #[error(
        "{path} cannot be written ({what}): free space on the disk or repair it, then continue with \
         --resume; nothing that was acknowledged is lost",
        path = path.display()
    )]
    Full {
        /// File.
        path: PathBuf,
        /// What the database said.
        what: String,
    },
    /// A file exists where a new one is to be written.
    #[error("{path} exists already: name a file that does not exist; nothing was changed", path = path.display())]
    Exists {
        /// File.
        path: PathBuf,
    },
    /// The database failed.
    #[error("{path}: {source}: check free space and permissions, then continue with --resume", path = path.display())]
    Database {
        /// File.
        path: PathBuf,
        /// What the database said.
        source: sqlx::Error,
    },
    /// A database server cannot be used.
    #[error("{url}: {source}: check the URL, that the server runs, and that it admits this user")]
    Server {
        /// URL, without the password.
        url: String,
        /// The error of the server or of the connection.
        source: sqlx::Error,
    },
    /// A store defined outside this crate (a service) refused or failed.
    #[error("{source}")]
    Remote {
        /// What it said.
        source: Box<dyn std::error::Error + Send + Sync>,
        /// Whether the user's input is at fault.
        input: bool,
    },
    /// This program was built without the requested feature.
    #[error(
        "{what} needs the feature `{feature}`, which this program was built without: build it with --features {feature}"
    )]
    Feature {
        /// What is asked for.
        what: &'static str,
        /// Which feature brings it.
        feature: &'static str,
    },
}

/// What to do with a database that is damaged.
fn of_damage(path: &str) -> String {
    if path.contains("://") {
        return "restore it with the server's own tools, or choose another --store".to_owned();
    }
    format!(
        "save the readable data into a new file with `spherecal store recover {path} NEW.db`, or choose another --out folder"
    )
}

impl StoreError {
    /// The error of a file that cannot be read or written.
    pub(crate) fn io(path: &Path) -> impl Fn(std::io::Error) -> Self + Copy + '_ {
        |source| Self::Io {
            path: path.to_owned(),
            source,
        }
    }

    /// Sorts the database's error by the action that it needs.
    pub(super) fn of(path: &Path, source: sqlx::Error) -> Self {
        let path = path.to_owned();
        let what = source.to_string();
        // SQLite's primary result codes.
        match code(&source) {
            Some(5 | 6) => Self::Locked { path, what },
            Some(8 | 10 | 13 | 14) => Self::Full { path, what },
            Some(11 | 26) => Self::Damaged { path, what },
            _ => Self::Database { path, source },
        }
    }

    /// What happened, without the file and the remedy.
    pub(super) fn cause(&self) -> String {
        match self {
            Self::Damaged { what, .. } => what.clone(),
            Self::Database { source, .. } => source.to_string(),
            Self::Decode { field, source, .. } => format!("{field} does not decode ({source})"),
            other => other.to_string(),
        }
    }

    /// Whether the input is the cause (exit code 2), not the machine.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Remote { input, .. } => *input,
            other => !matches!(
                other,
                Self::Gone { .. }
                    | Self::Database { .. }
                    | Self::Io { .. }
                    | Self::Locked { .. }
                    | Self::Full { .. }
                    | Self::Server { .. }
            ),
        }
    }
}

/// SQLite's primary result code of an error, or of its cause.
fn code(error: &sqlx::Error) -> Option<u32> {
    let mut cause: Option<&(dyn std::error::Error + 'static)> = Some(error);
    while let Some(error) = cause {
        if let Some(code) = error
            .downcast_ref::<sqlx::Error>()
            .and_then(|e| e.as_database_error()?.code())
        {
            return code.parse::<u32>().ok().map(|extended| extended & 0xff);
        }
        cause = error.source();
    }
    None
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a damage of a server's database is told with a remedy that is for files alone.
    #[test]
    fn a_damage_is_told_with_a_remedy_that_works_there() {
        let told = |path: &str| {
            let (path, what) = (path.into(), "a row is missing".to_owned());
            StoreError::Damaged { path, what }.to_string()
        };
        assert!(told("o/calibration.db").contains("store recover o/calibration.db NEW.db"));
        let server = told("postgres://robots@db/fleet");
        assert!(
            server.contains("own tools") && !server.contains("store recover"),
            "{server}"
        );
    }
}
