//! Reads a robot and commands nothing.
//!
//! [`ReadOnlyClient`] negotiates RTDE, asks for the fields that it needs and reads the stream. [`read_kinematics`] reads the
//! robot's own calibration from the primary interface. Neither sends a script, an input or a motion.

mod channel;
mod config;
mod error;
mod kinematics;
mod read_only;
mod state;

pub use config::ClientConfig;
pub use error::{ClientError, Unready};
pub use kinematics::read_kinematics;
pub use read_only::ReadOnlyClient;
pub use state::RobotState;
