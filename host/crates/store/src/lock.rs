//! One program measures into a database at a time.

use std::fs::{File, OpenOptions, TryLockError};
use std::io::{Error, ErrorKind};
use std::path::Path;

use super::{SqlStore, StoreError};

/// The right to measure into a database. It is released when it is dropped, and by the system when
/// the program dies.
#[derive(Debug)]
pub struct Claim {
    _file: File,
}

impl SqlStore {
    /// Claims the database at `path` for measuring.
    ///
    /// A separate file beside the database carries the lock. For a database that is a symbolic link,
    /// it lies beside the file that the link leads to, so all names of one file share one lock. A
    /// symbolic link in the place of the lock is refused. A lock on the database itself would be
    /// lost whenever this process closes a handle of it.
    ///
    /// # Errors
    /// When another program has the lock, or the file cannot be created.
    pub fn claim(path: &Path) -> Result<Claim, StoreError> {
        let file = std::fs::canonicalize(path)
            .unwrap_or_else(|_| path.to_owned())
            .with_extension("lock");
        let io = StoreError::io(&file);
        if let Some(folder) = file.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        let lock = open_lock(&file).map_err(io)?;
        match lock.try_lock() {
            Ok(()) => Ok(Claim { _file: lock }),
            Err(TryLockError::WouldBlock) => Err(StoreError::Locked {
                path: path.to_owned(),
                what: "another spherecal is measuring into it".to_owned(),
            }),
            Err(TryLockError::Error(source)) => Err(io(source)),
        }
    }
}

/// Opens or creates the lock's file without changing its bytes, and never through a symbolic link.
fn open_lock(file: &Path) -> std::io::Result<File> {
    let mut options = OpenOptions::new();
    options.write(true);
    loop {
        match std::fs::symlink_metadata(file) {
            Ok(there) if !there.is_file() => {
                return Err(Error::new(
                    ErrorKind::InvalidInput,
                    "the lock is a symbolic link or no regular file: remove it",
                ));
            }
            Ok(there) => {
                let lock = options.open(file)?;
                if same_file(&there, &lock.metadata()?) {
                    return Ok(lock);
                }
                // It was replaced between the two calls.
            }
            Err(error) if error.kind() == ErrorKind::NotFound => match options.clone().create_new(true).open(file) {
                Err(error) if error.kind() == ErrorKind::AlreadyExists => {}
                opened => return opened,
            },
            Err(error) => return Err(error),
        }
    }
}

/// Device and number of a file; `None` where the system has none.
pub(super) fn identity(path: &Path) -> Option<(u64, u64)> {
    #[cfg(unix)]
    {
        use std::os::unix::fs::MetadataExt as _;
        std::fs::metadata(path).ok().map(|file| (file.dev(), file.ino()))
    }
    #[cfg(not(unix))]
    {
        let _ = path;
        None
    }
}

#[cfg(unix)]
fn same_file(a: &std::fs::Metadata, b: &std::fs::Metadata) -> bool {
    use std::os::unix::fs::MetadataExt as _;
    (a.dev(), a.ino()) == (b.dev(), b.ino())
}

#[cfg(not(unix))]
fn same_file(_: &std::fs::Metadata, _: &std::fs::Metadata) -> bool {
    true
}

#[cfg(all(test, unix))]
mod tests {
    use super::*;
    use std::os::unix::fs::symlink;

    // Fails if a lock that is a symbolic link changes the file that it leads to, or if a lock
    // empties its own file.
    #[test]
    fn a_lock_is_never_a_link() {
        let folder = tempfile::tempdir().expect("a folder");
        let precious = folder.path().join("precious");
        std::fs::write(&precious, "precious").expect("written");
        let lock = folder.path().join("calibration.lock");
        symlink(&precious, &lock).expect("linked");
        let error = SqlStore::claim(&folder.path().join("calibration.db")).expect_err("refused");
        assert!(error.to_string().contains("symbolic link"), "{error}");
        assert_eq!(std::fs::read_to_string(&precious).expect("read"), "precious");
        std::fs::remove_file(&lock).expect("removed");
        SqlStore::claim(&folder.path().join("calibration.db")).expect("free");
    }

    // Fails if a link to a database has another lock than the database.
    #[test]
    fn a_linked_database_has_one_lock() {
        let folder = tempfile::tempdir().expect("a folder");
        let path = folder.path().join("calibration.db");
        drop(SqlStore::create_or_open(&path).expect("made"));
        let other = folder.path().join("elsewhere");
        std::fs::create_dir(&other).expect("made");
        symlink(&path, other.join("other.db")).expect("linked");
        let _claim = SqlStore::claim(&other.join("other.db")).expect("free");
        assert!(matches!(SqlStore::claim(&path), Err(StoreError::Locked { .. })));
    }
}
