//! The robot's side: RTDE and the primary interface in front of a simulated arm.
//!
//! [`RobotSide`] serves any number of clients, up to eight. It knows every output that a robot has by name; those that it
//! does not simulate (currents, voltages, temperatures, digital inputs) are zero. Inputs are kept and can be read back. It
//! interprets no script: it knows [our program](crate::wire::PROGRAM) by its text, and that of `ur-rtde`, as far as it moves
//! joints, and refuses others.
//! The primary interface sends the robot's calibration after a connection; the dashboard, and on PolyScope X the Robot API, know
//! the requests that end a protective stop.

mod controls;
mod dashboard;
mod mover;
mod outputs;
mod ports;
mod programs;
mod registers;
mod robot_api;
mod server;
mod ur_rtde;

pub use controls::{ArmCommand, ArmHardware, ArmState, Controls, RobotConfig, RobotStatistics};
pub use server::{RobotSide, start_robot};
