//! The files of a result: `summary.json`, `calibrated.toml`, `calibrated.urdf`,
//! `kinematics.yaml` and `report.html`.

use std::fmt::Write as _;
use std::path::Path;

use super::summary::summary_json;
use crate::{Files, JobError};
use spherecal_identify::study::{ModelErrors, Study, millimetres};
use spherecal_model::robots::{RobotModel, toml_file, write_kinematics_yaml, write_offsets_yaml, write_urdf};

/// What a calibrated file says of its origin.
fn notes(study: &Study) -> Vec<String> {
    let errors = |name: &str| {
        study
            .validation
            .model(name)
            .map(ModelErrors::errors)
            .unwrap_or_default()
    };
    let (nominal, calibrated) = (errors("nominal"), errors("calibrated"));
    vec![
        format!(
            "{}, calibrated by spherecal {} ({}, {} model)",
            study.loaded.model.robot.name,
            env!("CARGO_PKG_VERSION"),
            study.calibration.method,
            study.calibration.model
        ),
        format!(
            "mean error {:.3} mm, with the nominal model {:.3} mm, over {} samples ({}); {}",
            calibrated.mean_mm,
            nominal.mean_mm,
            calibrated.n,
            study.validation.by,
            if study.verdict.trusted {
                "may be used"
            } else {
                "NOT TO BE TRUSTED"
            }
        ),
        format!(
            "TCP {} mm in the flange frame {}",
            millimetres(&study.loaded.model.tcp_in_flange(study.calibration.tool.tcp_m)),
            study.loaded.model.frame_names.1
        ),
    ]
}

/// The effects that a table alone cannot contain, for the TOML file.
fn effects_toml(study: &Study) -> String {
    let c = &study.calibration;
    let list = |values: &[f64]| {
        let words: Vec<String> = values.iter().map(|v| format!("{v:?}")).collect();
        format!("[{}]", words.join(", "))
    };
    let pairs = |values: &[[f64; 2]]| {
        let words: Vec<String> = values.iter().map(|v| list(v)).collect();
        format!("[{}]", words.join(", "))
    };
    let mut out = String::from(
        "\n# Effects outside the table: q_joint = q - compliance tau + sum cos/sin harmonics.\n[calibration]\n",
    );
    let _ = writeln!(out, "method = \"{}\"", c.method);
    let _ = writeln!(out, "model = \"{}\"", c.model);
    let _ = writeln!(out, "trusted = {}", study.verdict.trusted);
    let _ = writeln!(out, "compliance_rad_per_nm = {}", list(&c.compliance_rad_per_nm));
    let _ = writeln!(out, "bending_rad_per_nm = {}", pairs(&c.bending_rad_per_nm));
    let _ = writeln!(out, "tilt_rad_per_nm = {}", list(&c.tilt_rad_per_nm));
    let harmonics: Vec<String> = c.harmonics_rad.iter().map(|h| pairs(h)).collect();
    let _ = writeln!(out, "harmonics_rad = [{}]", harmonics.join(", "));
    out
}

/// The calibrated robot with its files' frames.
fn calibrated(study: &Study) -> RobotModel {
    let mut model = study.loaded.model.clone();
    model.robot = study.calibration.robot.clone();
    model.tool.tcp_m = model.tcp_in_flange(study.calibration.tool.tcp_m);
    model
}

/// Writes a result into a directory, which is created if it is missing. `report` is the HTML of the
/// report.
///
/// # Errors
/// A directory or file that cannot be written.
pub fn write_files(study: &Study, directory: &Path, report: Option<&str>) -> Result<Files, JobError> {
    std::fs::create_dir_all(directory).map_err(|source| JobError::Write {
        path: directory.display().to_string(),
        source,
    })?;
    let notes = notes(study);
    let nominal = &study.loaded.model;
    let model = calibrated(study);
    let rows = model.rows();
    let summary = serde_json::to_string_pretty(&summary_json(study)).unwrap_or_default() + "\n";
    let toml = toml_file::write(&model, &notes) + &effects_toml(study);
    let mut files = Files::default();
    files.put(directory, "summary.json", &summary)?;
    files.put(directory, "calibrated.toml", &toml)?;
    files.put(directory, "calibrated.urdf", &write_urdf(nominal, &rows, &notes))?;
    files.put(
        directory,
        "kinematics.yaml",
        &write_kinematics_yaml(nominal, &rows, &notes),
    )?;
    files.put(directory, "offsets.yaml", &write_offsets_yaml(nominal, &rows, &notes))?;
    if let Some(html) = report {
        files.put(directory, "report.html", html)?;
    }
    Ok(files)
}
