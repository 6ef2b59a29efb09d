//! Whether a folder can be written into, asked before any work.

use std::path::{Path, PathBuf};

use super::exit::CliError;

/// The nearest of `path` and the folders above it that exists.
pub(super) fn existing(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    whole
        .ancestors()
        .find(|folder| folder.exists())
        .map_or_else(|| PathBuf::from("."), Path::to_owned)
}

/// Makes a folder inside of this one, and removes it: permissions alone do not tell, for some file systems take nothing.
pub(super) fn written(folder: &Path) -> std::io::Result<()> {
    let trial = folder.join(format!(".spherecal-{}", std::process::id()));
    std::fs::create_dir(&trial)?;
    std::fs::remove_dir(&trial)
}

/// Refuses a folder of results that cannot be written.
/// Errors: the folder is a file, or cannot be made or written into.
pub(super) fn check(out: &Path) -> Result<(), CliError> {
    let folder = existing(out);
    if !folder.is_dir() {
        return Err(CliError::input(format!(
            "--out is {}, but {} is a file: give a folder",
            out.display(),
            folder.display()
        )));
    }
    written(&folder).map_err(|error| {
        CliError::input(format!(
            "--out is {}: nothing can be written into {} ({error}): give another folder",
            out.display(),
            folder.display()
        ))
    })
}
