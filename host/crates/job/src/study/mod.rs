//! The output of a calibration from files: `summary.json`, text for the terminal, the calibrated
//! robot, the report.

mod files;
mod summary;
mod targets;
mod text;

pub use files::{calibrated, root_of_files, write_files};
pub use summary::{study_certificate, summary_json};
pub use text::summary_text;
