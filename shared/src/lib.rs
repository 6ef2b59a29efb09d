//! What the controller, the drive and the host of spherecal share: the robot
//! model, the calibration procedure, the wire protocol and the timing of ticks.
//!
//! The crate is `no_std`, allocates nothing and has no `unsafe` code, so the same
//! code runs on a microcontroller and on a PC. It is the lowest crate of the
//! project: it knows neither the controller nor the host.
//!
//! ```text
//!            robot ── kinematics and dynamics, generic over joints and scalar
//!   shared ─ procedure ── Algorithm 2 of the paper as one checked configuration
//!            protocol ── drive link, host link, framing
//!            timing ── missed control periods; device time of a tick
//! ```
//!
//! All units are SI (m, rad, N, s, kg). Each item names its frames. "The paper"
//! is Nadeau, Bonev and Joubair, *Impedance Control Self-Calibration of a
//! Collaborative Robot Using Kinematic Coupling*, Robotics 2019, 8, 33.
#![no_std]

#[cfg(any(feature = "std", test))]
extern crate std;

pub mod linalg;
pub mod procedure;
pub mod protocol;
pub mod robot;
pub mod scalar;
pub mod timing;

/// Largest number of joints of a robot that a controller drives, and that both links carry.
pub const MAX_JOINTS: usize = 8;

/// Largest number of joints of a chain that the host identifies: an arm on a torso on a rail has ten, a humanoid from
/// foot to hand some fifteen.
pub const MAX_CHAIN: usize = 20;

/// One value per joint, base to flange, as both links carry it.
pub type Joints = heapless::Vec<f64, MAX_JOINTS>;
