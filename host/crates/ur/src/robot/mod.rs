//! The robot's side: RTDE and the primary interface in front of a simulated arm.
//!
//! [`RobotSide`] serves any number of clients, up to eight. It knows every output that a robot has by name; those that it
//! does not simulate (currents, voltages, temperatures, digital inputs) are zero. Inputs are kept and can be read back, and
//! move nothing: it runs no script. The primary interface sends the robot's calibration after a connection, and nothing
//! more.

mod arm;
mod config;
mod outputs;
mod registers;
mod server;
mod session;

pub use arm::{ArmHardware, ArmState};
pub use config::RobotConfig;
pub use server::{Controls, RobotSide, RobotStatistics};
