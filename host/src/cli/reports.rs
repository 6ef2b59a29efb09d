//! Reports of stored runs, for the web page.

use std::sync::Arc;

use crate::simulated::SimulatedCell;
use spherecal_job::stored_report;
use spherecal_services::web::{ReportReader, ReportWriter};

/// Writes the report of a stored run, for a page.
pub(super) fn stored_reports() -> ReportReader {
    Arc::new(|store, info| {
        let stored = stored_report(store, info, SimulatedCell::sound())?;
        let write: ReportWriter = Box::new(move || Ok(stored.render()?));
        Ok(write)
    })
}
