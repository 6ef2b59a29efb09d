//! What tests with the controller in QEMU share: is there a QEMU and an image,
//! and if not, may the test be left out?

use std::path::{Path, PathBuf};
use std::process::Command;
use std::sync::OnceLock;

/// Set in CI: what is missing is a failure there, not a reason to skip.
pub const REQUIRE_VARIABLE: &str = "SPHERECAL_REQUIRE_QEMU";

/// The controller's image, built from the sources as they are now, or `None`
/// with one line on stderr that says what is missing and what it leaves out.
///
/// # Panics
/// When something is missing and [`REQUIRE_VARIABLE`] is set, or when the image
/// does not build.
pub fn image() -> Option<PathBuf> {
    static IMAGE: OnceLock<Result<PathBuf, String>> = OnceLock::new();
    match IMAGE.get_or_init(build) {
        Ok(path) => Some(path.clone()),
        Err(why) => {
            assert!(
                std::env::var_os(REQUIRE_VARIABLE).is_none(),
                "{REQUIRE_VARIABLE} is set, but: {why}"
            );
            // Past the test harness's capture: a left-out test must be seen.
            let line = format!("left out, controller in QEMU: {why}\n");
            let _ = std::io::Write::write_all(&mut std::io::stderr(), line.as_bytes());
            None
        }
    }
}

fn build() -> Result<PathBuf, String> {
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("..");
    let script = root.join("scripts/cross.sh");
    let run = |arguments: &[&str]| Command::new(&script).args(arguments).output();
    let check = run(&["check"]).map_err(|error| format!("{}: {error}", script.display()))?;
    if !check.status.success() {
        let said = String::from_utf8_lossy(&check.stderr);
        return Err(said
            .lines()
            .last()
            .unwrap_or("scripts/cross.sh check failed")
            .to_owned());
    }
    let built = run(&["build", "mps2-an500"]).map_err(|error| error.to_string())?;
    assert!(
        built.status.success(),
        "the image does not build: {}",
        String::from_utf8_lossy(&built.stderr)
    );
    let said = String::from_utf8_lossy(&built.stdout);
    let path = said.lines().last().unwrap_or_default();
    assert!(Path::new(path).is_file(), "no image at {path:?}");
    Ok(path.into())
}
