//! What is calibrated, and from what: the robot's model, its kinematics and the
//! measured data, as plain types.
//!
//! ```text
//!   robot file ─▶ robots ─▶ Robot ─▶ Chain (forward and inverse kinematics)
//!   CSV, plate file ─▶ input ─▶ Experiment (joint angles, and where the TCP was)
//! ```
//!
//! Lowest of the host's crates: it knows `spherecal-shared` only.

pub mod chain;
mod data;
mod error;
pub mod halton;
pub mod input;
pub mod robots;
mod shot;

pub use chain::{Chain, ChainError, TcpPose};
pub use data::{Experiment, Observation, Pose, Set, Sphere, Target, paper_plate};
pub use error::DataError;
pub use shot::{LaserShot, TrackerSession};
