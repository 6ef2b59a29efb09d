//! The web page of `spherecal serve` and `spherecal run --serve`: runs in progress, and past
//! calibrations with their trend.
//!
//! | path | what |
//! |---|---|
//! | `/` | the page; it asks this server for everything and no other |
//! | `/api/live` | server-sent events: a [`ViewerMessage`](crate::live::ViewerMessage) each, with the run's `id` |
//! | `/api/history` | past calibrations of each arm, with their trend, as JSON |
//! | `/report/RUN` | the report of a stored run |
//!
//! The page is served on the port of the services. If the server has a token, the page asks for it
//! once and keeps a cookie. Without a token the server answers only requests for a local name of
//! this machine, so that a page of another site cannot reach it through a name that points here.

mod gate;
mod history;
mod report;

use std::convert::Infallible;
use std::sync::{Arc, PoisonError};

use axum::extract::State;
use axum::http::header::{CACHE_CONTROL, CONTENT_SECURITY_POLICY, CONTENT_TYPE, X_CONTENT_TYPE_OPTIONS};
use axum::http::{HeaderName, StatusCode};
use axum::response::sse::{Event, KeepAlive, Sse};
use axum::response::{IntoResponse, Response};
use axum::routing::{get, post};
use axum::{Router, middleware};
use tokio::sync::broadcast::error::RecvError;
use tokio::sync::mpsc;
use tokio_stream::wrappers::ReceiverStream;

use crate::live::Hub;
use crate::{Guard, SharedStore};
use report::Reports;
use spherecal_budget::services::EVENTS;
use spherecal_store::{CalibrationStore, StoreError};

pub use report::{ReportError, ReportReader, ReportWriter};

/// What a page shows.
#[derive(Clone, Default)]
pub struct Page {
    /// Runs that go on.
    pub hub: Arc<Hub>,
    /// Past calibrations; none are shown without it.
    pub store: Option<SharedStore>,
    /// Writes the report of a stored run; without it no report is shown.
    pub report: Option<ReportReader>,
}

/// What every request needs.
struct RequestContext {
    page: Page,
    reports: Reports,
    guard: Guard,
}

/// The page's paths, guarded.
pub(crate) fn router(page: Page, guard: Guard) -> Router {
    let site = Arc::new(RequestContext {
        page,
        reports: Reports::default(),
        guard,
    });
    Router::new()
        .route(
            "/",
            get(async || file("text/html; charset=utf-8", include_str!("page.html"))),
        )
        .route("/api/live", get(live))
        .route("/api/history", get(history::history))
        .route("/report/{run}", get(report::report))
        .route_layer(middleware::from_fn_with_state(Arc::clone(&site), gate::admit))
        // The files needed to log in, and pages that reveal nothing.
        .route("/login", post(gate::login))
        .route(
            "/page.css",
            get(async || file("text/css; charset=utf-8", include_str!("page.css"))),
        )
        .route("/page.js", get(async || script(include_str!("page.js"))))
        .route("/plots.js", get(async || script(include_str!("plots.js"))))
        .route("/arm.js", get(async || script(include_str!("arm.js"))))
        .route("/past.js", get(async || script(include_str!("past.js"))))
        .route("/login.js", get(async || script(include_str!("login.js"))))
        .route("/icon.svg", get(icon))
        // For reports, which name no icon.
        .route("/favicon.ico", get(icon))
        .layer(middleware::from_fn_with_state(Arc::clone(&site), gate::own_name))
        .with_state(site)
}

/// What pages may load and do: only from their own server.
const POLICY: &str = "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src 'self' data:; \
                      connect-src 'self'; base-uri 'none'; form-action 'none'; frame-ancestors 'none'";

fn headers(kind: &'static str) -> [(HeaderName, &'static str); 4] {
    [
        (CONTENT_TYPE, kind),
        (CONTENT_SECURITY_POLICY, POLICY),
        (CACHE_CONTROL, "no-store"),
        (X_CONTENT_TYPE_OPTIONS, "nosniff"),
    ]
}

fn file(kind: &'static str, text: &'static str) -> Response {
    (headers(kind), text).into_response()
}

fn script(text: &'static str) -> Response {
    file("text/javascript; charset=utf-8", text)
}

async fn icon() -> Response {
    file("image/svg+xml", include_str!("icon.svg"))
}

/// A refusal as text.
fn refused(status: StatusCode, words: impl Into<String>) -> Response {
    (status, headers("text/plain; charset=utf-8"), words.into()).into_response()
}

/// Works with the store on a thread that may wait.
async fn with_store<T: Send + 'static>(
    store: &SharedStore,
    work: impl FnOnce(&mut dyn CalibrationStore) -> Result<T, StoreError> + Send + 'static,
) -> Result<T, Response> {
    let store = Arc::clone(store);
    let done = tokio::task::spawn_blocking(move || {
        // A panic in another request leaves the database at its last commit.
        work(store.lock().unwrap_or_else(PoisonError::into_inner).as_mut())
    });
    match done.await {
        Ok(Ok(value)) => Ok(value),
        Ok(Err(error)) => Err(refused(StatusCode::SERVICE_UNAVAILABLE, error.to_string())),
        Err(error) => Err(refused(StatusCode::INTERNAL_SERVER_ERROR, error.to_string())),
    }
}

/// Runs that go on, as server-sent events.
async fn live(State(site): State<Arc<RequestContext>>) -> Response {
    let (out, events) = mpsc::channel::<Result<Event, Infallible>>(EVENTS);
    let hub = Arc::clone(&site.page.hub);
    // This task follows the browser's speed; messages that the browser is too slow for are dropped.
    tokio::spawn(async move {
        'anew: while let Some((known, mut news)) = hub.listen() {
            if out.send(Ok(Event::default().event("anew").data("{}"))).await.is_err() {
                return;
            }
            for text in known {
                if out.send(Ok(Event::default().data(&*text))).await.is_err() {
                    return;
                }
            }
            loop {
                let text = tokio::select! {
                    text = news.recv() => text,
                    () = out.closed() => return,
                };
                match text {
                    Ok(text) => {
                        if out.send(Ok(Event::default().data(&*text))).await.is_err() {
                            return;
                        }
                    }
                    Err(RecvError::Lagged(_)) => continue 'anew,
                    Err(RecvError::Closed) => break 'anew,
                }
            }
        }
        let _ = out.send(Ok(Event::default().event("closed").data("{}"))).await;
    });
    Sse::new(ReceiverStream::new(events))
        .keep_alive(KeepAlive::default())
        .into_response()
}
