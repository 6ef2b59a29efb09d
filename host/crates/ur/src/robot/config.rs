//! Which robot the robot side is.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::Arc;

use spherecal_cyclic::{Machine, this_machine};

use crate::RTDE_PORT;
use crate::wire::{ControllerVersion, KinematicsInfo, Series};

/// Settings of a robot side.
#[derive(Clone, Debug)]
pub struct RobotConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Where RTDE listens. The primary interface listens three ports below. Port 0 takes any two such ports.
    pub address: SocketAddr,
    /// The software that it says to have. It decides on the rate: 125 Hz or 500 Hz.
    pub version: ControllerVersion,
    /// The calibration that it says to have.
    pub kinematics: KinematicsInfo,
}

impl RobotConfig {
    /// A robot of this series on this computer, at the usual ports, with this calibration.
    pub fn new(series: Series, kinematics: KinematicsInfo) -> Self {
        let (major, minor) = match series {
            Series::Cb3 => (3, 15),
            Series::ESeries => (5, 25),
        };
        Self {
            machine: this_machine(),
            address: SocketAddr::from((Ipv4Addr::LOCALHOST, RTDE_PORT)),
            version: ControllerVersion {
                major,
                minor,
                ..ControllerVersion::default()
            },
            kinematics,
        }
    }

    /// Its series.
    pub fn series(&self) -> Series {
        Series::of(self.version.major)
    }
}
