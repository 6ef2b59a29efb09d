//! Why the controller in QEMU cannot be used, or stopped.

use std::path::PathBuf;

use spherecal_shared::protocol::lockstep::MAX_HOST;

/// Why the controller in QEMU cannot be used, or stopped.
#[derive(Debug, thiserror::Error)]
pub enum QemuError {
    /// QEMU is not installed.
    #[error(
        "{PROGRAM} not found: install it with `scripts/cross.sh --install` \
         (Debian and Ubuntu: apt-get install qemu-system-arm)"
    )]
    NoQemu,
    /// The image has not been built.
    #[error(
        "no controller image at {path}: build it with `scripts/cross.sh build mps2-an500`, \
         or name one in {IMAGE_VARIABLE}"
    )]
    NoImage {
        /// Where it was looked for.
        path: PathBuf,
    },
    /// A file in the output folder could not be created, or QEMU could not be started.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The path of the log cannot be passed to the image.
    #[error("the path {path} has blanks or commas or is too long for QEMU's arguments: choose another folder")]
    LogPath {
        /// The folder.
        path: PathBuf,
    },
    /// The image did not answer in time.
    #[error("the controller in QEMU did not answer for {seconds} s and was ended: see {log}")]
    Silent {
        /// How long it was waited for.
        seconds: u64,
        /// File with more details.
        log: PathBuf,
    },
    /// The image ended.
    #[error("the controller in QEMU ended ({status}: {meaning}): see {log}{said}")]
    Ended {
        /// How QEMU exited.
        status: String,
        /// Meaning of that status.
        meaning: &'static str,
        /// File with more details.
        log: PathBuf,
        /// The last lines of QEMU's output.
        said: String,
    },
    /// The image refused the drive.
    #[error(
        "the controller in QEMU refuses the drive: it was built for other joints, another period or another protocol"
    )]
    Refused,
    /// What came back is not a turn.
    #[error("the controller in QEMU sent a malformed message: use an image and a program of the same version")]
    Garbled,
    /// More bytes than a turn carries.
    #[error(
        "the host has {bytes} bytes for the controller in one control period, but one period carries at most {MAX_HOST}"
    )]
    TooMuch {
        /// Bytes.
        bytes: usize,
    },
}

/// Meaning of an exit code of the image.
pub(super) fn meaning(code: Option<i32>) -> &'static str {
    match code {
        Some(0) => "it was told to end",
        Some(1) => "QEMU could not run it",
        Some(2) => "it does not know the scenario",
        Some(3) => "it could not open its files",
        Some(5) => "its scenario failed",
        Some(99) => "it logged inside its own log",
        Some(100) => "a hard fault",
        Some(101) => "a panic",
        _ => "no exit code of the image",
    }
}

/// QEMU's program.
pub const PROGRAM: &str = "qemu-system-arm";
/// Environment variable that names an image.
pub const IMAGE_VARIABLE: &str = "SPHERECAL_QEMU_IMAGE";
