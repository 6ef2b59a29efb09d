//! Reads a robot, and commands its torques.
//!
//! [`ReadOnlyClient`] negotiates RTDE, asks for the fields that it needs and reads the stream. [`read_kinematics`] reads the
//! robot's own calibration from the primary interface. Neither sends a script, an input or a motion.
//!
//! [`TorqueClient`] sends [our own program](crate::wire::PROGRAM) to the primary interface, and torques to its registers.
//! [`TorqueClient::ask`] ends a protective stop: by the dashboard ([`ask_dashboard`]), or by the Robot API of PolyScope X
//! ([`ask_robot_api`]).

mod channel;
mod dashboard;
mod error;
mod read_only;
mod robot_api;
mod rtde;
mod state;
mod torque;

pub use channel::ClientConfig;
pub use dashboard::{DashboardCommand, ask_dashboard, read_kinematics};
pub use error::{ClientError, ProgramEnd, Unready, remedy};
pub use read_only::ReadOnlyClient;
pub use robot_api::ask_robot_api;
pub use state::RobotState;
pub use torque::{TorqueClient, TorqueState};
