//! Both links over TCP, for drives, controllers and hosts in processes of their own.
//!
//! ```text
//!   spherecal run ──[host link]──▶ controller_server ──[drive link]──▶ serve_drive (plant, simulator, gateway)
//!        Remote                     RemoteDrive ─ LocalDevice
//! ```
//!
//! On each link the side nearer to the arm listens. The drive link carries the frames of
//! [`spherecal_shared::protocol::frame`] and nothing else; `docs/drive-link.md` describes its
//! bytes. The drive's hello selects one of two modes:
//!
//! - *lock-step*: one state, one command, in turn. Nobody reads a clock, and a run over TCP has the
//!   same bits as a run in one process.
//! - *real time*: a state every period, whether or not a command came. The controller then runs on
//!   its own clock ([`RemoteDrive`]), takes the newest state and counts late states, as it does on a
//!   board.
//!
//! The host link of a [`controller_server`] carries its frames and one *end mark* in each direction
//! per period: a zero byte with no frame before it, which every receiver of frames skips. The mark
//! tells the host that a period of the device is over. So the host needs no clock and does not
//! depend on the mode. In lock-step the controller waits for the host's end mark.
//!
//! A listener has one place, and a peer earns it by a valid frame (`lobby.rs`): one that is silent, trickles or floods
//! keeps nobody out.

pub mod conform;
pub mod controller_server;
mod datagrams;
mod drive;
mod error;
mod lobby;
mod progress;
mod real_time_hosts;
mod remote;
mod server;
mod stream;
mod turns;
mod wire;

use std::net::{SocketAddr, TcpListener, UdpSocket};

pub use drive::{RemoteDrive, check_limits};
pub use error::TcpError;
pub use remote::{Remote, Threaded};
pub use server::{ConnectionCounts, DriveServer};

/// Opens a listener at `HOST:PORT`, or at `PORT` on this machine only.
///
/// # Errors
/// When the program cannot listen at the address.
pub fn listen(address: &str) -> Result<(TcpListener, SocketAddr), TcpError> {
    open(address, |address| {
        let listener = TcpListener::bind(address)?;
        listener.local_addr().map(|bound| (listener, bound))
    })
}

/// Opens a socket for datagrams at `HOST:PORT`, or at `PORT` on this machine only.
///
/// # Errors
/// When the program cannot listen at the address.
pub fn listen_udp(address: &str) -> Result<(UdpSocket, SocketAddr), TcpError> {
    open(address, |address| {
        let socket = UdpSocket::bind(address)?;
        socket.local_addr().map(|bound| (socket, bound))
    })
}

fn open<T>(address: &str, bind: impl Fn(&str) -> std::io::Result<T>) -> Result<T, TcpError> {
    let address = if address.contains(':') {
        address.to_owned()
    } else {
        format!("127.0.0.1:{address}")
    };
    bind(&address).map_err(|source| TcpError::Listen { address, source })
}
