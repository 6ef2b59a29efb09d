//! The store: how it is opened, the results that are stored beside the recordings, and the report of a stored run.

use super::{JobError, Measurements, evaluate, read, run_report, summarise};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_report::render;
use spherecal_store::{CalibrationStore, Peer, RunInfo, SqlStore, StoreError, StoreLocation};

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
}

/// Reads the input of the report of a stored run.
///
/// # Errors
/// When the store fails, or holds unusable data.
pub fn stored_report(store: &mut dyn CalibrationStore, info: &RunInfo) -> Result<StoredReport, JobError> {
    Ok(StoredReport {
        measurements: read(store, info)?,
        traces: contact_traces(store, info.run)?,
        created_utc: info.about.created_utc.clone(),
    })
}

impl StoredReport {
    /// Identifies, judges and renders the page.
    ///
    /// # Errors
    /// Recordings from which nothing can be identified.
    pub fn render(&self) -> Result<String, JobError> {
        let evaluation = evaluate(&self.measurements, &mut |_| {})?;
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

/// Opens the store at a location: a file, created with its folder if `create` is set; a PostgreSQL
/// database, whose tables are created if there are none; or a service.
///
/// # Errors
/// The file is not a database of spherecal, has a newer version, is damaged or is not writable; the
/// server does not answer or refuses; this program was built without that kind of store.
pub fn open_store(location: &StoreLocation, create: bool) -> Result<Box<dyn CalibrationStore>, StoreError> {
    match location {
        StoreLocation::File(path) if create => Ok(Box::new(SqlStore::create_or_open(path)?)),
        StoreLocation::File(path) => Ok(Box::new(SqlStore::open(path)?)),
        StoreLocation::Postgres(url) => Ok(Box::new(SqlStore::postgres(url)?)),
        StoreLocation::Service(peer) => service(peer),
    }
}

#[cfg(feature = "services")]
fn service(peer: &Peer) -> Result<Box<dyn CalibrationStore>, StoreError> {
    let store = spherecal_services::grpc::RemoteStore::connect(peer).map_err(|error| StoreError::Remote {
        input: error.is_input(),
        source: Box::new(error),
    })?;
    Ok(Box::new(store))
}

#[cfg(not(feature = "services"))]
fn service(_peer: &Peer) -> Result<Box<dyn CalibrationStore>, StoreError> {
    Err(StoreError::Feature {
        what: "a store behind gRPC",
        feature: "services",
    })
}
