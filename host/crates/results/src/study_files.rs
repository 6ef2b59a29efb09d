//! The files of a calibration from files.

use std::path::Path;

use nalgebra::Vector3;
use serde_json::Value;

use crate::WriteError;
use crate::files::{CalibratedTexts, Files, Results, base_of_files, calibrated_texts, write_results};
use crate::summary::summary_json;
use spherecal_identify::study::Study;
use spherecal_model::robots::frames::{compose, inverse};
use spherecal_report::Certificate;

/// Writes a result with its certificate into a directory, which is created if it is missing. `report`
/// is the HTML of the report.
///
/// # Errors
/// A directory or file that cannot be written.
pub fn write_files(
    study: &Study,
    directory: &Path,
    certificate: &Certificate,
    report: Option<&str>,
) -> Result<Files, WriteError> {
    write_results(directory, &results(study, &summary_json(study, certificate), report))
}

/// The calibrated robot as [`write_files`] writes it, without writing any file.
pub fn calibrated(study: &Study) -> CalibratedTexts {
    calibrated_texts(&results(study, &Value::Null, None))
}

/// Gives the files of a study the directions of the robot's sliding joints, in the first frame of the measurements.
pub fn take_slides(study: &mut Study, directions: &[Vector3<f64>]) {
    // The root frame of the robot's file, as the files have it.
    let root = compose(&base_of_files(&study.evaluation), &inverse(&study.model.base));
    study.model.slides = directions.iter().map(|d| root.rotation.tr_mul(d)).collect();
}

fn results<'a>(study: &'a Study, summary: &'a Value, report: Option<&'a str>) -> Results<'a> {
    let calibration = &study.evaluation.calibration;
    Results {
        nominal: &study.model,
        given_tcp_m: study.model.tool_in_table().tcp_m,
        evaluation: &study.evaluation,
        summary,
        origin: format!(
            "{}, calibrated by spherecal {} ({}, {} model)",
            study.model.robot.name,
            env!("CARGO_PKG_VERSION"),
            calibration.method,
            calibration.model
        ),
        report,
    }
}
