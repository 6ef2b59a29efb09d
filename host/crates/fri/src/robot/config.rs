//! Settings of the cabinet's side.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};

use crate::wire::Framing;
use crate::{JOINTS, UDP_PORT};

/// How patient the cabinet is with its client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// How long the cabinet waits for an answer while commanding before it moves on. A real cabinet does not wait.
    pub patience: Duration,
}

impl Tolerance {
    /// As a real cabinet: no waiting.
    pub const fn strict() -> Self {
        Self {
            patience: Duration::ZERO,
        }
    }

    /// For test machines without real time: the cabinet waits up to 100 ms for each answer while commanding. Its time
    /// then runs slower than the wall clock.
    pub const fn tolerant() -> Self {
        Self {
            patience: Duration::from_millis(100),
        }
    }
}

/// Settings of the cabinet's side.
#[derive(Clone, Debug)]
pub struct CabinetConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Where the client listens.
    pub client: SocketAddr,
    /// Where the cabinet sends from; a client that knows the cabinet hears no other address. A real cabinet has port
    /// 30200, as its client has: on one machine that is one too many. `None`: any free port.
    pub address: Option<SocketAddr>,
    /// How it frames its messages, and expects the answers.
    pub framing: Framing,
    /// Time between two messages, ms: 1 to 100.
    pub send_period_ms: u32,
    /// The cabinet expects an answer to each n-th message.
    pub receive_multiplier: u32,
    /// How patient it is.
    pub tolerance: Tolerance,
    /// Torque limits of the joints, N m. A larger overlay ends the motion.
    pub torque_limit: [f64; JOINTS],
    /// Sign of the measured torques: +1 or -1. Software versions differ.
    pub measured_sign: f64,
    /// Appends length and checksum to each message.
    pub checksum: bool,
}

impl CabinetConfig {
    /// A strict LBR iiwa 7 with a period of 1 ms, for a client on this machine at port 30200.
    pub fn new() -> Self {
        Self {
            machine: this_machine(),
            client: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), UDP_PORT),
            address: None,
            framing: Framing::Bare,
            send_period_ms: 1,
            receive_multiplier: 1,
            tolerance: Tolerance::strict(),
            torque_limit: [176.0, 176.0, 110.0, 110.0, 110.0, 40.0, 40.0],
            measured_sign: 1.0,
            checksum: false,
        }
    }
}

impl Default for CabinetConfig {
    fn default() -> Self {
        Self::new()
    }
}

/// Where the simple arm stands at its start, rad.
pub const START: [f64; JOINTS] = [0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0];
