//! The robot: its description ([`Robot`], [`Tool`]) and what is computed from it
//! ([`Arm`]: kinematics, Jacobians, dynamics).
//!
//! [`Robot`] is the serialisable description with up to
//! [`MAX_CHAIN`](crate::MAX_CHAIN) joints, for files; [`DrivenRobot`] is the same with up to
//! [`MAX_JOINTS`](crate::MAX_JOINTS), for controllers and links. [`Arm`] is
//! compiled from it for a fixed number of joints and a scalar; the control law and
//! the plant compute with it. Code for a number of joints that is known only at
//! run time (identification from a CSV file of any robot) uses the slice functions
//! of [`kinematics`]. [`Pose`] is the one rigid transform of the project.
//!
//! # The frames
//!
//! ```text
//!   F0 base ─ joint 1 ─ F1 ─ … ─ joint n ─ Fn flange ─ tool ─ FT (TCP)
//! ```
//!
#![doc = include_str!("frames.svg")]
//!
//! | frame | where it is | what is given in it |
//! |---|---|---|
//! | F0 | the robot's base, z up | TCP, forces, directions of approach, all plans |
//! | Fi | turns with joint i about its z axis (Craig's convention) | link i's mass and centre of mass |
//! | Fn | the flange: the last frame of the table | the tool: its TCP and its mass |
//! | FT | axes of Fn, origin at the TCP, which is the centre of a sphere when the nest is seated | orientations of poses |
//! | W | the plate; its pose in F0 is identified | the spheres' certificate |
//! | T | the laser tracker, if there is one | the tracker's points |
//!
//! The base and flange of a file (URDF's `base_link`, `tool0`) may differ from F0
//! and Fn by constant transforms. The host keeps those; this crate has none.
//!
//! # One row of the table
//!
#![doc = include_str!("row.svg")]
//!
//! `T_i = Rx(alpha) Tx(a) Ry(beta) Rz(theta + q) Tz(d)`, with the names of [`MdhRow`].

mod arm;
mod builtin;
mod builtin_arms;
pub mod compensator;
mod describe;
mod dynamics;
pub mod elbow;
pub mod kinematics;
mod pose;

pub use arm::Arm;
pub use builtin::{BUILT_IN, built_in, iiwa7, iiwa7_tool};
pub use describe::{DrivenRobot, Inertia, Joint, JointLimits, Robot, RobotError, Tool};
pub use dynamics::{Bodies, Dynamics, GRAVITY_M_S2};
pub use kinematics::{LinkTransform, MdhRow, ParameterColumns};
pub use pose::{Pose, PoseError};
