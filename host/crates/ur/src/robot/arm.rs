//! The arm behind the robot side.

use std::sync::{Arc, Mutex, PoisonError};

use crate::JOINTS;

/// The arm at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmState {
    /// Measured joint angles, base to flange, rad.
    pub q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub qd: [f64; JOINTS],
    /// Torques that hold arm and load, as the robot computes them, N m.
    pub moment: [f64; JOINTS],
}

/// An arm that nobody commands: it rests with closed brakes, or a hand guides it.
pub trait ArmHardware: Send {
    /// The arm now.
    fn state(&self) -> ArmState;

    /// Lets this time pass, in s.
    fn step(&mut self, step_s: f64) -> ArmState;
}

/// An arm that stays where the test puts it.
impl ArmHardware for Arc<Mutex<ArmState>> {
    fn state(&self) -> ArmState {
        *self.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn step(&mut self, _: f64) -> ArmState {
        ArmHardware::state(self)
    }
}
