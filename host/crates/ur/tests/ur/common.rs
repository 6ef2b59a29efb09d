//! What the tests share: a robot of a virtual world, and its arm.

use std::sync::{Arc, Mutex};

use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_ur::client::ClientConfig;
use spherecal_ur::robot::{ArmState, RobotConfig, RobotSide, start_robot};
use spherecal_ur::wire::{KinematicsInfo, Series};

/// A pose with six different angles, rad.
pub(crate) const POSE: [f64; 6] = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];

/// The calibration of a UR10 in use: nominal lengths and the third set of corrections of the test `calibration` of
/// Universal_Robots_ROS2_Driver, `ur_calibration/test/calibration_test.cpp` (BSD-3-Clause), rounded.
pub(crate) fn calibration() -> KinematicsInfo {
    KinematicsInfo {
        checksum: [1, 2, 3, 4, 5, 6],
        theta: [-2.4e-7, 1.602_339_52, -1.686_071_91, 0.083_733_11, -1.0e-7, 3.9e-8],
        a: [2.1e-5, 0.020_017_13, -0.570_001_66, -4.6e-5, -6.4e-5, 0.0],
        d: [
            0.127_139_81,
            439.140_974_08,
            -446.027_059_81,
            7.050_127_9,
            0.115_661_34,
            0.091_320_92,
        ],
        alpha: [
            1.570_146_08,
            0.001_394_17,
            0.006_938_19,
            1.569_984_69,
            -1.570_385_21,
            0.0,
        ],
        status: 0,
    }
}

/// A robot of this world, with an arm that the test can move.
pub(crate) fn robot(world: &World, series: Series) -> (RobotSide, Arc<Mutex<ArmState>>) {
    let arm = Arc::new(Mutex::new(ArmState {
        q: POSE,
        ..ArmState::default()
    }));
    let config = RobotConfig {
        machine: world.machine(),
        address: LOCAL,
        ..RobotConfig::new(series, calibration())
    };
    let side = start_robot(config, Box::new(Arc::clone(&arm))).expect("a robot");
    (side, arm)
}

/// Settings for a robot of this world.
pub(crate) fn config(world: &World, side: &RobotSide) -> ClientConfig {
    ClientConfig {
        machine: world.machine(),
        port: side.address().port(),
        ..ClientConfig::new("127.0.0.1")
    }
}
