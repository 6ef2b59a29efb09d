//! What the cabinet moves: the arm behind a small trait, and a simple arm for tests.

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

/// Seven independent joints with inertia, viscous friction and a load by gravity.
///
/// `inertia ddq = overlay + stiffness (position - q) - (damping + friction) dq + gravity_error + external`: the
/// cabinet's gravity compensation cancels `gravity sin(q)` but for `gravity_error`.
#[derive(Clone, Debug)]
pub struct JointArm {
    /// Inertia, kg m^2.
    pub inertia: [f64; JOINTS],
    /// Viscous friction, N m s/rad.
    pub friction: [f64; JOINTS],
    /// Amplitude of the gravity torque, N m.
    pub gravity: [f64; JOINTS],
    /// What the cabinet's gravity compensation gets wrong, N m.
    pub gravity_error: [f64; JOINTS],
    /// External joint torques, N m.
    pub external: [f64; JOINTS],
    /// Stiffness of the cabinet's joint impedance, N m/rad. The application sets 0.
    pub stiffness: [f64; JOINTS],
    /// Damping of the cabinet's joint impedance, N m s/rad. The application sets 0.
    pub damping: [f64; JOINTS],
    q: [f64; JOINTS],
    dq: [f64; JOINTS],
    torque: [f64; JOINTS],
    hold_at: Option<[f64; JOINTS]>,
}

/// Natural frequency of the position control, rad/s.
const HOLD_RAD_S: f64 = 60.0;
const LONGEST_STEP_S: f64 = 2.5e-4;

impl JointArm {
    /// An arm at rest at `q`, rad, with stiffness and damping 0, whose gravity compensation is 0.2 N m wrong in the joints
    /// 2 and 4: what a controller has to hold against.
    pub fn new(q: [f64; JOINTS]) -> Self {
        Self {
            inertia: [1.5, 1.5, 0.8, 0.8, 0.2, 0.2, 0.05],
            friction: [0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.1],
            gravity: [0.0, 45.0, 5.0, 20.0, 1.0, 2.0, 0.1],
            gravity_error: [0.0, 0.2, 0.0, -0.2, 0.0, 0.0, 0.0],
            external: [0.0; JOINTS],
            stiffness: [0.0; JOINTS],
            damping: [0.0; JOINTS],
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

    fn joint(&mut self, joint: usize, command: ArmCommand, step_s: f64) {
        let (q, dq, inertia) = (self.q[joint], self.dq[joint], self.inertia[joint]);
        let torque = match (command, self.hold_at) {
            (ArmCommand::Impedance { position, overlay }, _) => {
                overlay[joint] + self.stiffness[joint] * (position[joint] - q) - self.damping[joint] * dq
            }
            (ArmCommand::Hold, Some(at)) => inertia * HOLD_RAD_S * (HOLD_RAD_S * (at[joint] - q) - 2.0 * dq),
            _ => 0.0,
        };
        self.torque[joint] = torque;
        if command == ArmCommand::Brake {
            self.dq[joint] = 0.0;
            return;
        }
        let acting = torque + self.gravity_error[joint] + self.external[joint] - self.friction[joint] * dq;
        self.dq[joint] += step_s * acting / inertia;
        self.q[joint] += step_s * self.dq[joint];
    }
}

impl ArmHardware for JointArm {
    fn state(&self) -> ArmState {
        ArmState {
            q: self.q,
            tau: std::array::from_fn(|j| self.torque[j] + self.gravity[j] * self.q[j].sin()),
            tau_external: self.external,
        }
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        if command == ArmCommand::Hold {
            self.hold_at.get_or_insert(self.q);
        } else {
            self.hold_at = None;
        }
        let substeps = (step_s / LONGEST_STEP_S).ceil().clamp(1.0, 1000.0);
        for _ in 0..substeps as u32 {
            for joint in 0..JOINTS {
                self.joint(joint, command, step_s / substeps);
            }
        }
        self.state()
    }
}
