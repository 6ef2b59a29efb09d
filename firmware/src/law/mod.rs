//! The control law: computes the torque from a state and a setpoint.
//!
//! ```text
//!   DriveState ─▶ Snapshot ─▶ Impedance / joint law ─▶ torque
//!                    └─▶ Observer ─▶ wrench
//! ```
//!
//! This module knows no phases. A [`Snapshot`] holds the arm's kinematics and
//! dynamics of one tick; law and observer share it.

mod damping;
mod disturbance;
#[cfg(test)]
mod elastic_tests;
#[cfg(test)]
mod explicit_tests;
mod giving;
mod guide;
mod impedance;
mod joint;
mod null_space;
mod observer;
mod snapshot;
mod stiffness;
mod torque;
mod torque_loop;

pub(crate) use disturbance::{Disturbance, Excess, beyond_sensors};
pub(crate) use giving::Giving;
pub(crate) use guide::guide_torque;
pub use impedance::{CartesianSetpoint, Impedance, rotation_error};
pub use joint::{JointSetpoint, JointSpring, joint_spring};
pub use null_space::NullSpace;
pub use observer::{Observer, Wrench};
pub use snapshot::{Actuation, Snapshot};
pub use stiffness::Stiffness;
pub use torque::{Shaped, TorqueShaper};
pub(crate) use torque_loop::{TorqueLoop, poles};
