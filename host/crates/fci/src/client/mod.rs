//! The client: drives a real robot, or only watches it.
//!
//! - [`Client`] moves the robot: load, thresholds, a torque motion, stop, error recovery.
//! - [`ReadOnlyClient`] only reads states. It has no method that could move the robot. Use it while a person guides the arm.
//!
//! # Life of a motion
//! ```text
//! connect -> Idle -- start_torque_motion --> Moving -- finish or stop --------> Idle
//!                                              |
//!                                              +-- reflex, user stop, ... --> Stopped -- recover --> Idle
//! ```
//! While it moves, call [`Client::exchange`] in a loop: it waits for the robot's newest state, calls the control law and
//! answers. The loop allocates no memory. Each state is answered at most once, and only if it shows that the motion
//! still runs; so no command leaves after a stop.
//!
//! # What the client guarantees before it sends a torque
//! - it is finite, or the call fails and nothing is sent;
//! - it stays within the torque limits ([`TorqueLimits::torque`]);
//! - it changes by at most [`TorqueLimits::torque_rate`] per millisecond, against the robot's last desired torque and against
//!   the last command sent.
//!
//! A command that had to be clamped is sent clamped and counted in [`LinkStatistics`].

mod config;
mod error;
mod link;
mod motion;
mod read_only;
mod tcp;

pub use config::{ClientConfig, TorqueLimits};
pub use error::{ClientError, EndCause, MotionEnd};
pub use link::LinkStatistics;
pub use motion::{Client, Cycle};
pub use read_only::{ReadOnlyClient, Reading};
