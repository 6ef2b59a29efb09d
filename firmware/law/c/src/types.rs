//! What crosses the boundary.

use spherecal_law::{Output, Withheld};
use spherecal_shared::procedure::Law;
use spherecal_shared::robot::{Inertia, Joint, JointLimits, MdhRow, Tool};

/// What became of a call.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum SpherecalStatus {
    /// It was done.
    Ok = 0,
    /// A pointer is null.
    Null = 1,
    /// No built-in robot has this name.
    Unknown = 2,
    /// The robot, its tool or the number of its joints is not possible.
    Robot = 3,
    /// A number of the law, of the drive or the period is not possible.
    Law = 4,
    /// A stiffness is not symmetric, negative in some direction, or too large.
    Stiffness = 5,
    /// An energy is negative or not finite.
    Energy = 6,
    /// A goal is not finite, or its matrix is no rotation.
    Goal = 7,
    /// The state has a number that is not finite.
    State = 8,
}

/// Mass distribution of a body, in its frame.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalInertia {
    /// Mass, in kg.
    pub mass_kg: f64,
    /// Centre of mass, in m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass: xx, yy, zz, xy, xz, yz of the matrix, in kg m².
    pub inertia_kg_m2: [f64; 6],
}

/// A joint and the link that it moves: a row of modified Denavit-Hartenberg parameters, masses and limits.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalJoint {
    /// Twist about the last x axis, in rad.
    pub alpha_rad: f64,
    /// Length along it, in m.
    pub a_m: f64,
    /// Hayati's rotation about y after the twist, in rad; 0 in plain tables.
    pub beta_rad: f64,
    /// Angle that is added to the joint's, in rad.
    pub theta_rad: f64,
    /// Offset along the joint's axis, in m.
    pub d_m: f64,
    /// The link, in the joint's frame.
    pub link: SpherecalInertia,
    /// Smallest angle, in rad.
    pub min_rad: f64,
    /// Largest angle, in rad.
    pub max_rad: f64,
    /// Largest speed, in rad/s.
    pub velocity_rad_s: f64,
    /// Largest torque, in N m.
    pub torque_nm: f64,
    /// Inertia of the rotor at the link's side, in kg m².
    pub rotor_kg_m2: f64,
}

/// A robot of six or seven revolute joints.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalRobot {
    /// Number of joints.
    pub joints: u32,
    /// The joints from base to flange.
    pub joint: [SpherecalJoint; 7],
}

/// A tool at the flange, with the flange's axes.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalTool {
    /// Tool centre point, in m.
    pub tcp_m: [f64; 3],
    /// Mass distribution.
    pub body: SpherecalInertia,
}

/// Numbers of the law; `spherecal_law_default` writes good ones.
#[repr(C)]
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SpherecalLaw {
    /// Lehr's damping ratio of the Cartesian spring.
    pub damping_ratio: f64,
    /// Stiffness of the elbow or posture, in N m/rad.
    pub elbow_nm_rad: f64,
    /// Its damping ratio.
    pub elbow_damping_ratio: f64,
    /// Time of a ramp of the stiffness, in s.
    pub stiffness_ramp_s: f64,
    /// Largest rate of a torque, in N m/s.
    pub torque_rate_nm_s: f64,
    /// Pole of the observer, in 1/s.
    pub observer_rad_s: f64,
    /// Gain of the torque loop; 0 for a drive that has its own.
    pub torque_loop_gain: f64,
    /// Its corner frequency, in rad/s.
    pub torque_loop_rad_s: f64,
    /// Largest torque that it adds, in N m.
    pub torque_loop_nm: f64,
}

/// What the drive is like.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalDrive {
    /// Inertia of the motors between commanded and measured torque, in kg m²; 0 where the drive hides them.
    pub motor_kg_m2: [f64; 7],
    /// Time from a state to the torque that answers it, beyond the period, in s.
    pub latency_s: f64,
    /// Not 0: the drive adds the torque of gravity itself.
    pub carries_gravity: u8,
}

/// A Cartesian stiffness: two symmetric matrices, row by row.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalSpring {
    /// Translation, in N/m.
    pub translation_n_m: [f64; 9],
    /// Rotation, in N m/rad.
    pub rotation_nm_rad: [f64; 9],
    /// Not 0: in the axes of the tool, and not in those of the base.
    pub tool_axes: u8,
}

/// A pose that the TCP is pulled to.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalPose {
    /// Position, in m.
    pub position_m: [f64; 3],
    /// Orientation: a rotation matrix, row by row.
    pub rotation: [f64; 9],
    /// Velocity of the setpoint: linear in m/s, angular in rad/s.
    pub velocity: [f64; 6],
    /// Force (N) and moment (N m) that are added.
    pub feed_forward: [f64; 6],
}

/// Angles that the joints are pulled to.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalJointGoal {
    /// Angles, in rad.
    pub q_rad: [f64; 7],
    /// Speeds, in rad/s.
    pub dq_rad_s: [f64; 7],
    /// Natural frequency of every motion, in rad/s, up to 100.
    pub natural_rad_s: f64,
}

/// State of the joints; of an arm with six the last numbers are ignored.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalState {
    /// Angles, in rad.
    pub q_rad: [f64; 7],
    /// Speeds, in rad/s.
    pub dq_rad_s: [f64; 7],
    /// Torques that the actuators exert on their links, with gravity, in N m.
    pub tau_nm: [f64; 7],
}

/// What a cycle gives.
#[repr(C)]
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SpherecalOutput {
    /// Torques for the drive, in N m.
    pub torque_nm: [f64; 7],
    /// Position of the TCP, in m.
    pub position_m: [f64; 3],
    /// Its orientation, row by row.
    pub rotation: [f64; 9],
    /// Force of the environment on the arm at the TCP, in N.
    pub force_n: [f64; 3],
    /// Its moment, in N m.
    pub moment_nm: [f64; 3],
    /// Energy that the guard still has, in J; negative without a guard.
    pub tank_j: f64,
    /// First joint at its torque limit, from 1; 0: none.
    pub saturated: u8,
    /// 1: a rate of a torque was limited.
    pub rate_limited: u8,
    /// 1: the arm is near a singularity; stiffness and wrench mean less there.
    pub near_singular: u8,
    /// What the guard held back: 0 nothing, 1 a part of a change, 2 velocity and added force.
    pub withheld: u8,
}

impl SpherecalOutput {
    pub(crate) fn write<const N: usize>(&mut self, out: &Output<N>, tank_j: Option<f64>) {
        *self = Self::default();
        for (to, from) in self.torque_nm.iter_mut().zip(&out.torque) {
            *to = *from;
        }
        self.position_m = out.tcp.position.into();
        // Columns of the transposed matrix are rows.
        for (to, from) in self.rotation.iter_mut().zip(out.tcp.rotation.transpose().iter()) {
            *to = *from;
        }
        (self.force_n, self.moment_nm) = (out.wrench.force.into(), out.wrench.torque.into());
        self.tank_j = tank_j.unwrap_or(-1.0);
        self.saturated = out.limited.saturated;
        self.rate_limited = out.limited.rate_limited.into();
        self.near_singular = out.near_singular.into();
        self.withheld = match out.withheld {
            Withheld::Nothing => 0,
            Withheld::Change => 1,
            Withheld::Drive => 2,
        };
    }
}

impl From<&SpherecalInertia> for Inertia {
    fn from(body: &SpherecalInertia) -> Self {
        Self {
            mass_kg: body.mass_kg,
            com_m: body.com_m,
            inertia_kg_m2: body.inertia_kg_m2,
        }
    }
}

impl From<&SpherecalTool> for Tool {
    fn from(tool: &SpherecalTool) -> Self {
        Self {
            tcp_m: tool.tcp_m,
            body: (&tool.body).into(),
        }
    }
}

impl From<&SpherecalJoint> for Joint {
    fn from(joint: &SpherecalJoint) -> Self {
        Self {
            mdh: MdhRow {
                alpha: joint.alpha_rad,
                a: joint.a_m,
                beta: joint.beta_rad,
                theta: joint.theta_rad,
                d: joint.d_m,
            },
            link: (&joint.link).into(),
            limits: JointLimits {
                min_rad: joint.min_rad,
                max_rad: joint.max_rad,
                velocity_rad_s: joint.velocity_rad_s,
                torque_nm: joint.torque_nm,
            },
            rotor_kg_m2: joint.rotor_kg_m2,
        }
    }
}

impl From<&Joint> for SpherecalJoint {
    fn from(joint: &Joint) -> Self {
        Self {
            alpha_rad: joint.mdh.alpha,
            a_m: joint.mdh.a,
            beta_rad: joint.mdh.beta,
            theta_rad: joint.mdh.theta,
            d_m: joint.mdh.d,
            link: SpherecalInertia {
                mass_kg: joint.link.mass_kg,
                com_m: joint.link.com_m,
                inertia_kg_m2: joint.link.inertia_kg_m2,
            },
            min_rad: joint.limits.min_rad,
            max_rad: joint.limits.max_rad,
            velocity_rad_s: joint.limits.velocity_rad_s,
            torque_nm: joint.limits.torque_nm,
            rotor_kg_m2: joint.rotor_kg_m2,
        }
    }
}

impl From<Law> for SpherecalLaw {
    fn from(law: Law) -> Self {
        Self {
            damping_ratio: law.damping_ratio,
            elbow_nm_rad: law.elbow_nm_rad,
            elbow_damping_ratio: law.elbow_damping_ratio,
            stiffness_ramp_s: law.stiffness_ramp_s,
            torque_rate_nm_s: law.torque_rate_nm_s,
            observer_rad_s: law.observer_rad_s,
            torque_loop_gain: law.torque_loop_gain,
            torque_loop_rad_s: law.torque_loop_rad_s,
            torque_loop_nm: law.torque_loop_nm,
        }
    }
}

impl From<&SpherecalLaw> for Law {
    fn from(law: &SpherecalLaw) -> Self {
        Self {
            damping_ratio: law.damping_ratio,
            elbow_nm_rad: law.elbow_nm_rad,
            elbow_damping_ratio: law.elbow_damping_ratio,
            stiffness_ramp_s: law.stiffness_ramp_s,
            torque_rate_nm_s: law.torque_rate_nm_s,
            observer_rad_s: law.observer_rad_s,
            torque_loop_gain: law.torque_loop_gain,
            torque_loop_rad_s: law.torque_loop_rad_s,
            torque_loop_nm: law.torque_loop_nm,
            // The loop's own stiffness takes its place.
            ..Self::default()
        }
    }
}
