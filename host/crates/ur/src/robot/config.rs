//! Which robot the robot side is.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use spherecal_cyclic::{Machine, this_machine};

use crate::wire::{ControllerVersion, KinematicsInfo, Series};
use crate::{JOINTS, RTDE_PORT};

/// Settings of a robot side.
#[derive(Clone, Debug)]
pub struct RobotConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Where RTDE listens. The interfaces that take scripts listen one to three ports below, the dashboard five. Port 0 takes any
    /// such ports.
    pub address: SocketAddr,
    /// The software that it says to have. It decides on the rate: 125 Hz or 500 Hz.
    pub version: ControllerVersion,
    /// The calibration that it says to have.
    pub kinematics: KinematicsInfo,
    /// Control periods that an input waits, beyond that in which it comes, until a program can read it.
    pub input_delay: u32,
    /// Largest joint speed, rad/s, and largest torque that a program may ask for, N m, of each joint. Beyond them the robot makes a
    /// protective stop. Infinite by default.
    pub limits: [(f64, f64); JOINTS],
}

/// Control periods that an input waits by default. Users of RTDE see their commands act after 4 to 6 ms; this makes it 4 ms.
const INPUT_DELAY: u32 = 1;

impl RobotConfig {
    /// A robot of this series on this computer, at the usual ports, with this calibration.
    pub fn new(series: Series, kinematics: KinematicsInfo) -> Self {
        let (major, minor, bugfix) = match series {
            Series::Cb3 => (3, 15, 0),
            Series::ESeries => (5, 25, 1),
        };
        Self {
            machine: this_machine(),
            address: SocketAddr::from((Ipv4Addr::LOCALHOST, RTDE_PORT)),
            version: ControllerVersion {
                major,
                minor,
                bugfix,
                ..ControllerVersion::default()
            },
            kinematics,
            input_delay: INPUT_DELAY,
            limits: [(f64::INFINITY, f64::INFINITY); JOINTS],
        }
    }

    /// Its series.
    pub fn series(&self) -> Series {
        Series::of(self.version.major)
    }
}
