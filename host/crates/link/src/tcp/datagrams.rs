//! Frames as datagrams: the drive link over UDP.

use std::io::{ErrorKind, Result};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::Instant;

use spherecal_budget::link::SILENT;

/// One end of a drive link over UDP. Each frame is one datagram.
pub(super) struct Datagrams {
    socket: UdpSocket,
    partner: Partner,
}

/// Whom an end speaks to.
enum Partner {
    /// The address that the socket is connected to.
    One,
    /// Whoever spoke last, and when. Another one is heard only after this one was silent for [`SILENT`].
    Last(Option<(SocketAddr, Instant)>),
}

impl Datagrams {
    /// An end that speaks to `HOST:PORT`.
    pub(super) fn to(address: &str) -> Result<Self> {
        let mut last = ErrorKind::AddrNotAvailable.into();
        for peer in address.to_socket_addrs()? {
            let own = if peer.is_ipv4() { "0.0.0.0:0" } else { "[::]:0" };
            match UdpSocket::bind(own).and_then(|socket| socket.connect(peer).map(|()| socket)) {
                Ok(socket) => {
                    let partner = Partner::One;
                    return Ok(Self { socket, partner });
                }
                Err(error) => last = error,
            }
        }
        Err(last)
    }

    /// An end that answers whoever speaks to it.
    pub(super) fn answering(socket: UdpSocket) -> Self {
        let partner = Partner::Last(None);
        Self { socket, partner }
    }

    pub(super) fn socket(&self) -> &UdpSocket {
        &self.socket
    }

    /// Receives one datagram. One without bytes, or of somebody else, is none.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> Result<usize> {
        let (count, from) = self.socket.recv_from(buffer)?;
        if let Partner::Last(last) = &mut self.partner {
            let is_other = |(peer, heard): &(SocketAddr, Instant)| *peer != from && heard.elapsed() < SILENT;
            if last.as_ref().is_some_and(is_other) {
                return Err(ErrorKind::WouldBlock.into());
            }
            *last = Some((from, Instant::now()));
        }
        if count == 0 {
            return Err(ErrorKind::WouldBlock.into());
        }
        Ok(count)
    }

    /// Sends one datagram. Where nobody spoke, or whoever did is gone, it is dropped.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<usize> {
        match &self.partner {
            Partner::One => self.socket.send(bytes),
            Partner::Last(Some((peer, heard))) if heard.elapsed() < SILENT => self.socket.send_to(bytes, peer),
            Partner::Last(_) => Ok(bytes.len()),
        }
    }
}
