//! The files of a result, beside the database.

use std::path::{Path, PathBuf};

use super::run_report;
use super::{Evaluation, JobError, Measurements, Summary};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_model::robots::{self, toml_file, write_kinematics_yaml, write_offsets_yaml, write_urdf};
use spherecal_report::render;

/// Paths of what was written.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// In the order in which they were written.
    pub paths: Vec<PathBuf>,
}

impl Files {
    /// Writes one file and adds it to the list.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn put(&mut self, folder: &Path, name: &str, text: &str) -> Result<(), JobError> {
        let path = folder.join(name);
        std::fs::write(&path, text).map_err(|source| JobError::Write {
            path: path.display().to_string(),
            source,
        })?;
        self.paths.push(path);
        Ok(())
    }
}

/// Writes `summary.json`, `calibrated.toml`, `calibrated.urdf`, `kinematics.yaml` and `report.html`
/// into `folder`. `traces` are the forces of the contacts; `created` is the date of the
/// measurement.
///
/// # Errors
/// A folder or file that cannot be written.
pub fn write(
    folder: &Path,
    m: &Measurements,
    e: &Evaluation,
    summary: &Summary,
    traces: &[ContactTrace],
    created: &str,
) -> Result<Files, JobError> {
    std::fs::create_dir_all(folder).map_err(|source| JobError::Write {
        path: folder.display().to_string(),
        source,
    })?;
    let mut files = Files::default();
    let text = serde_json::to_string_pretty(summary).map_err(|e| JobError::Encode {
        what: "summary.json",
        message: e.to_string(),
    })?;
    files.put(folder, "summary.json", &(text + "\n"))?;
    let nominal = robots::load(&m.config.robot)?;
    let mut model = nominal.clone();
    model.robot = e.sphere.robot.clone();
    model.tool.tcp_m = model.tcp_in_flange(e.sphere.tool.tcp_m);
    let notes = notes(m, summary);
    files.put(folder, "calibrated.toml", &toml_file::write(&model, &notes))?;
    files.put(folder, "calibrated.urdf", &write_urdf(&nominal, &model.rows(), &notes))?;
    files.put(
        folder,
        "kinematics.yaml",
        &write_kinematics_yaml(&nominal, &model.rows(), &notes),
    )?;
    files.put(
        folder,
        "offsets.yaml",
        &write_offsets_yaml(&nominal, &model.rows(), &notes),
    )?;
    let report = run_report(m, e, summary, traces, created);
    files.put(folder, "report.html", &render(&report)?)?;
    Ok(files)
}

/// The origin stated in a calibrated file.
fn notes(m: &Measurements, summary: &Summary) -> Vec<String> {
    let mut notes = vec![format!(
        "{}, calibrated by spherecal {} from {} recordings on {} spheres (seed {}, link {})",
        summary.robot,
        summary.version,
        summary.poses.recorded,
        m.spheres.len(),
        summary.seed,
        summary.link_name
    )];
    if let (Some(nominal), Some(sphere)) = (
        summary.validation.models.get("nominal"),
        summary.validation.models.get("sphere"),
    ) {
        notes.push(format!(
            "mean error {:.3} mm, with the nominal model {:.3} mm, on {} laser measurements; {}",
            sphere.arcs.mean_mm,
            nominal.arcs.mean_mm,
            summary.validation.n,
            if summary.verdict.trusted {
                "may be used"
            } else {
                "NOT TO BE TRUSTED"
            }
        ));
    }
    notes
}
