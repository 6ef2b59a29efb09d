//! What the robot side moves: the arm behind a small trait, and a simple arm for tests.

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

/// Seven independent joints with inertia, viscous friction and a load by gravity.
///
/// `inertia ddq = torque + gravity_error + external - friction dq`: the robot's gravity compensation cancels
/// `gravity sin(q)` but for `gravity_error`.
#[derive(Clone, Debug)]
pub struct JointArm {
    /// Inertia, kg m^2.
    pub inertia: [f64; JOINTS],
    /// Viscous friction that the robot does not compensate, N m s/rad.
    pub friction: [f64; JOINTS],
    /// Amplitude of the gravity torque, N m.
    pub gravity: [f64; JOINTS],
    /// What the robot's gravity compensation gets wrong, N m.
    pub gravity_error: [f64; JOINTS],
    /// External joint torques, N m.
    pub external: [f64; JOINTS],
    /// External wrench at the end effector, as the robot would estimate it, N and N m. It does not move the joints.
    pub wrench: [f64; 6],
    q: [f64; JOINTS],
    dq: [f64; JOINTS],
    torque: [f64; JOINTS],
    hold_at: Option<[f64; JOINTS]>,
}

/// Natural frequency of the simple arm's own hold, rad/s.
const HOLD_RAD_S: f64 = 60.0;
/// Integration steps in a millisecond.
const SUBSTEPS: u32 = 4;

impl JointArm {
    /// An arm at rest at `q`, rad, whose gravity compensation is 0.2 N m wrong in joint 2 and 4: what a controller has
    /// to hold against.
    pub fn new(q: [f64; JOINTS]) -> Self {
        Self {
            inertia: [1.0, 1.0, 0.8, 0.8, 0.15, 0.15, 0.05],
            friction: [0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.1],
            gravity: [0.0, 40.0, 5.0, 20.0, 1.0, 2.0, 0.1],
            gravity_error: [0.0, 0.2, 0.0, -0.2, 0.0, 0.0, 0.0],
            external: [0.0; JOINTS],
            wrench: [0.0; 6],
            q,
            dq: [0.0; JOINTS],
            torque: [0.0; JOINTS],
            hold_at: None,
        }
    }

    /// Joint positions, rad.
    pub fn q(&self) -> &[f64; JOINTS] {
        &self.q
    }

    fn joint(&mut self, joint: usize, command: ArmCommand) {
        let q = self.q[joint];
        let inertia = self.inertia[joint];
        let torque = match (command, self.hold_at) {
            (ArmCommand::Torque(torque), _) => torque[joint],
            (ArmCommand::Follow(at, dq), _) => {
                inertia * HOLD_RAD_S * (HOLD_RAD_S * (at[joint] - q) + 2.0 * (dq[joint] - self.dq[joint]))
            }
            (ArmCommand::Hold, Some(at)) => {
                inertia * HOLD_RAD_S * (HOLD_RAD_S * (at[joint] - q) - 2.0 * self.dq[joint])
            }
            _ => 0.0,
        };
        self.torque[joint] = torque;
        if command == ArmCommand::Brake {
            self.dq[joint] = 0.0;
            return;
        }
        let acting = torque + self.gravity_error[joint] + self.external[joint] - self.friction[joint] * self.dq[joint];
        let step = PERIOD_S / f64::from(SUBSTEPS);
        self.dq[joint] += step * acting / inertia;
        self.q[joint] += step * self.dq[joint];
    }
}

impl ArmHardware for JointArm {
    fn state(&self) -> ArmState {
        let mut tau = [0.0; JOINTS];
        for (joint, tau) in tau.iter_mut().enumerate() {
            *tau = self.torque[joint] + self.gravity[joint] * self.q[joint].sin();
        }
        ArmState {
            q: self.q,
            dq: self.dq,
            tau,
            tau_external: self.external,
            wrench_external: self.wrench,
        }
    }

    fn step(&mut self, command: ArmCommand) -> ArmState {
        if command == ArmCommand::Hold {
            self.hold_at.get_or_insert(self.q);
        } else {
            self.hold_at = None;
        }
        for _ in 0..SUBSTEPS {
            for joint in 0..JOINTS {
                self.joint(joint, command);
            }
        }
        self.state()
    }
}

/// An arm that somebody else can push meanwhile.
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
