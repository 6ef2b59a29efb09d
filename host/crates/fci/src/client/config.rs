//! Where the robot is and how the client talks to it.

use std::net::{IpAddr, Ipv4Addr};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};

use super::TorqueLimits;
use crate::TCP_PORT;
use crate::wire::Version;
use spherecal_budget::robot as budget;

/// Settings of a connection.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Address or host name of the robot's control unit.
    pub host: String,
    /// TCP port. A real robot has 1337.
    pub port: u16,
    /// Address of the network card that receives the states.
    pub local: IpAddr,
    /// The versions to try, in this order.
    pub versions: Vec<Version>,
    /// How long to wait for the TCP connection.
    pub connect_timeout: Duration,
    /// How long to wait for a response. An error recovery takes some seconds.
    pub response_timeout: Duration,
    /// How long to wait for a state before the robot counts as silent.
    pub state_timeout: Duration,
    /// Lets the kernel poll the network card for this many microseconds before it sleeps (`SO_BUSY_POLL`, Linux only).
    pub busy_poll_us: Option<u32>,
    /// Polls the socket in a loop for this long before the thread sleeps. It costs a processor core and saves the
    /// wake-up.
    pub spin: Duration,
    /// Limits of the torques that the client sends.
    pub limits: TorqueLimits,
}

impl ClientConfig {
    /// The defaults for a robot at `host`: port 1337, all versions, newest first.
    pub fn new(host: impl Into<String>) -> Self {
        Self {
            machine: this_machine(),
            host: host.into(),
            port: TCP_PORT,
            local: IpAddr::V4(Ipv4Addr::UNSPECIFIED),
            versions: Version::ALL.to_vec(),
            connect_timeout: budget::CONNECT,
            response_timeout: budget::FRANKA_ANSWER,
            state_timeout: Duration::from_millis(100),
            busy_poll_us: None,
            spin: Duration::ZERO,
            limits: TorqueLimits::default(),
        }
    }
}
