//! The Franka Control Interface (FCI): the 1 kHz interface of the robots Panda and FR3.
//!
//! Three rooms:
//! - [`wire`]: every message of the interface, encoded and decoded byte by byte, in the versions 4 to 10.
//! - [`client`]: drives a real robot. It connects, sets load and collision thresholds, starts a torque motion and
//!   exchanges one state and one command each millisecond without allocating memory.
//! - [`robot`]: the robot side. It speaks the protocol as a Panda or an FR3 and keeps the robot's own limits, so that
//!   our client and the official client libraries can be tested without a robot.
//!
//! Data flow: arm → [`robot`] → UDP and TCP → [`client`] → the drive of the controller. The crate knows nothing of the
//! rest of spherecal.
//!
//! # Conventions
//! - SI units everywhere: rad, rad/s, N m, s, m, kg. A 4 x 4 pose is column-major, as the robot sends it.
//! - The torque that a client commands (`tau_J_d`) is **without** gravity and without friction. The robot adds both.
//! - The measured torque (`tau_J`) is the link-side torque sensor and **includes** gravity. At rest it is the
//!   torque that holds the arm, in the direction of positive joint motion.
//! - Field names are those of the robot's maker (`O_T_EE`, `tau_J_d`), so that users find them.
//!
//! Nothing in this crate has been tried on a real robot. The official client libraries `panda-python` 1.1.1 (version 5)
//! and `pylibfranka` 0.21.3 (version 10) run against [`robot`]; see `scripts/official-clients.sh`.

pub mod client;
pub mod robot;
pub mod wire;

/// Number of joints of every arm that speaks this interface.
pub const JOINTS: usize = 7;
/// The TCP port of the robot. The official clients know no other.
pub const TCP_PORT: u16 = 1337;
/// The robot's period: one state each millisecond, s.
pub const PERIOD_S: f64 = 1e-3;
