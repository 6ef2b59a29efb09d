//! Why the client failed or a motion ended, with the robot's own names.

use std::net::SocketAddr;
use std::time::Duration;

use spherecal_cyclic::SocketError;

use crate::wire::{CommandKind, ErrorSet, RobotMode, Status, Version, WireError};

/// Why the client failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The host name has no address.
    #[error("cannot find the robot's host {host:?}: {source}")]
    Host {
        /// The name.
        host: String,
        /// What the resolver says.
        source: std::io::Error,
    },
    /// The robot does not accept connections.
    #[error("cannot connect to the robot at {address}: {source}; activate FCI in Desk, and check cable and address")]
    Connect {
        /// The address that was tried.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// The robot speaks none of the permitted versions.
    #[error(
        "the robot speaks interface version {robot}; this client may use {permitted:?}; update the robot's system or permit its version"
    )]
    Version {
        /// The robot's version.
        robot: u16,
        /// The versions of the configuration.
        permitted: Vec<u16>,
    },
    /// The robot's version is one that is only read.
    #[error("interface version {version} is only read, and moves no robot; update the robot's system")]
    ReadOnly {
        /// The robot's version.
        version: Version,
    },
    /// A system call failed.
    #[error(transparent)]
    Io(#[from] SocketError),
    /// The robot sent bytes that are no message.
    #[error("the robot sent an invalid message: {0}")]
    Wire(#[from] WireError),
    /// No state came in time: cable, network or robot.
    #[error("no state from the robot for {after:?}; check cable and network")]
    Silent {
        /// How long the client waited.
        after: Duration,
    },
    /// No response came in time.
    #[error("the robot did not answer {command} within {after:?}")]
    NoResponse {
        /// The request.
        command: CommandKind,
        /// How long the client waited.
        after: Duration,
    },
    /// The robot closed the connection, or was restarted.
    #[error("the robot closed the connection; activate FCI in Desk and connect again")]
    Closed,
    /// The robot refused a request.
    #[error("the robot refused {command}: {status} (mode {mode})")]
    Refused {
        /// The request.
        command: CommandKind,
        /// The robot's answer.
        status: Status,
        /// The robot's mode in the newest state.
        mode: RobotMode,
    },
    /// The robot is not ready for a motion.
    #[error("the robot is not ready for a motion: mode {mode}, {errors}")]
    NotReady {
        /// The robot's mode.
        mode: RobotMode,
        /// The active errors.
        errors: ErrorSet,
    },
    /// The motion ended without the client's wish.
    #[error("{0}")]
    Ended(#[from] MotionEnd),
    /// A command was to be sent although no motion runs, or without a new state.
    #[error("no command was sent: no motion runs, or the newest state has been answered")]
    NothingToAnswer,
    /// The control law computed a torque that is not finite. Nothing was sent.
    #[error("the torque of joint {joint} is not a finite number; no command was sent")]
    TorqueNotFinite {
        /// The joint, from 1.
        joint: usize,
    },
}

/// Why a motion ended.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum EndCause {
    /// The robot detected an error and stopped itself.
    Reflex,
    /// The user stop was pressed.
    UserStop,
    /// A safety function stopped the motion.
    SafetyFunction,
    /// A person began to guide the arm.
    Guiding,
    /// The motion was stopped by request.
    Preempted,
    /// The robot took a command for invalid.
    InvalidCommand,
    /// The robot ended the motion for another reason.
    Other,
}

/// How a motion ended without the client's wish.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("the motion ended: {words} ({errors}); robot mode {mode}, success rate before {success_rate:.2}", words = .cause.words())]
pub struct MotionEnd {
    /// Why.
    pub cause: EndCause,
    /// The robot's own errors: the active ones and the reflex reason.
    pub errors: ErrorSet,
    /// The robot's mode after the end.
    pub mode: RobotMode,
    /// The status of the Move response; `None` if it did not come in time.
    pub status: Option<Status>,
    /// The success rate of the commands in the last state of the motion.
    pub success_rate: f64,
}

impl EndCause {
    /// The cause in words.
    pub const fn words(self) -> &'static str {
        match self {
            Self::Reflex => "the robot stopped by a reflex",
            Self::UserStop => "the user stop was pressed",
            Self::SafetyFunction => "a safety function stopped the robot",
            Self::Guiding => "a person began to guide the arm",
            Self::Preempted => "the motion was stopped by request",
            Self::InvalidCommand => "the robot took a command for invalid",
            Self::Other => "the robot ended the motion",
        }
    }

    /// The cause from the status of the Move response and the mode of the newest state. The status is the more precise.
    pub(super) const fn new(status: Option<Status>, mode: RobotMode) -> Self {
        match (status, mode) {
            (Some(Status::ReflexAborted), _) => Self::Reflex,
            (Some(Status::EmergencyAborted), _) => Self::UserStop,
            (Some(Status::PreemptedBySafetyFunction | Status::RejectedBySafetyFunction), _) => Self::SafetyFunction,
            (Some(Status::InputErrorAborted), _) => Self::InvalidCommand,
            (_, RobotMode::Reflex) => Self::Reflex,
            (_, RobotMode::UserStopped) => Self::UserStop,
            (_, RobotMode::Guiding) => Self::Guiding,
            (Some(Status::Preempted), _) => Self::Preempted,
            _ => Self::Other,
        }
    }
}
