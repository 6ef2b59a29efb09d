//! The arm behind the robot side.

use std::sync::{Arc, Mutex, PoisonError};

use crate::JOINTS;
use crate::wire::Load;

/// The arm at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmState {
    /// Measured joint angles, base to flange, rad.
    pub q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub qd: [f64; JOINTS],
    /// Torques that hold arm and load, as the robot computes them, N m.
    pub moment: [f64; JOINTS],
    /// Torques of the motors beyond those, by their currents, seen at the joints, N m.
    pub motor_torque: [f64; JOINTS],
}

/// What the robot lets the arm do in a period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ArmCommand {
    /// Hold the pose: by closed brakes, or by position control. A hand may guide an arm that is made for it.
    #[default]
    Hold,
    /// Follow these torques, N m. The arm adds what holds it and its load.
    Torque([f64; JOINTS]),
}

/// An arm that the robot moves.
pub trait ArmHardware: Send {
    /// The arm now.
    fn state(&self) -> ArmState;

    /// Lets this time pass, in s, under this command.
    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState;

    /// What the robot is told to carry. An arm that nobody commands need not know.
    fn set_load(&mut self, _load: &Load) {}
}

/// An arm that stays where the test puts it.
impl ArmHardware for Arc<Mutex<ArmState>> {
    fn state(&self) -> ArmState {
        *self.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn step(&mut self, _: ArmCommand, _: f64) -> ArmState {
        ArmHardware::state(self)
    }
}
