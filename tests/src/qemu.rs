//! What tests with the controller in QEMU share: is there a QEMU and an image,
//! and if not, may the test be left out? And how is it run?

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::sync::OnceLock;

use spherecal::link::qemu::{LOG_FILE, Machine, Qemu, QemuOptions, find_qemu, log, qemu_arguments};
use spherecal_shared::procedure::Procedure;

use crate::bench::Bench;

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
    Ok(built(&["build", "mps2-an500"]))
}

/// The image of `board` that says its functions' stack sizes, or `None` where
/// [`image`] is.
///
/// # Panics
/// As [`image`].
pub fn stack_image(board: &str) -> Option<PathBuf> {
    image().map(|_| built(&["stack", board]))
}

/// The image of the NUCLEO-H743ZI, or `None` where [`image`] is.
///
/// # Panics
/// As [`image`].
pub fn nucleo_image() -> Option<PathBuf> {
    image().map(|_| built(&["build", "nucleo-h743zi"]))
}

/// The image of the Cortex-M4F, from the same sources, or `None` where [`image`] is.
///
/// # Panics
/// As [`image`].
pub fn m4_image() -> Option<PathBuf> {
    image().map(|_| built(&["build", "mps2-an386"]))
}

/// Runs `scripts/cross.sh` and returns the path that it says last.
fn built(arguments: &[&str]) -> PathBuf {
    let script = Path::new(env!("CARGO_MANIFEST_DIR")).join("../scripts/cross.sh");
    let built = Command::new(script).args(arguments).output().expect("a shell");
    assert!(
        built.status.success(),
        "the image does not build: {}",
        String::from_utf8_lossy(&built.stderr)
    );
    let said = String::from_utf8_lossy(&built.stdout);
    let path = said.lines().last().unwrap_or_default();
    assert!(Path::new(path).is_file(), "no image at {path:?}");
    path.into()
}

/// `image` as usual, with its logs into `folder`.
pub fn options(image: &Path, folder: &Path) -> QemuOptions {
    QemuOptions {
        image: Some(image.to_path_buf()),
        ..QemuOptions::new(folder)
    }
}

/// A configured controller in QEMU with a stand-in arm at `q` (rad).
///
/// # Panics
/// When QEMU does not start.
pub fn bench(options: &QemuOptions, q: &[f64; 7]) -> Bench<Qemu> {
    let qemu = Qemu::start(options).expect("QEMU starts");
    Bench::configured(qemu, q, 1, Procedure::default())
}

/// Ends the controller; returns its log.
///
/// # Panics
/// When there is none.
pub fn log_of(mut bench: Bench<Qemu>, folder: &Path) -> String {
    bench.controller.finish().expect("a log");
    std::fs::read_to_string(folder.join(LOG_FILE)).expect("a log")
}

/// Runs a scenario of the image, on `machine`, that needs no drive; its raw log goes to `log`
/// in `folder`.
///
/// # Panics
/// When QEMU does not run.
pub fn scenario(image: &Path, machine: Machine, name: &str, folder: &Path) -> Output {
    let log = format!("log={}", folder.join("log").display());
    Command::new(find_qemu().expect("QEMU"))
        .args(qemu_arguments(image, machine, 3, &[name.to_owned(), log]))
        .stdin(Stdio::null())
        .output()
        .expect("QEMU runs")
}

/// The decoded log of [`scenario`].
///
/// # Panics
/// When the image cannot be read.
pub fn scenario_log(image: &Path, folder: &Path) -> String {
    let elf = std::fs::read(image).expect("an image");
    log::decode(&elf, &std::fs::read(folder.join("log")).unwrap_or_default())
}

/// The whole numbers in the first line of `text` that contains `word`.
///
/// # Panics
/// When there is no such line.
pub fn numbers(text: &str, word: &str) -> Vec<u64> {
    let line = text.lines().find(|line| line.contains(word)).expect("the line");
    line.split_whitespace().filter_map(|word| word.parse().ok()).collect()
}
