//! What the system tests share: where the reference data are, and how to read them.

pub mod bench;
pub mod costs;
pub mod plan;
pub mod qemu;
pub mod stack;
pub mod worlds;

pub mod rig;

use std::path::{Path, PathBuf};

/// Path of a file under `tests/data`.
pub fn data_path(name: &str) -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("data").join(name)
}

/// A JSON file under `tests/data`, parsed.
///
/// # Panics
/// When the file is missing or does not have the shape asked for: a test that
/// has no reference must fail.
pub fn data<T: serde::de::DeserializeOwned>(name: &str) -> T {
    let path = data_path(name);
    let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()));
    serde_json::from_str(&text).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}
