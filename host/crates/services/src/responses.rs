//! Responses that wait to be read.
//!
//! A client may ask and not read. Its responses stay in memory then, and HTTP/2 lets it ask for many on one connection
//! that is otherwise alive. So a server holds at most [`RESPONSES`] of them, each for at most [`RESPONSE`]; then the
//! connection is closed.

use std::collections::VecDeque;
use std::net::IpAddr;
use std::pin::Pin;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::{Duration, Instant};

use axum::body::{Body, Bytes, HttpBody};
use axum::http::header::CONTENT_TYPE;
use axum::response::Response;
use http_body::{Frame, SizeHint};
use spherecal_budget::services::{LATE, RESPONSES};
use tokio::sync::oneshot;

use crate::budget::RESPONSE;

/// A response that waits, and its connection.
struct Waiting {
    /// Ends with the response.
    body: Weak<()>,
    since: Instant,
    connection: Arc<OpenConnection>,
}

/// The responses of a server that wait to be read, oldest first.
#[derive(Default)]
pub(crate) struct Responses(Mutex<VecDeque<Waiting>>);

impl Responses {
    /// Registers a response until it is read. Where there are too many, closes the connection of the oldest.
    pub(crate) fn hold(self: Arc<Self>, response: Response, connection: Arc<OpenConnection>) -> Response {
        let streams = response
            .headers()
            .get(CONTENT_TYPE)
            .is_some_and(|kind| kind.as_bytes().starts_with(b"text/event-stream"));
        if streams || response.body().is_end_stream() {
            return response;
        }
        let held = Arc::new(());
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.retain(|one| one.body.strong_count() > 0);
        if waiting.len() >= RESPONSES
            && let Some(oldest) = waiting.pop_front()
        {
            tracing::warn!("a connection is closed: it leaves responses unread");
            oldest.connection.close();
        }
        waiting.push_back(Waiting {
            body: Arc::downgrade(&held),
            since: Instant::now(),
            connection,
        });
        drop(waiting);
        response.map(|body| Body::new(HeldBody { body, held }))
    }

    /// Closes the connections of responses that have waited for too long.
    pub(crate) fn sweep(&self) {
        let mut waiting = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        waiting.retain(|one| one.body.strong_count() > 0);
        while waiting.front().is_some_and(|oldest| oldest.since.elapsed() >= RESPONSE) {
            if let Some(oldest) = waiting.pop_front() {
                oldest.connection.close();
            }
        }
    }
}

/// A body that is counted while it waits.
struct HeldBody {
    body: Body,
    held: Arc<()>,
}

/// Bytes of a body that were handed over and wait to be sent: they may be all of it.
struct HeldBytes {
    bytes: Bytes,
    _held: Arc<()>,
}

impl AsRef<[u8]> for HeldBytes {
    fn as_ref(&self) -> &[u8] {
        &self.bytes
    }
}

impl HttpBody for HeldBody {
    type Data = Bytes;
    type Error = axum::Error;

    fn poll_frame(
        mut self: Pin<&mut Self>,
        cx: &mut Context<'_>,
    ) -> Poll<Option<Result<Frame<Self::Data>, Self::Error>>> {
        let held = Arc::clone(&self.held);
        Pin::new(&mut self.body)
            .poll_frame(cx)
            .map_ok(|frame| frame.map_data(|bytes| Bytes::from_owner(HeldBytes { bytes, _held: held })))
    }

    fn is_end_stream(&self) -> bool {
        self.body.is_end_stream()
    }

    fn size_hint(&self) -> SizeHint {
        self.body.size_hint()
    }
}

pub(crate) struct OpenConnection {
    pub(crate) peer: IpAddr,
    pub(crate) opened: Instant,
    /// Last byte in either direction, in ms after `opened`.
    pub(crate) last_ms: AtomicU64,
    /// Whether a whole request has come.
    pub(crate) proven: AtomicBool,
    /// Closes the connection when it is dropped.
    pub(crate) close: Mutex<Option<oneshot::Sender<()>>>,
}

impl OpenConnection {
    pub(crate) fn touch(&self) {
        let ms = u64::try_from(self.opened.elapsed().as_millis()).unwrap_or(u64::MAX);
        self.last_ms.store(ms, Ordering::Relaxed);
    }

    pub(crate) fn last(&self) -> Instant {
        self.opened + Duration::from_millis(self.last_ms.load(Ordering::Relaxed))
    }

    /// Whether it has sent no complete request although an honest client would have.
    pub(crate) fn is_late(&self) -> bool {
        !self.proven.load(Ordering::Relaxed) && self.opened.elapsed() > LATE
    }

    pub(crate) fn close(&self) {
        self.close.lock().unwrap_or_else(PoisonError::into_inner).take();
    }

    pub(crate) fn is_open(&self) -> bool {
        self.close.lock().unwrap_or_else(PoisonError::into_inner).is_some()
    }
}
