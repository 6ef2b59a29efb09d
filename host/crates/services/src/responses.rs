//! Responses that wait to be read.
//!
//! A client may ask and not read. Its responses stay in memory then, and HTTP/2 lets it ask for many on one connection
//! that is otherwise alive. So a server holds at most [`RESPONSES`] of them, each for at most [`RESPONSE`]; then the
//! connection is closed.

use std::collections::VecDeque;
use std::pin::Pin;
use std::sync::{Arc, Mutex, PoisonError, Weak};
use std::task::{Context, Poll};
use std::time::Instant;

use axum::body::{Body, Bytes, HttpBody};
use axum::http::header::CONTENT_TYPE;
use axum::response::Response;
use http_body::{Frame, SizeHint};

use crate::budget::RESPONSE;
use crate::open_connection::OpenConnection;
use spherecal_budget::services::RESPONSES;

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
