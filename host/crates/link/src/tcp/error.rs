//! Errors of the links between processes, each with its remedy.

use spherecal_shared::protocol::frame::FrameError;

/// A key as it is printed: 16 hexadecimal digits.
fn hex(key: &[u8; 8]) -> String {
    key.iter().map(|byte| format!("{byte:02x}")).collect()
}

/// Why a TCP link cannot be used, or why it ended.
#[derive(Debug, thiserror::Error)]
pub enum TcpError {
    /// Nothing answers at the address.
    #[error("{peer} cannot be reached ({source}): start the program that listens there first, and check host and port")]
    Unreachable {
        /// Address as given.
        peer: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The program cannot listen at the address.
    #[error("cannot listen at {address} ({source}): give HOST:PORT of this machine, with a free port")]
    Listen {
        /// Address as given.
        address: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The other side closed the connection.
    #[error("{peer} closed the connection: its own output says why; then go on with --resume")]
    Closed {
        /// Who.
        peer: String,
    },
    /// The connection broke.
    #[error("the connection to {peer} broke ({source}): check the network, then go on with --resume")]
    Broken {
        /// Who.
        peer: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Nothing arrived in time.
    #[error(
        "{peer} was silent for {seconds} s ({damaged} damaged frames until then): see whether it still runs; \
         a lock-step drive must answer every command with one state (docs/drive-link.md); then go on with --resume"
    )]
    Silent {
        /// Who.
        peer: String,
        /// How long the program waited, in s.
        seconds: u64,
        /// Frames whose checksum or shape was wrong.
        damaged: u32,
    },
    /// Bytes came, but no valid frame.
    #[error(
        "{peer} sent {bytes} bytes in {seconds:.1} s and no valid frame ({damaged} damaged): \
         it does not speak this link; check host and port on both sides, and that one program alone uses them"
    )]
    Babble {
        /// Who.
        peer: String,
        /// Bytes since the last valid frame.
        bytes: usize,
        /// Time since the first of them, in s.
        seconds: f64,
        /// Frames among them whose checksum or shape was wrong.
        damaged: u32,
    },
    /// More messages came than one a period.
    #[error(
        "{peer} sent {count} {what} in {seconds:.1} s, far more than one a period: \
         in lock-step it must wait for the other side, in real time keep its period (docs/drive-link.md)"
    )]
    Flood {
        /// Who.
        peer: String,
        /// Which messages.
        what: &'static str,
        /// How many.
        count: u64,
        /// Within which time, in s.
        seconds: f64,
    },
    /// A lock-step drive does not wait for commands.
    #[error(
        "{peer} sent further states without waiting for a command, in {periods} periods: \
         a lock-step drive answers every command with one state (docs/drive-link.md)"
    )]
    Ahead {
        /// Who.
        peer: String,
        /// In how many periods.
        periods: u32,
    },
    /// A turn of the host link has no end.
    #[error(
        "{peer} sent {bytes} bytes without the end of a period: it does not speak the host link; check host and port"
    )]
    Endless {
        /// Who.
        peer: String,
        /// How many bytes.
        bytes: usize,
    },
    /// The other side does not read.
    #[error(
        "{peer} has not read for {seconds} s what was sent to it: it hangs or its network is down; then go on with --resume"
    )]
    Deaf {
        /// Who.
        peer: String,
        /// For how long, in s.
        seconds: u64,
    },
    /// The other side of a link in real time sends nothing.
    #[error(
        "{peer} sent no valid frame for {seconds} s: {what}; if that program still runs, check it and its network, \
         then go on with --resume"
    )]
    Gone {
        /// Who.
        peer: String,
        /// What becomes of the arm.
        what: &'static str,
        /// For how long, in s.
        seconds: u64,
    },
    /// A controller process did not say hello.
    #[error(
        "{peer} did not introduce itself as a controller within {seconds} s: check the port; \
         a controller serves one host at a time, so end the other host"
    )]
    Busy {
        /// The other side's address.
        peer: String,
        /// How long was waited.
        seconds: u64,
    },
    /// No hello arrived in time.
    #[error(
        "{peer} did not introduce itself as a drive within {seconds} s: check the port, and see docs/drive-link.md"
    )]
    NotADrive {
        /// The other side's address.
        peer: String,
        /// How long was waited.
        seconds: u64,
    },
    /// A message with another schema key.
    #[error(
        "{peer} sent a message with schema key {}, but {what} has {}: \
         it was built for another version of the protocol; use matching versions",
        hex(found),
        hex(expected)
    )]
    Schema {
        /// Who.
        peer: String,
        /// What was expected.
        what: &'static str,
        /// Key that came.
        found: [u8; 8],
        /// Key of what was expected.
        expected: [u8; 8],
    },
    /// A field of a message has a value that it cannot have.
    #[error(
        "{peer} sent {what} whose checksum is right, but {field} does not decode: a variant, a boolean or the length of \
         a list is none that the message has; encode it as docs/drive-link.md says"
    )]
    Field {
        /// Who.
        peer: String,
        /// Which message.
        what: &'static str,
        /// Which field.
        field: &'static str,
    },
    /// A drive began another session on the same connection.
    #[error(
        "{peer} sent the hello of session {found} in session {session}: a drive that starts again closes the connection \
         (docs/drive-link.md); then go on with --resume"
    )]
    Restarted {
        /// Who.
        peer: String,
        /// Its session.
        session: u32,
        /// The session of the later hello.
        found: u32,
    },
    /// The drive allows less than the robot's description promises.
    #[error(
        "joint {joint} of the drive has {what} {drive}, but the robot's description has {robot}: \
         use a description with the drive's limits (`spherecal robot convert`, then edit the limits), or widen the drive's"
    )]
    Limits {
        /// Joint, from 1.
        joint: usize,
        /// Which limit, with its unit.
        what: &'static str,
        /// The drive's limit.
        drive: f64,
        /// The description's limit.
        robot: f64,
    },
    /// A message does not fit a frame.
    #[error("a message cannot be framed: {0}")]
    Frame(#[from] FrameError),
}

impl TcpError {
    /// A transport error of the connection to `peer`.
    pub(super) fn of(peer: &str, source: std::io::Error) -> Self {
        use std::io::ErrorKind::{BrokenPipe, ConnectionAborted, ConnectionReset, UnexpectedEof};
        let peer = peer.to_owned();
        match source.kind() {
            BrokenPipe | ConnectionAborted | ConnectionReset | UnexpectedEof => Self::Closed { peer },
            _ => Self::Broken { peer, source },
        }
    }

    /// Whether the other side closed the connection.
    pub fn is_closed(&self) -> bool {
        matches!(self, Self::Closed { .. })
    }
}
