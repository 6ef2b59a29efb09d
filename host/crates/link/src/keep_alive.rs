//! Keep-alives, and the numbers of frames.

use std::sync::Arc;
use std::sync::atomic::{AtomicU32, Ordering};

use spherecal_shared::protocol::frame::{self, FrameError, MAX_FRAME};
use spherecal_shared::protocol::host::{Command, Downlink, SessionId};

/// Makes keep-alives for an endpoint in another thread: it has the session of the last handshake and the count of frames.
#[derive(Clone, Debug, Default)]
pub struct KeepAlives(Arc<Shared>);

#[derive(Debug, Default)]
struct Shared {
    session: AtomicU32,
    frames: AtomicU32,
}

impl KeepAlives {
    pub(super) fn begin(&self, session: SessionId) {
        self.0.session.store(u32::from_le_bytes(session), Ordering::Relaxed);
    }

    /// Appends a keep-alive to `out`; `now_us` is device time.
    ///
    /// # Errors
    /// When it does not fit a frame.
    pub fn frame(&self, now_us: u64, out: &mut Vec<u8>) -> Result<(), FrameError> {
        let session = self.0.session.load(Ordering::Relaxed).to_le_bytes();
        self.framed(&unnumbered(session, Command::KeepAlive), now_us, out)
    }

    /// Appends a message as the next frame.
    pub(super) fn framed(&self, message: &Downlink, now_us: u64, out: &mut Vec<u8>) -> Result<(), FrameError> {
        let mut bytes = [0u8; MAX_FRAME];
        let number = self.0.frames.fetch_add(1, Ordering::Relaxed);
        let length = frame::encode(message, number, now_us, &mut bytes)?;
        out.extend_from_slice(bytes.get(..length).unwrap_or(&bytes));
        Ok(())
    }
}

/// A command that has no number and is never repeated.
pub(super) fn unnumbered(session: SessionId, command: Command) -> Downlink {
    Downlink {
        session,
        sequence: 0,
        start_us: 0,
        command,
    }
}
