//! The messages of the interface, byte by byte.
//!
//! Both travel by UDP, at most 1,500 bytes each, in protocol buffers (proto2): the cabinet sends a
//! [`MonitoringMessage`] each period, the client answers with a [`CommandMessage`]. [`Framing`] says how a datagram carries
//! its message.
//!
//! Encoder and decoder are our own because a real-time loop may not allocate: they work on arrays of seven joints. The
//! tests hold them against `prost`. Repeated doubles are written one key for each value, as the cabinet does; packed ones
//! are read too. Fields that the crate does not know are skipped.
//!
//! Every decoder is total: it returns a [`WireError`] for bytes that are no message, and never panics. A number that is
//! not finite is refused.

mod command;
mod enums;
mod framing;
mod monitoring;
mod protobuf;

pub use command::CommandMessage;
pub use enums::{
    ClientCommandMode, ControlMode, DriveState, OperationMode, OverlayType, Quality, SafetyState, SessionState,
};
pub use framing::{Checksum, EndOfMessage, Framing, MAX_DATAGRAM_SIZE};
pub use monitoring::{ConnectionInfo, IpoData, MonitoringMessage, RobotInfo, Timestamp};

/// The largest message, bytes.
pub const MAX_MESSAGE_SIZE: usize = 1500;

/// Why bytes are not a message of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The bytes are not protocol buffers: a key, a length or a number is cut or impossible.
    #[error("byte {at} of {message} is not a protocol buffer")]
    Malformed {
        /// The innermost message that is broken.
        message: &'static str,
        /// Where, counted from that message's beginning.
        at: usize,
    },
    /// A known field has another kind of value than documented.
    #[error("the field {field} has an unexpected kind of value")]
    Kind {
        /// The field.
        field: &'static str,
    },
    /// A field that the message needs is missing.
    #[error("the field {field} is missing")]
    Missing {
        /// The field.
        field: &'static str,
    },
    /// The message is of another kind.
    #[error("the message identifier is {got:#x}, expected {expected:#x}")]
    Identifier {
        /// The identifier of this kind of message.
        expected: u32,
        /// The identifier that came.
        got: u32,
    },
    /// A field has not one value for each joint (or axis).
    #[error("the field {field} has {got} values, expected {expected}")]
    Count {
        /// The field.
        field: &'static str,
        /// How many there should be.
        expected: usize,
        /// How many came; counting stops at one too many.
        got: usize,
    },
    /// An enumeration has a value that means nothing.
    #[error("the field {field} has the value {value}, which means nothing")]
    UnknownValue {
        /// The field.
        field: &'static str,
        /// The value that came.
        value: u64,
    },
    /// A number is infinite or not a number.
    #[error("the field {field}[{index}] is not a finite number")]
    NotFinite {
        /// The field.
        field: &'static str,
        /// Which element, from 0.
        index: usize,
    },
    /// The message has more than 1,500 bytes.
    #[error("the message has {got} bytes, at most {MAX_MESSAGE_SIZE} are permitted")]
    TooLong {
        /// How many bytes it has.
        got: usize,
    },
}

/// Feeds arbitrary bytes to both decoders. For fuzz targets: it must return for every input. What a decoder accepts is
/// encoded and decoded again; the second result must equal the first.
///
/// # Panics
/// Never for any input, unless a decoder or encoder is wrong.
pub fn fuzz_decode(data: &[u8]) {
    let (framing, data, _) = Framing::open(data);
    let mut datagram = [0; MAX_DATAGRAM_SIZE];
    if data.len() <= MAX_MESSAGE_SIZE {
        let size = framing.close(data, &mut datagram);
        assert_eq!(Framing::open(&datagram[..size]).1, data);
    }
    let mut bytes = [0; MAX_MESSAGE_SIZE];
    if let Ok(message) = MonitoringMessage::decode(data) {
        let message = MonitoringMessage { end: None, ..message };
        let size = message.encode(&mut bytes, false);
        let again = size.and_then(|s| MonitoringMessage::decode(&bytes[..s]));
        assert_eq!(again, Ok(message));
    }
    if let Ok(command) = CommandMessage::decode(data) {
        let command = CommandMessage { end: None, ..command };
        let size = command.encode(&mut bytes, false);
        let again = size.and_then(|s| CommandMessage::decode(&bytes[..s]));
        assert_eq!(again, Ok(command));
    }
}
