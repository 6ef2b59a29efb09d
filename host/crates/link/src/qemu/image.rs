//! Where QEMU and the controller's image are.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};

use super::QemuError;
use super::error::{IMAGE_VARIABLE, PROGRAM};

/// Where `scripts/cross.sh build` puts the image, below the workspace.
const BUILT: &str = "target/boards/thumbv7em-none-eabihf/release/mps2-an500";

/// QEMU's program, from PATH.
pub fn find_qemu() -> Option<PathBuf> {
    let path = std::env::var_os("PATH")?;
    std::env::split_paths(&path)
        .map(|folder| folder.join(PROGRAM))
        .find(|program| program.is_file())
}

/// Finds the controller's image. Takes the image that was asked for; else the one that
/// [`IMAGE_VARIABLE`] names; else the one that the project's script has built below this folder or
/// below the folder of this program's sources.
///
/// # Errors
/// [`QemuError::NoImage`] with the path that was searched.
pub fn find_image(asked: Option<&Path>) -> Result<PathBuf, QemuError> {
    let named = std::env::var_os(IMAGE_VARIABLE);
    let found = choose(asked, named.as_deref(), std::path::Path::is_file);
    found.map_err(|path| QemuError::NoImage { path })
}

fn choose(asked: Option<&Path>, named: Option<&OsStr>, exists: impl Fn(&Path) -> bool) -> Result<PathBuf, PathBuf> {
    if let Some(path) = asked.or(named.map(Path::new)) {
        let path = path.to_path_buf();
        return if exists(&path) { Ok(path) } else { Err(path) };
    }
    let here = PathBuf::from(BUILT);
    let source = Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..").join(BUILT);
    if exists(&here) {
        Ok(here)
    } else if exists(&source) {
        Ok(source)
    } else {
        Err(here)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if an image that was asked for by name is silently replaced by another.
    #[test]
    fn what_was_asked_for_is_taken_or_missed() {
        let (asked, named) = (Path::new("a.elf"), OsStr::new("b.elf"));
        assert_eq!(choose(Some(asked), Some(named), |_| true), Ok("a.elf".into()));
        assert_eq!(choose(Some(asked), Some(named), |p| p != asked), Err("a.elf".into()));
        assert_eq!(choose(None, Some(named), |_| true), Ok("b.elf".into()));
        assert_eq!(choose(None, None, |_| false), Err(BUILT.into()));
        let text = QemuError::NoImage { path: BUILT.into() }.to_string();
        assert!(text.contains("scripts/cross.sh build mps2-an500"), "{text}");
    }
}
