//! Why the client failed or a motion ended, with KUKA's own names.

use std::net::SocketAddr;
use std::time::Duration;

use spherecal_cyclic::SocketError;

use crate::wire::{ClientCommandMode, Quality, SafetyState, SessionState, WireError};

/// Why the client failed.
#[derive(Debug, thiserror::Error)]
pub enum ClientError {
    /// The port cannot be opened.
    #[error("cannot listen at {address}: {source}; is another client running?")]
    Listen {
        /// The address.
        address: SocketAddr,
        /// What the system says.
        source: std::io::Error,
    },
    /// A system call failed.
    #[error(transparent)]
    Io(#[from] SocketError),
    /// The cabinet sent bytes that are no message.
    #[error("the cabinet sent an invalid message: {0}")]
    Wire(#[from] WireError),
    /// No message came in time: cable, network, or no session on the cabinet.
    #[error("no message from the cabinet for {after:?}; start the application on the cabinet, check cable and network")]
    Silent {
        /// How long the client waited.
        after: Duration,
    },
    /// The client is not enabled, or the newest message has been answered.
    #[error("no command was sent: the client is not enabled, or the newest message has been answered")]
    NothingToAnswer,
    /// The control law computed a torque that is not finite. Nothing was sent.
    #[error("the torque of joint {joint} is not a finite number; no command was sent")]
    TorqueNotFinite {
        /// The joint, from 1.
        joint: usize,
    },
    /// The robot may not be commanded: enabling was refused.
    #[error("the robot may not be commanded: {0}")]
    NotReady(EndCause),
    /// Commanding ended without the client's wish. The client is disabled.
    #[error("{0}")]
    Ended(#[from] CommandingEnd),
}

/// Why commanding ended or cannot begin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EndCause {
    /// A safety function stops the robot.
    #[error("safety stop ({0})")]
    SafetyStop(SafetyState),
    /// The cabinet does not say whether a safety function stops the robot.
    #[error("the cabinet does not send its safety state")]
    SafetyUnknown,
    /// A drive went off.
    #[error("the drives are off")]
    DrivesOff,
    /// The session fell back: the connection was too bad, or the application ended its motion.
    #[error("the session went from {from} to {to}")]
    SessionFell {
        /// The session's state before.
        from: SessionState,
        /// The session's state now.
        to: SessionState,
    },
    /// The application commands by something else than torques.
    #[error("the application's client command mode is {0}, not TORQUE")]
    CommandMode(ClientCommandMode),
    /// The cabinet or its application was restarted.
    #[error("the cabinet was restarted")]
    Restarted,
}

/// How commanding ended without the client's wish.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("commanding ended: {cause} (quality {quality})")]
pub struct CommandingEnd {
    /// Why.
    pub cause: EndCause,
    /// The session's state now.
    pub session: SessionState,
    /// The connection's quality now.
    pub quality: Quality,
}
