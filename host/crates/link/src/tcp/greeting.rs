//! How hosts are greeted and sent away, in lock-step and in real time.

use std::time::Instant;

use spherecal_shared::protocol::frame::{self, MAX_FRAME};

use super::TcpError;
use crate::{Device as _, LocalDevice};

/// What the peers are called.
pub(super) const WHO: &str = "the host";

/// The reason of a host that gave way.
pub(super) fn gives_way(peer: &str, heard: Instant) -> TcpError {
    TcpError::Gone {
        peer: peer.to_owned(),
        what: "it gives way to another host",
        seconds: heard.elapsed().as_secs(),
    }
}

/// The drive's hello, framed for the host.
pub(super) fn hello_frame(cell: &LocalDevice) -> Result<Vec<u8>, TcpError> {
    let mut bytes = vec![0; MAX_FRAME];
    let length = frame::encode(cell.hello(), 0, cell.now_us(), &mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}
