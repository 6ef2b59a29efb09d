//! What the cabinet moves: the arm behind a small trait, and a simple arm for tests.

use spherecal_cyclic::{JointArm, JointDrive};

use crate::JOINTS;

/// What the cabinet asks of the arm for one period.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ArmCommand {
    /// Drives off, brakes closed.
    Brake,
    /// Hold the pose by position control.
    Hold,
    /// Joint impedance about `position`, rad, with the overlay on top, N m, **without** gravity: the arm adds its gravity
    /// compensation itself. Stiffness and damping are the arm's settings.
    Impedance {
        /// The commanded joint positions, rad.
        position: [f64; JOINTS],
        /// The torque overlay, N m.
        overlay: [f64; JOINTS],
    },
    /// A person guides: gravity is compensated, nothing else acts.
    Guide,
}

/// What the sensors of the arm measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmState {
    /// Joint positions, rad.
    pub q: [f64; JOINTS],
    /// Joint torques, gravity included, in the direction of positive joint motion, N m.
    pub tau: [f64; JOINTS],
    /// The cabinet's estimate of the external torques, N m.
    pub tau_external: [f64; JOINTS],
}

/// An arm that the cabinet moves.
pub trait ArmHardware: Send {
    /// What the sensors measure now, without a step.
    fn state(&self) -> ArmState;

    /// Moves on by `step_s` seconds under this command; returns what the sensors then measure.
    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState;
}

/// An arm that somebody else can push meanwhile.
impl<A: ArmHardware> ArmHardware for std::sync::Arc<std::sync::Mutex<A>> {
    fn state(&self) -> ArmState {
        self.lock().unwrap_or_else(std::sync::PoisonError::into_inner).state()
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        let mut arm = self.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        arm.step(command, step_s)
    }
}

/// The longest integration step, s.
const LONGEST_STEP_S: f64 = 2.5e-4;

/// A simple arm at rest at `q`, rad, for tests and examples. The application sets no stiffness and no damping.
pub fn joint_arm(q: [f64; JOINTS]) -> JointArm {
    let inertia = [1.5, 1.5, 0.8, 0.8, 0.2, 0.2, 0.05];
    JointArm::new(q, inertia, [0.0, 45.0, 5.0, 20.0, 1.0, 2.0, 0.1])
}

impl ArmHardware for JointArm {
    fn state(&self) -> ArmState {
        ArmState {
            q: self.q,
            tau: self.tau(),
            tau_external: self.external,
        }
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        let drive = match command {
            ArmCommand::Impedance { overlay, .. } => JointDrive::Torque(overlay),
            ArmCommand::Hold => JointDrive::Hold,
            ArmCommand::Brake => JointDrive::Brake,
            ArmCommand::Guide => JointDrive::Torque([0.0; JOINTS]),
        };
        let substeps = (step_s / LONGEST_STEP_S).ceil().clamp(1.0, 1000.0);
        self.drive(drive, step_s, substeps as u32);
        self.state()
    }
}
