#![doc = include_str!("../README.md")]
#![no_std]

#[cfg(test)]
extern crate std;

mod actuation;
mod control_loop;
#[cfg(test)]
mod control_loop_tests;
mod damping;
mod disturbance;
#[cfg(test)]
mod elastic_tests;
mod error;
#[cfg(test)]
mod explicit_tests;
mod giving;
mod guide;
mod impedance;
mod joint;
mod live;
#[cfg(test)]
mod live_tests;
mod null_space;
mod observer;
mod passivity;
mod snapshot;
mod stiffness;
#[cfg(test)]
mod testing;
mod torque;
mod torque_loop;

pub use actuation::Actuation;
pub use control_loop::{Goal, ImpedanceLoop, Output};
pub use disturbance::{Disturbance, Excess, beyond_sensors};
pub use error::LawError;
pub use giving::Giving;
pub use guide::guide_torque;
pub use impedance::{CartesianSetpoint, Impedance, rotation_about, rotation_error};
pub use joint::{JointSetpoint, JointSpring, joint_spring};
pub use live::Axes;
pub use null_space::NullSpace;
pub use observer::{Observer, Wrench};
pub use passivity::{EnergyLimit, Withheld};
pub use snapshot::Snapshot;
pub use stiffness::{FullStiffness, Stiffness};
pub use torque::{Shaped, TorqueShaper};
pub use torque_loop::{TorqueLoop, poles};
