//! A simple arm for the robot sides of tests and examples.

/// Joints.
const JOINTS: usize = 7;
/// Natural frequency of the position control, rad/s.
const HOLD_RAD_S: f64 = 60.0;

/// What moves a [`JointArm`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum JointDrive {
    /// These torques, N m, without gravity.
    Torque([f64; JOINTS]),
    /// The position control, to these positions, rad, and velocities, rad/s.
    Follow([f64; JOINTS], [f64; JOINTS]),
    /// The position control, at the pose where it began to hold.
    Hold,
    /// Nothing, behind closed brakes.
    Brake,
}

/// Seven independent joints with inertia, viscous friction and a load by gravity.
///
/// `inertia ddq = torque + gravity_error + external - friction dq`: the robot's gravity compensation cancels
/// `gravity sin(q)` but for `gravity_error`.
#[derive(Clone, Debug)]
pub struct JointArm {
    /// Amplitude of the gravity torque, N m.
    pub gravity: [f64; JOINTS],
    /// External joint torques, N m.
    pub external: [f64; JOINTS],
    /// External wrench that the robot reports, N and N m.
    pub wrench: [f64; 6],
    /// Inertia, kg m^2.
    inertia: [f64; JOINTS],
    /// Joint positions, rad.
    pub q: [f64; JOINTS],
    /// Joint velocities, rad/s.
    pub dq: [f64; JOINTS],
    torque: [f64; JOINTS],
    hold_at: Option<[f64; JOINTS]>,
}

impl JointArm {
    /// What the gravity compensation gets wrong, N m.
    const GRAVITY_ERROR: [f64; JOINTS] = [0.0, 0.2, 0.0, -0.2, 0.0, 0.0, 0.0];
    /// Viscous friction that the robot does not compensate, N m s/rad.
    const FRICTION: [f64; JOINTS] = [0.5, 0.5, 0.5, 0.5, 0.2, 0.2, 0.1];

    /// An arm at rest at `q` (rad) with these inertias (kg m^2) and amplitudes of the gravity torque (N m).
    pub fn new(q: [f64; JOINTS], inertia: [f64; JOINTS], gravity: [f64; JOINTS]) -> Self {
        let [dq, torque, external] = [[0.0; JOINTS]; 3];
        Self {
            gravity,
            external,
            wrench: [0.0; 6],
            inertia,
            q,
            dq,
            torque,
            hold_at: None,
        }
    }

    /// Measured joint torques, gravity included, N m.
    pub fn tau(&self) -> [f64; JOINTS] {
        std::array::from_fn(|j| self.torque[j] + self.gravity[j] * self.q[j].sin())
    }

    /// Moves on by `step_s`, in `substeps` steps.
    pub fn drive(&mut self, drive: JointDrive, step_s: f64, substeps: u32) {
        if drive == JointDrive::Hold {
            self.hold_at.get_or_insert(self.q);
        } else {
            self.hold_at = None;
        }
        for joint in (0..substeps).flat_map(|_| 0..JOINTS) {
            self.joint(joint, drive, step_s / f64::from(substeps));
        }
    }

    fn joint(&mut self, joint: usize, drive: JointDrive, step_s: f64) {
        let (q, dq, inertia) = (self.q[joint], self.dq[joint], self.inertia[joint]);
        let follow =
            |at: [f64; JOINTS], to_dq: f64| inertia * HOLD_RAD_S * (HOLD_RAD_S * (at[joint] - q) + 2.0 * (to_dq - dq));
        let torque = match (drive, self.hold_at) {
            (JointDrive::Torque(torque), _) => torque[joint],
            (JointDrive::Follow(at, to_dq), _) => follow(at, to_dq[joint]),
            (JointDrive::Hold, Some(at)) => follow(at, 0.0),
            _ => 0.0,
        };
        self.torque[joint] = torque;
        if drive == JointDrive::Brake {
            self.dq[joint] = 0.0;
            return;
        }
        let acting = torque + Self::GRAVITY_ERROR[joint] + self.external[joint] - Self::FRICTION[joint] * dq;
        self.dq[joint] += step_s * acting / inertia;
        self.q[joint] += step_s * self.dq[joint];
    }
}
