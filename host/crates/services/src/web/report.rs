//! The report of a stored run, written on request.

use std::collections::VecDeque;
use std::sync::Arc;
use std::time::Instant;

use axum::body::Bytes;
use axum::extract::{Path, State};
use axum::http::StatusCode;
use axum::response::{IntoResponse, Response};
use tokio::sync::Mutex;

use super::{RequestContext, headers, refused, with_store};
use spherecal_budget::services::{REPORT, REPORTS};
use spherecal_store::{CalibrationStore, RunInfo};

/// Why a report could not be written.
pub type ReportError = Box<dyn std::error::Error + Send + Sync>;

/// Writes a page from what was read.
pub type ReportWriter = Box<dyn FnOnce() -> Result<String, ReportError> + Send>;

/// Reads the input of the report of a stored run. Everything after that works without the store.
pub type ReportReader =
    Arc<dyn Fn(&mut dyn CalibrationStore, &RunInfo) -> Result<ReportWriter, ReportError> + Send + Sync>;

/// A report that was written. All its responses share it.
struct Kept {
    run: i64,
    page: Bytes,
    /// Until when it is shown again; for ever if none. A run in progress will have another report later.
    until: Option<Instant>,
}

/// Reports that were already written. One lock guards them, so one report is written at a time.
#[derive(Default)]
pub(super) struct Reports(Mutex<VecDeque<Kept>>);

pub(super) async fn report(State(site): State<Arc<RequestContext>>, Path(run): Path<String>) -> Response {
    let Ok(run) = run.parse::<i64>() else {
        return refused(StatusCode::NOT_FOUND, format!("\"{run}\" is no number of a run\n"));
    };
    let Some(store) = &site.page.store else {
        return refused(StatusCode::NOT_FOUND, "this server has no store\n");
    };
    let Some(read) = site.page.report.clone() else {
        return refused(StatusCode::NOT_FOUND, "this server writes no reports\n");
    };
    let mut kept = site.reports.0.lock().await;
    kept.retain(|kept| kept.until.is_none_or(|until| Instant::now() < until));
    if let Some(kept) = kept.iter().find(|kept| kept.run == run) {
        return (headers("text/html; charset=utf-8"), kept.page.clone()).into_response();
    }
    let found = with_store(store, move |store| {
        Ok(store.find_run(run)?.map(|info| {
            let complete = info.state == "complete";
            (complete, read(store, &info))
        }))
    })
    .await;
    let (complete, material) = match found {
        Ok(Some(found)) => found,
        Ok(None) => return refused(StatusCode::NOT_FOUND, format!("there is no run {run} here\n")),
        Err(refusal) => return refusal,
    };
    // Identification takes a second, without the store.
    let written = tokio::task::spawn_blocking(move || material.and_then(|write| write())).await;
    match written {
        Ok(Ok(page)) => {
            let page = Bytes::from(page);
            kept.push_back(Kept {
                run,
                page: page.clone(),
                until: (!complete).then(|| Instant::now() + REPORT),
            });
            if kept.len() > REPORTS {
                kept.pop_front();
            }
            (headers("text/html; charset=utf-8"), page).into_response()
        }
        Ok(Err(error)) => refused(StatusCode::CONFLICT, format!("run {run} has no report: {error}\n")),
        Err(error) => refused(StatusCode::INTERNAL_SERVER_ERROR, error.to_string()),
    }
}
