//! Results that are stored beside the recordings, and the report of a stored run.

use std::sync::Arc;

use super::run_report;
use super::{JobError, Measurements, Simulator, evaluate, read, summarise};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_report::render;
use spherecal_store::{CalibrationStore, RunInfo, StoreError};

/// Name of the contacts' force traces among a run's results.
const CONTACT_TRACES: &str = "contact_traces";

/// The stored force traces of a run's contacts; an empty list if there are none.
///
/// # Errors
/// When the store fails.
pub fn contact_traces(store: &mut dyn CalibrationStore, run: i64) -> Result<Vec<ContactTrace>, StoreError> {
    let stored = store.result(run, CONTACT_TRACES)?;
    Ok(stored
        .and_then(|json| serde_json::from_str(&json).ok())
        .unwrap_or_default())
}

/// Stores the force traces of a run's contacts.
///
/// # Errors
/// When the store fails.
pub fn put_contact_traces(store: &mut dyn CalibrationStore, run: i64, traces: &[ContactTrace]) -> Result<(), JobError> {
    let json = serde_json::to_string(traces).map_err(|e| JobError::Encode {
        what: "the force traces",
        message: e.to_string(),
    })?;
    Ok(store.put_result(run, CONTACT_TRACES, &json)?)
}

/// The input of the report of a stored run.
pub struct StoredReport {
    measurements: Measurements,
    traces: Vec<ContactTrace>,
    created_utc: String,
    simulator: Arc<dyn Simulator>,
}

/// Reads the input of the report of a stored run.
///
/// # Errors
/// When the store fails, or holds unusable data.
pub fn stored_report(
    store: &mut dyn CalibrationStore,
    info: &RunInfo,
    simulator: Arc<dyn Simulator>,
) -> Result<StoredReport, JobError> {
    Ok(StoredReport {
        measurements: read(store, info)?,
        traces: contact_traces(store, info.run)?,
        created_utc: info.created_utc.clone(),
        simulator,
    })
}

impl StoredReport {
    /// Identifies, judges and renders the page.
    ///
    /// # Errors
    /// Recordings from which nothing can be identified.
    pub fn render(&self) -> Result<String, JobError> {
        let evaluation = evaluate(&self.measurements, self.simulator.as_ref())?;
        let summary = summarise(&self.measurements, &evaluation, &self.created_utc)?;
        let report = run_report(
            &self.measurements,
            &evaluation,
            &summary,
            &self.traces,
            &self.created_utc,
        );
        Ok(render(&report)?)
    }
}
