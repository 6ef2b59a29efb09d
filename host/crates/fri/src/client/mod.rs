//! The client: drives a real robot, or only watches it.
//!
//! - [`Client`] answers the cabinet and, once [enabled](Client::enable), commands a torque overlay.
//! - [`ReadOnlyClient`] only watches. It has no method that could command. Use it while a person guides the arm.
//!
//! # Life of a session
//! The cabinet leads; the client only answers.
//! ```text
//! session              what the client answers
//! IDLE                 nothing
//! MONITORING_WAIT      mirrors commandedJointPosition
//! MONITORING_READY     mirrors commandedJointPosition
//! COMMANDING_WAIT      if enabled: mirrors ipoData.jointPosition, torques zero; otherwise nothing
//! COMMANDING_ACTIVE    if enabled: mirrors ipoData.jointPosition, torques of the control law; otherwise nothing
//! ```
//! An unanswered motion makes the cabinet rate the connection down and end the motion with its brakes. That is how this
//! client stops: an overlay of zero would not hold the arm, because the cabinet's stiffness is 0.
//!
//! A safety stop, drives that are off, a session that falls back and a restarted cabinet are typed errors. Each disables
//! the client, so no torque leaves until [`Client::enable`] is called again.
//!
//! # What the client guarantees before it sends a torque
//! It is finite; it stays within [`TorqueLimits::torque`]; it changes by at most [`TorqueLimits::torque_rate`] against the last one.
//! A torque that had to be clamped is sent clamped and counted in [`LinkStatistics`].

mod config;
mod error;
mod link;
mod overlay;
mod sign;
mod velocity;

pub use config::{ClientConfig, TorqueLimits};
pub use error::{ClientError, CommandingEnd, EndCause};
pub use link::{LinkStatistics, MonitoredState, ReadOnlyClient};
pub use overlay::{Client, Cycle};
pub use sign::{MeasuredSign, measured_sign};
pub use velocity::VelocityFilter;
