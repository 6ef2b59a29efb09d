//! One open connection of the server: when it last spoke, and how it is closed.

use std::net::IpAddr;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};
use std::sync::{Mutex, PoisonError};
use std::time::{Duration, Instant};

use tokio::sync::oneshot;

use spherecal_budget::services::LATE;

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
