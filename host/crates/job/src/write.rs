//! The files of a run.

use std::path::Path;

use super::{Evaluation, JobError, Measurements, Summary, run_report};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_model::robots;
use spherecal_report::render;
use spherecal_results::{Files, Results, write_results};

/// Writes the files of a run into `folder`; `traces` are the forces of the contacts,
/// `created` says when the run was measured.
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
    let document = serde_json::to_value(summary).map_err(|e| JobError::Encode {
        what: "summary.json",
        message: e.to_string(),
    })?;
    let nominal = robots::load(&m.config.robot)?;
    let report = render(&run_report(m, e, summary, traces, created))?;
    Ok(write_results(
        folder,
        &Results {
            nominal: &nominal,
            given_tcp_m: m.experiment().tool.tcp_m,
            evaluation: e,
            summary: &document,
            origin: format!(
                "{}{}, calibrated by spherecal {} from {} recordings on {} spheres (seed {}, link {})",
                if m.simulated() { "SIMULATED: " } else { "" },
                summary.robot,
                summary.version,
                summary.poses.recorded,
                m.spheres.len(),
                summary.seed,
                summary.link_name
            ),
            report: Some(&report),
        },
    )?)
}
