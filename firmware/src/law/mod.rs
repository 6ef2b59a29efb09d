//! The control law: what torque follows from a state and a setpoint.
//!
//! ```text
//!   DriveState ─▶ Snapshot ─▶ Impedance / joint law ─▶ torque
//!                    └─▶ Observer ─▶ wrench
//! ```
//!
//! Everything here is mathematics without phases: a [`Snapshot`] of the arm's
//! kinematics and dynamics is taken once a tick and serves law and observer.

mod damping;
mod guide;
mod impedance;
mod joint;
mod null_space;
mod observer;
mod snapshot;
mod stiffness;
mod torque;
mod torque_loop;

pub use damping::Damping;
pub use guide::guide_torque;
pub use impedance::{CartesianSetpoint, Impedance, rotation_error};
pub use joint::{JointSetpoint, joint_torque};
pub use null_space::NullSpace;
pub use observer::{Observer, Wrench};
pub use snapshot::{MOBILITY_FLOOR, Snapshot};
pub use stiffness::Stiffness;
pub use torque::{Shaped, TorqueShaper};
pub use torque_loop::TorqueLoop;
