//! The messages of the interface, byte by byte.
//!
//! Two channels carry them:
//! - **TCP**, port 1337: requests and responses. Each begins with a [`CommandHeader`] of 12 bytes.
//! - **UDP**, 1 kHz: the robot sends a [`RobotState`]; the client answers with a [`RobotCommand`].
//!
//! All numbers are little-endian, without padding. The [`Version`]s differ in the numbers of the commands, in the
//! numbers of the statuses, in the size of the state and in the size of the command.
//!
//! Every decoder is total: it returns a [`WireError`] for bytes that are no message, and never panics. A number that is
//! not finite is refused where control depends on it (see [`RobotState::decode`]).
//!
//! Sources of the layouts: the interface's public headers (Apache-2.0) and measurements against the official client
//! libraries. `tests/official_clients.rs` repeats those measurements.

mod bytes;
mod command;
mod errors;
mod modes;
mod request;
mod status;
mod udp;
mod version;

pub use command::{CommandHeader, CommandKind, HEADER_SIZE, MAX_REQUEST};
pub use errors::{ErrorFlag, ErrorSet};
pub use modes::{ControllerMode, MotionGeneratorMode, MoveControllerMode, MoveGeneratorMode, RobotMode};
pub use request::{CollisionBehavior, ConnectAnswer, Deviation, FlangeLoad, MoveRequest, Request};
pub use status::{Response, Status};
pub(crate) use udp::IDENTITY;
pub use udp::{MAX_COMMAND_SIZE, MAX_STATE_SIZE, RobotCommand, RobotState, StateField};
pub use version::Version;

/// Why bytes are not a message of the interface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The message has another length than its version prescribes.
    #[error("{message} has {got} bytes, expected {expected}")]
    Length {
        /// Which message.
        message: &'static str,
        /// The length that the version prescribes, bytes.
        expected: usize,
        /// The length that came, bytes.
        got: usize,
    },
    /// The message ends inside a field.
    #[error("{message} ends after {got} bytes, inside the field {field}")]
    Short {
        /// Which message.
        message: &'static str,
        /// The field that is cut.
        field: &'static str,
        /// How many bytes came.
        got: usize,
    },
    /// A header announces more bytes than any message has, or fewer than the header.
    #[error("a header announces {size} bytes; a message has {HEADER_SIZE} to {most} bytes")]
    Size {
        /// The announced size, bytes.
        size: u32,
        /// The most that the receiver takes, bytes.
        most: usize,
    },
    /// The command number means nothing in this version.
    #[error("command number {number} is unknown in version {version}")]
    UnknownCommand {
        /// The number that came.
        number: u32,
        /// The version of the connection.
        version: Version,
    },
    /// The version is none that this crate speaks.
    #[error("interface version {0} is not supported; this program speaks 4 to 10")]
    UnknownVersion(u16),
    /// The command does not exist in this version.
    #[error("the command {command} does not exist in version {version}")]
    NotInVersion {
        /// The command's name.
        command: &'static str,
        /// The version of the connection.
        version: Version,
    },
    /// An enumeration has a value that means nothing.
    #[error("the field {field} has the value {value}, which means nothing")]
    UnknownValue {
        /// The field.
        field: &'static str,
        /// The value that came.
        value: u32,
    },
    /// A number is infinite or not a number.
    #[error("the field {field}[{index}] is not a finite number")]
    NotFinite {
        /// The field.
        field: &'static str,
        /// Which element, from 0.
        index: usize,
    },
    /// The robot model is not UTF-8 text.
    #[error("the robot model is not UTF-8 text")]
    NotText,
}

/// Feeds arbitrary bytes to every decoder of the crate. The first two bytes choose version and decoder.
///
/// For fuzz targets: it must return for every input. What a decoder accepts is encoded and decoded again; the second
/// result must equal the first.
///
/// # Panics
/// Never for any input, unless a decoder or encoder is wrong.
pub fn fuzz_decode(data: &[u8]) {
    let [choice, decoder, body @ ..] = data else { return };
    let version = Version::ALL[usize::from(*choice) % Version::ALL.len()];
    match decoder % 4 {
        0 => {
            if let Ok(state) = RobotState::decode(version, body) {
                let (mut first, mut second) = ([0; MAX_STATE_SIZE], [0; MAX_STATE_SIZE]);
                let size = state.encode(version, &mut first);
                // Bytes are compared: the state may contain numbers that are not equal to themselves.
                let back = RobotState::decode(version, &first[..size]).map(|s| s.encode(version, &mut second));
                assert_eq!(back, Ok(size));
                assert_eq!(first, second);
            }
        }
        1 => {
            if let Ok(command) = RobotCommand::decode(version, body) {
                let mut again = [0; MAX_COMMAND_SIZE];
                let size = command.encode(version, &mut again);
                assert_eq!(RobotCommand::decode(version, &again[..size]), Ok(command));
            }
        }
        2 => {
            let Ok(header) = CommandHeader::decode(body, MAX_REQUEST) else {
                return;
            };
            let payload = &body[HEADER_SIZE..];
            if let Ok(request) = Request::decode(version, header.command, payload) {
                let mut again = Vec::new();
                let encoded = request.encode(version, header.id, &mut again);
                assert_eq!(encoded, Ok(()));
                assert_eq!(
                    Request::decode(version, header.command, &again[HEADER_SIZE..]),
                    Ok(request)
                );
            }
        }
        _ => {
            let Ok(header) = CommandHeader::decode(body, spherecal_budget::robot::RESPONSE_BYTES) else {
                return;
            };
            let payload = &body[HEADER_SIZE..];
            let _ = Response::decode(version, header, payload);
            let _ = ConnectAnswer::decode(payload);
        }
    }
}
