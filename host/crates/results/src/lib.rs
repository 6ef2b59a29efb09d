//! The files of a calibration, whatever it was made from: `summary.json`, the calibrated robot, the
//! certificate; and what a calibration from tables says on a terminal.
//!
//! ```text
//!   study (tables), or run ─▶ Results ─▶ calibrated.toml, calibrated.urdf, .. ; summary.json; report.html
//!                         └─▶ certificate
//! ```
//!
//! It knows no run: no link, no store and no plan. So a Python module that identifies needs none of them.

mod certificate;
mod files;
mod other_robot;
mod study_files;
mod summary;
mod targets;
mod text;

pub use certificate::{CertificateSubject, certificate, hexadecimal};
pub use files::{CalibratedTexts, Files, Results, write_results};
pub use study_files::{SharedJoints, calibrated, limbs_urdf, take_slides, write_files};
pub use summary::{files_json, study_certificate, summary_json};
pub use text::summary_text;

/// A file or folder that could not be written.
#[derive(Debug, thiserror::Error)]
#[error("{path}: {source}: check the folder, its permissions and its free space")]
pub struct WriteError {
    /// File or folder.
    pub path: String,
    /// What the system said.
    pub source: std::io::Error,
}

impl WriteError {
    fn of(path: &std::path::Path) -> impl Fn(std::io::Error) -> Self + Copy + '_ {
        |source| Self {
            path: path.display().to_string(),
            source,
        }
    }
}
