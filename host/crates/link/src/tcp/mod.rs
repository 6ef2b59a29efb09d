//! Both links over TCP: drives, controllers and hosts in processes of their own.
//!
//! ```text
//!   spherecal run ──[host link]──▶ controller_server ──[drive link]──▶ serve_drive (plant, simulator, gateway)
//!        Remote                     TcpDrive ─ LocalDevice
//! ```
//!
//! The side that is listened at is the one nearer to the arm. The drive link
//! carries the frames of [`spherecal_shared::protocol::frame`] and nothing
//! else; `docs/drive-link.md` has its bytes. A drive says in its hello which of
//! two ways it goes:
//!
//! - *lock-step*: one state, one command, and so on; nobody looks at a clock,
//!   and a run over TCP has the same bits as a run in one process;
//! - *real time*: a state every period, whether or not a command came. The
//!   controller then beats on its own clock ([`TcpDrive`]), takes the newest
//!   state and counts what was late, as it does on a board.
//!
//! The host link of a [`controller_server`] carries, besides its frames, one *end of
//! turn* each way a period: a zero byte with no frame before it, which every
//! receiver of frames passes over. It tells the host that a period of the
//! device is over, so that the host needs no clock and cannot tell lock-step
//! from real time; in lock-step the controller waits for the host's turn.

pub mod controller_server;
mod drive;
mod error;
mod remote;
mod server;
mod wire;

use std::net::{SocketAddr, TcpListener};

pub use drive::{TcpDrive, check_limits};
pub use error::TcpError;
pub use remote::{Remote, Threaded};
pub use server::{DriveServer, Service};

/// Opens a listener at `HOST:PORT`, or at `PORT` on this machine only.
///
/// # Errors
/// When the address cannot be listened at.
pub fn listen(address: &str) -> Result<(TcpListener, SocketAddr), TcpError> {
    let address = if address.contains(':') {
        address.to_owned()
    } else {
        format!("127.0.0.1:{address}")
    };
    let failed = |source| TcpError::Listen {
        address: address.clone(),
        source,
    };
    let listener = TcpListener::bind(&address).map_err(failed)?;
    let bound = listener.local_addr().map_err(failed)?;
    Ok((listener, bound))
}
