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
//! ```text
//!   F0 base ─ joint 1 ─ F1 ─ … ─ joint n ─ Fn flange ─ tool ─ FT (TCP)
//! ```
//!
//! Frame Fi turns with joint i about its z axis (Craig's convention).

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
