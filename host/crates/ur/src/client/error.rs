//! Why the client failed, in the robot's own words.

use std::net::SocketAddr;
use std::time::Duration;

use spherecal_cyclic::SocketError;

use crate::wire::{ControllerVersion, HTTP_FORBIDDEN, PROTOCOL, RobotMode, SafetyMode, WireError, words};

/// Why the client failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The host's name means nothing here.
    #[error("{host}: {source}: give the address that the robot shows under Settings, System, Network")]
    Name {
        /// As given.
        host: String,
        /// What the system says.
        source: std::io::Error,
    },
    /// Nobody listens there.
    #[error(
        "cannot connect to the robot at {address}: {source}; switch the controller on, and enable RTDE and the primary \
         interface under Settings, Security, Services"
    )]
    Connect {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// A system call failed.
    #[error(transparent)]
    Io(#[from] SocketError),
    /// The robot closed the connection.
    #[error("the robot closed the connection: it restarts, or another program took its place")]
    Closed,
    /// The robot sent bytes that are no package.
    #[error("the robot sent an invalid package: {0}")]
    Wire(#[from] WireError),
    /// No answer came in time.
    #[error("no answer from the robot to \"{request}\" within {after:?}; is this port its {interface}?")]
    NoAnswer {
        /// What was asked for.
        request: &'static str,
        /// Where.
        interface: &'static str,
        /// How long the client waited.
        after: Duration,
    },
    /// The robot does not speak the protocol.
    #[error("the robot does not speak RTDE protocol {PROTOCOL}: update its software")]
    Protocol,
    /// The robot lacks a field that is needed.
    #[error("the robot (software {version}) does not know the RTDE field {field}: update its software")]
    Field {
        /// The field.
        field: &'static str,
        /// The robot's software.
        version: ControllerVersion,
    },
    /// The robot gives a field another type.
    #[error("the robot gives the RTDE field {field} the type {found}, expected {expected}")]
    Type {
        /// The field.
        field: &'static str,
        /// What it says.
        found: String,
        /// What it should say.
        expected: &'static str,
    },
    /// Another client writes a register that our program reads.
    #[error(
        "another client of the robot writes the RTDE input {field}: end the other program (or fieldbus) that uses this robot"
    )]
    InUse {
        /// The register.
        field: &'static str,
    },
    /// The robot has no torque interface.
    #[error(
        "the robot's software {version} takes no torques: direct_torque needs PolyScope 5.25.1 on an e-Series robot, or PolyScope \
         X 10.12.1; by positions an arm would move at down to 0.3 mm/s under 5 N on a sphere, and a CB3 feels forces within 10 N only. Update an \
         e-Series robot, or give contacts by hand (`spherecal collect`)"
    )]
    NoTorques {
        /// The robot's software.
        version: ControllerVersion,
    },
    /// The Robot API of PolyScope X refused something.
    #[error("the robot's Robot API refused \"{request}\" (HTTP status {status}: {said}): {}", remedy(*.status))]
    RobotApi {
        /// What was asked for.
        request: &'static str,
        /// The status of its answer.
        status: u16,
        /// Its words.
        said: String,
    },
    /// The robot refused to send.
    #[error("the robot refused \"{request}\"")]
    Refused {
        /// What was asked for.
        request: &'static str,
    },
    /// No data package came in time: cable, network, or the robot restarts.
    #[error("no data from the robot for {after:?}; check cable and network")]
    Silent {
        /// How long the client waited.
        after: Duration,
    },
    /// The robot's joint angles mean nothing now, or nobody can guide the arm.
    #[error(transparent)]
    Unready(#[from] Unready),
}

/// Why the arm cannot be guided by hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum Unready {
    /// The arm is not switched on.
    #[error("the robot is in the mode {}: switch the arm on and release its brakes at the teach pendant", mode_words(*.0))]
    Mode(i32),
    /// The safety system stops the arm.
    #[error("the robot is stopped ({}): remove the cause, and unlock it at the teach pendant", safety_words(*.0))]
    Stopped(i32),
}

/// Why the program of torques does not run any more.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum ProgramEnd {
    /// The robot is stopped or switched off.
    #[error("{0}")]
    Unready(Unready),
    /// The robot is ready, but the program has ended: a person stopped it, another took its place, or no torque came for 24 ms.
    #[error("the robot's program has ended: a person or another client stopped it, or no torques came for 24 ms")]
    Ended,
}

/// What a person does where the Robot API answers with this HTTP status.
pub const fn remedy(status: u16) -> &'static str {
    match status {
        HTTP_FORBIDDEN => "choose automatic mode and remote control at the teach pendant (in the safety overview)",
        _ => "do it at the teach pendant",
    }
}

fn mode_words(number: i32) -> String {
    words(RobotMode::from_number(number).map(RobotMode::name), number)
}

fn safety_words(number: i32) -> String {
    words(SafetyMode::from_number(number).map(SafetyMode::name), number)
}
