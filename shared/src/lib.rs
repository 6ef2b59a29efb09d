//! What the controller and the host of spherecal both know: the robot model,
//! the calibration procedure and the wire protocol.
//!
//! `no_std`, allocation-free and without `unsafe`, so that the very same code
//! runs on a Cortex-M7 and on a PC. This crate stands at the bottom of the
//! house: it knows neither the controller nor the host.
//!
//! ```text
//!            robot ── kinematics and dynamics, generic over joints and scalar
//!   shared ─ procedure ── Algorithm 2 of the paper as one validated configuration
//!            protocol ── drive link, host link, framing
//! ```
//!
//! Units are SI throughout (m, rad, N, s, kg); frames are named in each item.
//! "The paper" is Nadeau, Bonev and Joubair, *Impedance Control
//! Self-Calibration of a Collaborative Robot Using Kinematic Coupling*,
//! Robotics 2019, 8, 33.
#![no_std]

#[cfg(any(feature = "std", test))]
extern crate std;

pub mod linalg;
pub mod procedure;
pub mod protocol;
pub mod robot;
pub mod scalar;
pub mod timing;

/// Most joints that a robot of this system may have.
pub const MAX_JOINTS: usize = 8;

/// One value per joint, base to flange, as it travels on both links.
pub type Joints = heapless::Vec<f64, MAX_JOINTS>;
