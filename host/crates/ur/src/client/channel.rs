//! One connection: bytes with a deadline.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::Instant;

use spherecal_cyclic::{Machine, Stream, io_error as io};

use super::{ClientConfig, ClientError};
use spherecal_budget::robot::LINE;

/// Bytes read at once.
const PART: usize = 4096;

/// A connection and what has come but was not taken. It holds at most one package that is not whole and one part.
pub(super) struct Channel {
    machine: Arc<dyn Machine>,
    stream: Box<dyn Stream>,
    peer: SocketAddr,
    pub(super) received: Vec<u8>,
}

impl Channel {
    /// Connects to the first of these addresses that answers.
    pub(super) fn connect(config: &ClientConfig, addresses: &[SocketAddr]) -> Result<Self, ClientError> {
        let machine = Arc::clone(&config.machine);
        let mut failed = None;
        for &address in addresses {
            match machine.connect(address, config.connect_timeout) {
                Ok(stream) => {
                    return Ok(Self {
                        machine,
                        stream,
                        peer: address,
                        received: Vec::new(),
                    });
                }
                Err(source) => failed = failed.or(Some(ClientError::Connect { address, source })),
            }
        }
        Err(failed.unwrap_or(ClientError::Closed))
    }

    /// Who is at the other end.
    pub(super) fn peer(&self) -> SocketAddr {
        self.peer
    }

    pub(super) fn now(&self) -> Instant {
        self.machine.now()
    }

    pub(super) fn send(&mut self, bytes: &[u8]) -> Result<(), ClientError> {
        self.stream.set_wait(Some(LINE)).map_err(io("set a timeout"))?;
        self.stream.write_all(bytes).map_err(|error| match error.kind() {
            ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => ClientError::Closed,
            _ => io("send a request")(error).into(),
        })
    }

    /// Waits for more bytes, at most until `deadline`; without one it takes what has come. Whether any came.
    pub(super) fn receive(&mut self, deadline: Option<Instant>) -> Result<bool, ClientError> {
        loop {
            let left = deadline.map(|at| at.saturating_duration_since(self.now()));
            if left.is_some_and(|left| left.is_zero()) {
                return Ok(false);
            }
            self.stream.set_wait(left).map_err(io("set a timeout"))?;
            let mut part = [0; PART];
            match self.stream.read(&mut part) {
                Ok(0) => return Err(ClientError::Closed),
                Ok(count) => {
                    self.received.extend_from_slice(&part[..count]);
                    return Ok(true);
                }
                Err(error) => match error.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut => return Ok(false),
                    ErrorKind::Interrupted => {}
                    ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => return Err(ClientError::Closed),
                    _ => return Err(io("read from the robot")(error).into()),
                },
            }
        }
    }
}

impl Drop for Channel {
    fn drop(&mut self) {
        self.stream.close();
    }
}
