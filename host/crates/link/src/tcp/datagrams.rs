//! Frames as datagrams: the drive link over UDP.

use std::io::{ErrorKind, Result};
use std::net::{SocketAddr, ToSocketAddrs, UdpSocket};
use std::time::Instant;

use spherecal_budget::link::{SILENT, STRANGERS};

/// One end of a drive link over UDP. Each frame is one datagram.
pub(super) struct Datagrams {
    socket: UdpSocket,
    partner: Partner,
}

/// Whom an end speaks to.
enum Partner {
    /// The address that the socket is connected to.
    One,
    /// Whoever sent the last valid frame, and when. Others are heard only after it was silent for [`SILENT`].
    Last {
        partner: Option<(SocketAddr, Instant)>,
        /// Who sent the datagram that was received last.
        from: Option<SocketAddr>,
    },
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
        let partner = Partner::Last {
            partner: None,
            from: None,
        };
        Self { socket, partner }
    }

    pub(super) fn socket(&self) -> &UdpSocket {
        &self.socket
    }

    /// Receives one datagram. One that is not of the form of a frame, or of somebody else, is none.
    pub(super) fn receive(&mut self, buffer: &mut [u8]) -> Result<usize> {
        for _ in 0..STRANGERS {
            let (count, sender) = self.socket.recv_from(buffer)?;
            if let Partner::Last { partner, from } = &mut self.partner {
                if is_there(*partner).is_some_and(|peer| peer != sender) {
                    continue;
                }
                *from = Some(sender);
            }
            // A frame has one zero byte, its last.
            let bytes = buffer.get(..count).unwrap_or_default();
            if bytes
                .iter()
                .position(|byte| *byte == 0)
                .is_some_and(|zero| zero + 1 == count)
            {
                return Ok(count);
            }
        }
        Err(ErrorKind::WouldBlock.into())
    }

    /// The last datagram was a valid frame: its sender has earned the place.
    pub(super) fn heard(&mut self) {
        if let Partner::Last { partner, from } = &mut self.partner {
            *partner = from.map(|from| (from, Instant::now()));
        }
    }

    /// Sends one datagram. Where nobody spoke, or whoever did is gone, it is dropped.
    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<usize> {
        match &self.partner {
            Partner::One => self.socket.send(bytes),
            Partner::Last { partner, .. } => match is_there(*partner) {
                Some(peer) => self.socket.send_to(bytes, peer),
                None => Ok(bytes.len()),
            },
        }
    }
}

/// The partner that was heard in the last [`SILENT`].
fn is_there(partner: Option<(SocketAddr, Instant)>) -> Option<SocketAddr> {
    partner.and_then(|(peer, heard)| (heard.elapsed() < SILENT).then_some(peer))
}
