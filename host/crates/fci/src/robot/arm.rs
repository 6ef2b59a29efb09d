//! What the robot side moves: the arm behind a small trait, and a simple arm for tests.

use spherecal_cyclic::{JointArm, JointDrive};

use crate::wire::FlangeLoad;
use crate::{JOINTS, PERIOD_S};

/// What the robot asks of the arm for one millisecond.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum ArmCommand {
    /// These joint torques, N m, **without** gravity and friction. The arm adds its gravity and friction compensation
    /// itself, as the robot's own controller does.
    Torque([f64; JOINTS]),
    /// Follow these joint positions, rad, and velocities, rad/s, with the robot's own controller.
    Follow([f64; JOINTS], [f64; JOINTS]),
    /// Hold the pose with the robot's own controller.
    Hold,
    /// Brakes closed.
    Brake,
    /// A person guides: gravity and friction are compensated, nothing else acts.
    Guide,
}

/// What the sensors of the arm measure after a step.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ArmState {
    /// Joint positions, rad.
    pub q: [f64; JOINTS],
    /// Joint velocities, rad/s.
    pub dq: [f64; JOINTS],
    /// Link-side joint torques, gravity included, N m.
    pub tau: [f64; JOINTS],
    /// The robot's estimate of the external joint torques, N m.
    pub tau_external: [f64; JOINTS],
    /// The robot's estimate of the external wrench at the end effector in the base frame, N and N m.
    pub wrench_external: [f64; 6],
}

/// An arm that the robot side moves.
pub trait ArmHardware: Send {
    /// What the sensors measure now, without a step.
    fn state(&self) -> ArmState;

    /// Moves on by one millisecond under this command; returns what the sensors then measure.
    fn step(&mut self, command: ArmCommand) -> ArmState;

    /// The client declares another load. An arm without a model of gravity may ignore it.
    fn set_load(&mut self, _load: &FlangeLoad) {}
}

/// A simple arm at rest at `q`, rad, for tests and examples.
pub fn joint_arm(q: [f64; JOINTS]) -> JointArm {
    let inertia = [1.0, 1.0, 0.8, 0.8, 0.15, 0.15, 0.05];
    JointArm::new(q, inertia, [0.0, 40.0, 5.0, 20.0, 1.0, 2.0, 0.1])
}

impl ArmHardware for JointArm {
    fn state(&self) -> ArmState {
        ArmState {
            q: self.q,
            dq: self.dq,
            tau: self.tau(),
            tau_external: self.external,
            wrench_external: self.wrench,
        }
    }

    fn step(&mut self, command: ArmCommand) -> ArmState {
        let drive = match command {
            ArmCommand::Torque(torque) => JointDrive::Torque(torque),
            ArmCommand::Follow(q, dq) => JointDrive::Follow(q, dq),
            ArmCommand::Hold => JointDrive::Hold,
            ArmCommand::Brake => JointDrive::Brake,
            ArmCommand::Guide => JointDrive::Torque([0.0; JOINTS]),
        };
        self.drive(drive, PERIOD_S, 4);
        self.state()
    }
}

impl<A: ArmHardware> ArmHardware for std::sync::Arc<std::sync::Mutex<A>> {
    fn state(&self) -> ArmState {
        self.lock().unwrap_or_else(std::sync::PoisonError::into_inner).state()
    }

    fn step(&mut self, command: ArmCommand) -> ArmState {
        let mut arm = self.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        arm.step(command)
    }

    fn set_load(&mut self, load: &FlangeLoad) {
        let mut arm = self.lock().unwrap_or_else(std::sync::PoisonError::into_inner);
        arm.set_load(load);
    }
}
