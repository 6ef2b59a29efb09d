//! The files of a calibration from files.

use std::path::Path;

use nalgebra::Vector3;
use serde_json::Value;

use crate::WriteError;
use crate::files::{
    CalibratedTexts, Files, Results, base_note, base_of_files, calibrated_texts, file_notes, write_results,
};
use crate::summary::summary_json;
use spherecal_identify::study::Study;
use spherecal_model::Pose;
use spherecal_model::robots::frames::{compose, inverse};
use spherecal_model::robots::{Limb, RobotModel, write_urdf_of_limbs};
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

/// The joints that several studies share, as they were fitted to all of their rows.
#[derive(Clone, Debug)]
pub struct SharedJoints {
    /// Their names, from the base.
    pub names: Vec<String>,
    /// Origin of each in the frame of the joint that moves before it.
    pub origins: Vec<Pose>,
    /// The base link in the frame of the measurements.
    pub base: Pose,
    /// The link on which the chains part, in the frame of the measurements, with all joints at zero.
    pub end: Pose,
    /// Median distance (m) that the fit left.
    pub left_m: f64,
}

/// The URDF of a robot of which `studies` calibrated one chain each, behind joints that they share; `whole` is the chain from
/// the base to the first tip. `None` if the geometry of no chain would be better than the nominal one. A chain alone that is
/// as good with its nominal geometry, such as a head of two joints, still gets its place on the others' trunk.
pub fn limbs_urdf(whole: &RobotModel, shared: &SharedJoints, studies: &[Study]) -> Option<String> {
    if !studies.iter().any(|study| study.evaluation.geometry.helps()) {
        return None;
    }
    let mut notes = Vec::new();
    let mut limbs = Vec::with_capacity(studies.len());
    for study in studies {
        let results = results(study, &Value::Null, None);
        let model = calibrated_texts(&results).model;
        let tip = &model.frame_names.1;
        notes.extend(file_notes(&results, &model).iter().map(|note| format!("{tip}: {note}")));
        let root = compose(&base_of_files(&study.evaluation), &inverse(&study.model.base));
        limbs.push(Limb {
            model: &study.model,
            rows: model.rows(),
            mount: compose(&inverse(&shared.end), &root),
            tcp_m: model.tool.tcp_m,
        });
    }
    if !shared.names.is_empty() {
        notes.push(format!(
            "{}: fitted to the rows of all tips by least squares (to {:.3} mm); the expected errors above are those behind \
             these joints",
            shared.names.join(", "),
            shared.left_m * 1e3
        ));
    }
    notes.push(base_note(&whole.frame_names.0, &shared.base));
    Some(write_urdf_of_limbs(whole, &shared.origins, &limbs, &notes))
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
