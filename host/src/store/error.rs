//! Why the store refused or failed.

use std::path::PathBuf;

/// What can go wrong with a database.
#[derive(Debug, thiserror::Error)]
pub enum StoreError {
    /// The file is something else.
    #[error(
        "{path}: is not a calibration database of spherecal: choose another --out folder; nothing was changed",
        path = path.display()
    )]
    NotOurs {
        /// File.
        path: PathBuf,
    },
    /// Another version wrote it.
    #[error(
        "{path}: has schema version {found}, this program reads and writes {expected}: \
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
        "{path}: is damaged ({what}): keep it, and choose another --out folder; nothing was changed",
        path = path.display()
    )]
    Damaged {
        /// File.
        path: PathBuf,
        /// What SQLite found.
        what: String,
    },
    /// There is no such file.
    #[error(
        "{path}: there is no database: give the --out folder of an earlier run, or run `spherecal run` first",
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
    /// The database failed.
    #[error("{path}: {source}: check free space and permissions, then continue with --resume", path = path.display())]
    Database {
        /// File.
        path: PathBuf,
        /// What the database said.
        source: sqlx::Error,
    },
}

impl StoreError {
    /// Whether the input is to blame (exit code 2), not the machine.
    pub fn is_input(&self) -> bool {
        !matches!(self, Self::Database { .. } | Self::Io { .. })
    }
}
