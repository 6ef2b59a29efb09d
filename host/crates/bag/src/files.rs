//! Which files a bag is made of.

use std::io::Read as _;
use std::path::{Path, PathBuf};

use spherecal_model::{FileError, open_regular};

use super::error::BagError;
use spherecal_budget::files::BAG_FILES;

/// What to do with a file that is larger.
pub(crate) const LARGER: &str = "record the joint states and targets alone, without images and point clouds";

/// The ending of a file's name, in small letters.
fn ending(path: &Path) -> String {
    path.extension().unwrap_or_default().to_string_lossy().to_lowercase()
}

/// How a file in SQLite begins.
const SQLITE: &[u8] = b"SQLite f";

/// Whether a file of a bag is in SQLite.
pub(crate) fn is_sqlite(path: &Path) -> bool {
    ending(path) == "db3" || head(path).is_ok_and(|head| head == SQLITE)
}

/// Whether a path is meant as a bag and not as a table: a folder, a file in MCAP or SQLite, or a bag of a kind that
/// [`read_bag`](super::read_bag) refuses with the remedy.
pub fn is_bag(path: &Path) -> bool {
    if path.is_dir() || matches!(ending(path).as_str(), "mcap" | "db3" | "bag") {
        return true;
    }
    path.to_string_lossy().to_lowercase().ends_with(".mcap.zstd") || head(path).is_ok_and(|h| h == *mcap::MAGIC)
}

/// The first bytes of a regular file; fewer where it is shorter.
fn head(path: &Path) -> Result<Vec<u8>, FileError> {
    let (file, _) = open_regular(path, u64::MAX, "")?;
    let mut bytes = Vec::new();
    let read = file.take(mcap::MAGIC.len() as u64).read_to_end(&mut bytes);
    read.map_err(|source| FileError::Read {
        path: path.display().to_string(),
        source,
    })?;
    Ok(bytes)
}

/// The number behind the last `_` of a file's name; rosbag2 numbers the parts of a bag so.
fn part(path: &Path) -> Option<u64> {
    path.file_stem()?.to_str()?.rsplit_once('_')?.1.parse().ok()
}

/// The files of a bag in MCAP or SQLite, in the order in which they were recorded.
pub(crate) fn files(bag: &Path) -> Result<Vec<PathBuf>, BagError> {
    let refuse = |what: &str, remedy| BagError::Kind {
        path: bag.display().to_string(),
        what: what.to_owned(),
        remedy,
    };
    const ZSTD: &str = "unpack it with `zstd -d`, or record with `--compression-mode message`";
    if !bag.is_dir() {
        // Missing and special files are refused in the words of all files.
        let head = head(bag)?;
        return match ending(bag).as_str() {
            _ if head == *mcap::MAGIC || head == SQLITE => Ok(vec![bag.to_owned()]),
            "zstd" => Err(refuse("is a compressed file", ZSTD)),
            "db3" => Err(refuse(
                "is no bag in SQLite: it does not begin as one",
                "copy the bag again",
            )),
            "bag" => Err(refuse(
                "is a bag of ROS 1",
                "convert it with `rosbags-convert --src BAG --dst NEW --dst-storage mcap`",
            )),
            _ => Err(refuse(
                "does not begin as an MCAP file or a bag in SQLite",
                "give the bag that `ros2 bag record` writes",
            )),
        };
    }
    let entries = std::fs::read_dir(bag).map_err(|source| FileError::Read {
        path: bag.display().to_string(),
        source,
    })?;
    let all: Vec<PathBuf> = entries
        .flatten()
        .map(|entry| entry.path())
        .take(10 * BAG_FILES)
        .collect();
    let of = |kind: &str| -> Vec<PathBuf> { all.iter().filter(|path| ending(path) == kind).cloned().collect() };
    let mut files = of("mcap");
    if files.is_empty() {
        files = of("db3");
    }
    files.sort_by_key(|path| (part(path), path.clone()));
    if files.len() > BAG_FILES {
        return Err(refuse("has more than 1000 files", "split it into several bags"));
    }
    if files.is_empty() {
        let other = |kind: &str| all.iter().any(|path| ending(path) == kind);
        return Err(if other("zstd") {
            refuse("holds compressed files", ZSTD)
        } else {
            refuse(
                "is a folder without a file in MCAP or SQLite",
                "name a table of poses, or the folder of a ROS 2 bag",
            )
        });
    }
    Ok(files)
}
