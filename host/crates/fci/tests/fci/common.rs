//! What the tests of client against robot side share: a robot, a soft control law, and a network that can fail.

use std::net::SocketAddr;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use spherecal_cyclic::JointArm;
use spherecal_cyclic::testing::{World, joint_impedance};
use spherecal_fci::client::ClientConfig;
use spherecal_fci::robot::{READY, RobotConfig, RobotSide, Tolerance, joint_arm, start_robot};
use spherecal_fci::wire::{RobotState, Version};

/// A robot in this world with the simple arm, which the test can push. It does not wait, as a real one does not.
pub(crate) fn robot(world: &World, version: Version) -> (RobotSide, Arc<Mutex<JointArm>>) {
    robot_with(RobotConfig {
        tolerance: Tolerance::strict(),
        ..patient(world, version)
    })
}

/// Settings of a robot that waits for answers.
pub(crate) fn patient(world: &World, version: Version) -> RobotConfig {
    RobotConfig {
        machine: world.machine(),
        ..RobotConfig::for_tests(version)
    }
}

pub(crate) fn robot_with(config: RobotConfig) -> (RobotSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(joint_arm(READY)));
    let side = start_robot(config, Box::new(Arc::clone(&arm))).expect("a robot");
    (side, arm)
}

/// Settings for a robot of this world.
pub(crate) fn config(world: &World, address: SocketAddr) -> ClientConfig {
    ClientConfig {
        machine: world.machine(),
        ..on_this_machine(address)
    }
}

/// Settings for a robot on this machine. The timeout is long: two cores are shared.
pub(crate) fn on_this_machine(address: SocketAddr) -> ClientConfig {
    ClientConfig {
        port: address.port(),
        state_timeout: Duration::from_secs(2),
        ..ClientConfig::new("127.0.0.1")
    }
}

/// A joint impedance that holds `at`, rad.
pub(crate) fn hold(at: [f64; 7]) -> impl Fn(&RobotState) -> [f64; 7] {
    let law = joint_impedance(at);
    move |state| law(&state.q, &state.dq)
}

/// The largest distance of a joint from `at`, rad.
pub(crate) fn deviation(state: &RobotState, at: &[f64; 7]) -> f64 {
    spherecal_cyclic::testing::deviation(&state.q, at)
}
