//! Files that a user names: regular files only, and no larger than is stated.
//!
//! A path may be a symbolic link; what it leads to must be a regular file.
//! Directories, pipes, sockets and devices are refused before they are opened:
//! a pipe would block, and `/dev/zero` never ends.

use std::fs::{File, Metadata};
use std::io::Read as _;
use std::path::Path;

use crate::encoding::{EncodingError, decode};
use crate::printable;

/// Why a file was not read.
#[derive(Debug, thiserror::Error)]
pub enum FileError {
    /// There is no such file.
    #[error("{}: there is no such file: check the path", printable(path))]
    Missing {
        /// File.
        path: String,
    },
    /// The user may not read it.
    #[error("{}: this user may not read it: check its permissions", printable(path))]
    Permission {
        /// File.
        path: String,
    },
    /// The system failed.
    #[error("{}: cannot be read: {source}", printable(path))]
    Read {
        /// File.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Not a regular file.
    #[error("{}: is {kind}: {remedy}", printable(path))]
    NotRegular {
        /// File.
        path: String,
        /// What it is.
        kind: &'static str,
        /// What to give instead.
        remedy: &'static str,
    },
    /// Larger than is read.
    #[error("{}: is {} long; at most {} are read: {remedy}", printable(path), size(*bytes), size(*limit))]
    TooLarge {
        /// File.
        path: String,
        /// Its size, in bytes.
        bytes: u64,
        /// The most that is read, in bytes.
        limit: u64,
        /// What to give instead.
        remedy: &'static str,
    },
    /// Not text.
    #[error("{}: {source}", printable(path))]
    Encoding {
        /// File.
        path: String,
        /// What it is instead.
        source: EncodingError,
    },
}

impl FileError {
    /// What the system's refusal means.
    pub(crate) fn system(path: &str, source: std::io::Error) -> Self {
        let path = path.to_owned();
        match source.kind() {
            std::io::ErrorKind::NotFound => Self::Missing { path },
            std::io::ErrorKind::PermissionDenied => Self::Permission { path },
            _ => Self::Read { path, source },
        }
    }
}

/// A number of bytes for people.
fn size(bytes: u64) -> String {
    match bytes {
        0..1024 => format!("{bytes} bytes"),
        1024..1_048_576 => format!("{:.1} KiB", bytes as f64 / 1024.0),
        1_048_576..1_073_741_824 => format!("{:.1} MiB", bytes as f64 / 1_048_576.0),
        _ => format!("{:.1} GiB", bytes as f64 / 1_073_741_824.0),
    }
}

/// What a path leads to, where that is not a regular file.
fn special(metadata: &Metadata) -> Option<(&'static str, &'static str)> {
    let kind = metadata.file_type();
    if kind.is_file() {
        return None;
    }
    if kind.is_dir() {
        return Some(("a directory", "name a file in it"));
    }
    #[cfg(unix)]
    {
        use std::os::unix::fs::FileTypeExt as _;
        if kind.is_fifo() {
            return Some(("a pipe", "save its content as a file first"));
        }
        if kind.is_socket() {
            return Some(("a socket", "name a regular file"));
        }
    }
    Some(("a device", "name a regular file"))
}

/// Opens a regular file of at most `limit` bytes; returns it with its size.
/// `remedy` says what to do with a larger one.
///
/// # Errors
/// A file that is missing, not readable, not regular or too large.
pub fn open_regular(path: &Path, limit: u64, remedy: &'static str) -> Result<(File, u64), FileError> {
    let name = path.display().to_string();
    let failed = |source| FileError::system(&name, source);
    let check = |metadata: &Metadata| {
        if let Some((kind, remedy)) = special(metadata) {
            return Err(FileError::NotRegular {
                path: name.clone(),
                kind,
                remedy,
            });
        }
        if metadata.len() > limit {
            return Err(FileError::TooLarge {
                path: name.clone(),
                bytes: metadata.len(),
                limit,
                remedy,
            });
        }
        Ok(metadata.len())
    };
    check(&std::fs::metadata(path).map_err(failed)?)?;
    let file = File::open(path).map_err(failed)?;
    // The file that was opened may be another than the one that was looked at.
    let bytes = check(&file.metadata().map_err(failed)?)?;
    Ok((file, bytes))
}

/// Reads a text file of at most `limit` bytes: UTF-8 with or without a byte order
/// mark, or UTF-16 with one.
///
/// # Errors
/// What [`open_regular`] refuses; a file that grows beyond `limit` meanwhile;
/// bytes that are not text.
pub fn read_text(path: &Path, limit: u64, remedy: &'static str) -> Result<String, FileError> {
    let name = path.display().to_string();
    let (file, expected) = open_regular(path, limit, remedy)?;
    let mut bytes = Vec::with_capacity(usize::try_from(expected).unwrap_or_default());
    file.take(limit + 1)
        .read_to_end(&mut bytes)
        .map_err(|source| FileError::system(&name, source))?;
    if bytes.len() as u64 > limit {
        return Err(FileError::TooLarge {
            path: name,
            bytes: bytes.len() as u64,
            limit,
            remedy,
        });
    }
    decode(&bytes).map_err(|source| FileError::Encoding { path: name, source })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn refusal(path: &Path, limit: u64) -> String {
        read_text(path, limit, "give a smaller one").unwrap_err().to_string()
    }

    #[test]
    fn only_regular_files_of_a_stated_size_are_read() {
        let folder = tempfile::tempdir().unwrap();
        let file = folder.path().join("a.toml");
        std::fs::write(&file, "name = 1\n").unwrap();
        assert_eq!(read_text(&file, 9, "").unwrap(), "name = 1\n");
        assert!(refusal(&file, 8).ends_with("is 9 bytes long; at most 8 bytes are read: give a smaller one"));
        assert!(refusal(&folder.path().join("no.toml"), 9).ends_with("there is no such file: check the path"));
        assert!(refusal(folder.path(), 9).ends_with("is a directory: name a file in it"));
    }

    // Fails if a device or a pipe is opened: the first never ends, the second blocks.
    #[cfg(unix)]
    #[test]
    fn devices_and_pipes_are_refused_also_behind_links() {
        let folder = tempfile::tempdir().unwrap();
        for (target, words) in [
            ("/dev/zero", "is a device"),
            ("/dev/null", "is a device"),
            ("/", "is a directory"),
        ] {
            let link = folder.path().join(format!("link{}", target.replace('/', "-")));
            std::os::unix::fs::symlink(target, &link).unwrap();
            assert!(refusal(&link, 99).contains(words), "{target}");
            assert!(refusal(Path::new(target), 99).contains(words), "{target}");
        }
        let pipe = folder.path().join("pipe");
        assert!(
            std::process::Command::new("mkfifo")
                .arg(&pipe)
                .status()
                .unwrap()
                .success()
        );
        assert!(refusal(&pipe, 99).ends_with("is a pipe: save its content as a file first"));
        // A link to a regular file is read.
        let (file, link) = (folder.path().join("a"), folder.path().join("b"));
        std::fs::write(&file, "x").unwrap();
        std::os::unix::fs::symlink(&file, &link).unwrap();
        assert_eq!(read_text(&link, 9, "").unwrap(), "x");
    }

    #[test]
    fn names_are_escaped() {
        assert!(refusal(Path::new("no\u{1b}[2J.toml"), 9).starts_with("no\\u001b[2J.toml: "));
    }
}
