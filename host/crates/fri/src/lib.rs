//! KUKA's Fast Robot Interface (FRI): the cyclic interface of the LBR iiwa and the LBR Med.
//!
//! Three rooms:
//! - [`wire`]: the two messages of the interface, encoded and decoded byte by byte.
//! - [`client`]: drives a real robot. It answers each message of the cabinet by the rules of the session and lays the
//!   torques of a control law over the cabinet's joint impedance, without allocating memory.
//! - [`robot`]: the cabinet's side. It goes through the session states, rates the connection by the answers and lets a
//!   simulated arm follow the overlay, so that the client can be tested without a robot.
//!
//! Data flow: arm → [`robot`] → UDP → [`client`] → the drive of the controller. The crate knows nothing of the rest of
//! spherecal. It contains no part of KUKA's software.
//!
//! # Conventions
//! - SI units everywhere: rad, rad/s, N m, s.
//! - The overlay is a joint torque **without** gravity: the cabinet compensates gravity with the load data of its
//!   application.
//! - The measured torque **includes** gravity. Its sign is not the same in all software versions: see
//!   [`client::measured_sign`].
//! - Names are KUKA's where KUKA has one (`COMMANDING_ACTIVE`, `jointTorque`), so that users find them.
//!
//! Nothing in this crate has been tried on a real robot.

pub mod client;
pub mod robot;
pub mod wire;

/// Number of joints of every arm that speaks this interface.
pub const JOINTS: usize = 7;
/// The client's UDP port if the application on the cabinet names no other.
pub const UDP_PORT: u16 = 30200;
