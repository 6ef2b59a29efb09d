//! The files of a calibration from files.

use std::path::Path;

use super::summary::summary_json;
use crate::write::{Results, write_results};
use crate::{Files, JobError};
use spherecal_identify::study::Study;

/// Writes a result into a directory, which is created if it is missing. `report` is the HTML of the
/// report.
///
/// # Errors
/// A directory or file that cannot be written.
pub fn write_files(study: &Study, directory: &Path, report: Option<&str>) -> Result<Files, JobError> {
    let calibration = &study.evaluation.calibration;
    write_results(
        directory,
        &Results {
            nominal: &study.model,
            evaluation: &study.evaluation,
            summary: &summary_json(study),
            origin: format!(
                "{}, calibrated by spherecal {} ({}, {} model)",
                study.model.robot.name,
                env!("CARGO_PKG_VERSION"),
                calibration.method,
                calibration.model
            ),
            report,
        },
    )
}
