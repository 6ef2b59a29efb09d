//! The robot: what it is ([`Robot`], [`Tool`]), and what follows from that
//! ([`Arm`]: kinematics, Jacobians, dynamics).
//!
//! [`Robot`] is the serialisable description with any number of joints up to
//! [`MAX_JOINTS`](crate::MAX_JOINTS); it crosses wires and lies in files.
//! [`Arm`] is compiled from it for a fixed number of joints and a scalar, and
//! is what the control law and the plant compute with. Code that must serve a
//! number of joints known only at run time (identification of any robot's CSV)
//! uses the slice functions of [`kinematics`].
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
//! | FT | axes of Fn, origin at the TCP: the centre of a sphere on which the nest sits | orientations of poses |
//! | W | the plate; where it stands is found, not known | the spheres' certificate |
//! | T | the laser tracker, where there is one | its points |
//!
//! A file's own base and flange (URDF's `base_link`, `tool0`) may differ from F0
//! and Fn by constant transforms; the host keeps those, and nothing here knows them.
//!
//! # One row of the table
//!
#![doc = include_str!("row.svg")]
//!
//! `T_i = Rx(alpha) Tx(a) Ry(beta) Rz(theta + q) Tz(d)`, in [`MdhRow`]'s names.

mod arm;
mod builtin;
mod builtin_arms;
mod describe;
mod dynamics;
pub mod elbow;
pub mod kinematics;

pub use arm::Arm;
pub use builtin::{BUILT_IN, built_in, iiwa7, iiwa7_tool};
pub use describe::{Inertia, Joint, JointLimits, Robot, RobotError, Tool};
pub use dynamics::{Bodies, Dynamics, GRAVITY_M_S2};
pub use kinematics::{Frame, LinkTransform, MdhRow, ParameterColumns};
