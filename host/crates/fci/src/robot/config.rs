//! Settings of the robot side.

use std::net::{IpAddr, Ipv4Addr, SocketAddr};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};

use crate::wire::Version;
use crate::{JOINTS, TCP_PORT};

/// How patient the robot is with its client.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// How long the robot waits for the answer to a state before it moves on. A real robot does not wait.
    pub patience: Duration,
    /// Commands missing in a row that end a motion. 20 on a real robot.
    pub missing_in_row: u32,
    /// The success rate below which a motion ends, once 100 commands are due.
    pub success_rate: f64,
}

impl Tolerance {
    /// As a real robot: no waiting.
    pub const fn strict() -> Self {
        Self {
            patience: Duration::ZERO,
            missing_in_row: 20,
            success_rate: 0.8,
        }
    }

    /// For test machines without real time: as strict, but the robot waits up to 100 ms for each answer of a motion. Its
    /// time then runs slower than the wall clock.
    pub const fn tolerant() -> Self {
        Self {
            patience: Duration::from_millis(100),
            ..Self::strict()
        }
    }
}

/// Settings of the robot side.
#[derive(Clone, Debug)]
pub struct RobotConfig {
    /// Its time and its network.
    pub machine: Arc<dyn Machine>,
    /// The version that it speaks, and with it the robot: 4 and 5 are a Panda, the others are an FR3.
    pub version: Version,
    /// Where it listens. Port 0 takes any free port; the official clients know only 1337.
    pub address: SocketAddr,
    /// How patient it is.
    pub tolerance: Tolerance,
    /// The robot model that `GetRobotModel` answers; `None`: the nominal FR3.
    pub model: Option<String>,
    /// How long an error recovery takes, periods.
    pub recovery: u32,
}

impl RobotConfig {
    /// A strict robot on the loopback address, port 1337.
    pub fn new(version: Version) -> Self {
        Self {
            machine: this_machine(),
            version,
            address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), TCP_PORT),
            tolerance: Tolerance::strict(),
            model: None,
            recovery: 100,
        }
    }

    /// The same on any free port, and tolerant: for tests with our own client.
    pub fn for_tests(version: Version) -> Self {
        Self {
            address: SocketAddr::new(IpAddr::V4(Ipv4Addr::LOCALHOST), 0),
            tolerance: Tolerance::tolerant(),
            ..Self::new(version)
        }
    }
}

/// The maker's ready pose, rad.
pub const READY: [f64; JOINTS] = {
    use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
    [0.0, -FRAC_PI_4, 0.0, -3.0 * FRAC_PI_4, 0.0, FRAC_PI_2, FRAC_PI_4]
};
