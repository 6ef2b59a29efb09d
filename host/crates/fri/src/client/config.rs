//! Where the client listens and what it may command.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};

use crate::{JOINTS, UDP_PORT};

/// Limits of the torques that the client sends.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct TorqueLimits {
    /// Largest overlay of each joint, N m.
    pub torque: [f64; JOINTS],
    /// Largest change of a joint's overlay, N m/s. The maker states no limit; the default is that of other arms.
    pub torque_rate: f64,
}

impl TorqueLimits {
    /// LBR iiwa 7 R800: the joints' torque limits.
    pub const IIWA_7: Self = Self {
        torque: [176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0],
        torque_rate: 1000.0,
    };
}

/// Settings of a session.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Where the client listens: the network card of the cabinet and the port that the application names.
    pub address: SocketAddr,
    /// The cabinet's address. `None` takes the first sender; datagrams from others are then ignored.
    pub cabinet: Option<IpAddr>,
    /// How long to wait for a message before the cabinet counts as silent.
    pub timeout: Duration,
    /// Limits of the torques that the client sends.
    pub limits: TorqueLimits,
    /// Appends length and checksum to each command. Off: the public facts do not say which bytes they cover, and a
    /// cabinet's message without them was accepted by the maker's client.
    pub checksum: bool,
    /// Lets the kernel poll the network card for this many microseconds before it sleeps (`SO_BUSY_POLL`, Linux only).
    pub busy_poll_us: Option<u32>,
    /// Polls the socket in a loop for this long before the thread sleeps. It costs a processor core and saves the
    /// wake-up.
    pub spin: Duration,
}

impl ClientConfig {
    /// The defaults for an arm with these limits: port 30200 on every network card.
    pub fn new(limits: TorqueLimits) -> Self {
        Self {
            machine: this_machine(),
            address: SocketAddr::new(IpAddr::V4(Ipv4Addr::UNSPECIFIED), UDP_PORT),
            cabinet: None,
            timeout: Duration::from_millis(100),
            limits,
            checksum: false,
            busy_poll_us: None,
            spin: Duration::ZERO,
        }
    }
}
