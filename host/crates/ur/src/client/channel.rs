//! One connection: bytes with a deadline.

use std::io::ErrorKind;
use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::Arc;
use std::time::{Duration, Instant};

use spherecal_budget::robot as budget;
use spherecal_budget::robot::LINE;
use spherecal_cyclic::{Machine, Stream, io_error as io, this_machine};

use super::ClientError;
use crate::{DASHBOARD_BELOW_RTDE, PRIMARY_BELOW_RTDE, RTDE_PORT, robot_api_port};

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

/// Settings of a connection.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Address or host name of the robot.
    pub host: String,
    /// TCP port of RTDE. A real robot has 30004. The primary interface is three below it, the dashboard five; that of the Robot
    /// API is [`robot_api_port`].
    pub port: u16,
    /// How long to wait for the TCP connection.
    pub connect_timeout: Duration,
    /// How long to wait for an answer.
    pub response_timeout: Duration,
    /// How long to wait for a data package before the robot counts as silent.
    pub state_timeout: Duration,
}

impl ClientConfig {
    /// The defaults for a robot at `host`.
    pub fn new(host: impl Into<String>) -> Self {
        Self {
            machine: this_machine(),
            host: host.into(),
            port: RTDE_PORT,
            connect_timeout: budget::CONNECT,
            response_timeout: budget::UR_ANSWER,
            state_timeout: Duration::from_secs(1),
        }
    }

    /// The robot's addresses at this port.
    pub(super) fn addresses(&self, port: u16) -> Result<Vec<SocketAddr>, ClientError> {
        let unknown = |source| ClientError::Name {
            host: self.host.clone(),
            source,
        };
        let found: Vec<_> = (self.host.as_str(), port).to_socket_addrs().map_err(unknown)?.collect();
        if found.is_empty() {
            return Err(unknown(std::io::ErrorKind::NotFound.into()));
        }
        Ok(found)
    }

    pub(super) fn dashboard_port(&self) -> u16 {
        self.port.saturating_sub(DASHBOARD_BELOW_RTDE)
    }

    pub(super) fn robot_api_port(&self) -> u16 {
        robot_api_port(self.port)
    }

    pub(super) fn primary_port(&self) -> u16 {
        self.port.saturating_sub(PRIMARY_BELOW_RTDE)
    }
}
