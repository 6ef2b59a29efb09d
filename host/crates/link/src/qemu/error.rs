//! Why the controller in QEMU cannot be used, or stopped.

use std::path::PathBuf;

use spherecal_shared::protocol::lockstep::MAX_HOST;

use super::names::{IMAGE_VARIABLE, PROGRAM};

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
    /// A file of the report's folder could not be made, or QEMU not started.
    #[error("{path}: {source}")]
    File {
        /// The file.
        path: PathBuf,
        /// What the system said.
        source: std::io::Error,
    },
    /// The path of the log cannot be given to the image.
    #[error(
        "the folder {path} has blanks or commas or is too long, which QEMU's arguments cannot carry: choose another"
    )]
    LogPath {
        /// The folder.
        path: PathBuf,
    },
    /// The image did not answer in time.
    #[error("the controller in QEMU did not answer for {seconds} s and was ended: see {log}")]
    Silent {
        /// How long it was waited for.
        seconds: u64,
        /// Where more is said.
        log: PathBuf,
    },
    /// The image ended.
    #[error("the controller in QEMU ended ({status}: {meaning}): see {log}{said}")]
    Ended {
        /// How QEMU exited.
        status: String,
        /// What that says of the image.
        meaning: &'static str,
        /// Where more is said.
        log: PathBuf,
        /// QEMU's own last words.
        said: String,
    },
    /// The image refused the drive.
    #[error("the controller in QEMU refuses the drive: its joints, period or protocol are not what it was built for")]
    Refused,
    /// What came back is not a turn.
    #[error("the controller in QEMU sent a turn that is not one: image and program must be of the same version")]
    Garbled,
    /// More bytes than a turn carries.
    #[error("{bytes} bytes for the controller in one control period: a turn carries {MAX_HOST}")]
    TooMuch {
        /// Bytes.
        bytes: usize,
    },
}

/// What an exit code of the image says.
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
