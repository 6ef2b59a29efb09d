//! One program measures into a database at a time.

use std::fs::{File, TryLockError};
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
    /// A separate file beside the database carries the lock. A lock on the database itself would be
    /// lost whenever this process closes a handle of it.
    ///
    /// # Errors
    /// When another program has the lock, or the file cannot be created.
    pub fn claim(path: &Path) -> Result<Claim, StoreError> {
        let file = path.with_extension("lock");
        let io = |source| StoreError::Io {
            path: file.clone(),
            source,
        };
        if let Some(folder) = file.parent().filter(|f| !f.as_os_str().is_empty()) {
            std::fs::create_dir_all(folder).map_err(io)?;
        }
        let lock = File::create(&file).map_err(io)?;
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
