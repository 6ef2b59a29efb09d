//! What travels between robot and client, byte by byte.
//!
//! RTDE: each package is `u16` size (header included), `u8` kind, payload: a [`Request`] of the client or an [`Answer`] of the
//! robot. A client negotiates protocol 2, names the fields that it wants (the *recipe*) and their rate, and starts the stream
//! of data packages. The
//! [primary interface](primary) sends the robot's own calibration once after the connection, and takes [`PROGRAM`]. The Robot
//! API of PolyScope X speaks HTTP: an [`HttpRequest`] and an [`HttpAnswer`] on each connection.
//!
//! Every decoder is total: it returns a [`WireError`] for bytes that are no package, and never panics.

mod bytes;
mod data;
mod fields;
mod http;
mod modes;
mod package;
pub mod primary;
mod program;
mod value;

pub(crate) use bytes::Bytes as Reader;
pub(crate) use data::{Taken, data_package, take_data};
pub use fields::{input_type, output_type};
pub use http::{HTTP_CONFLICT, HTTP_FORBIDDEN, HTTP_OK, HttpAnswer, HttpRequest, ROBOT_API};
pub use modes::{RobotMode, RuntimeState, SafetyMode, Series, words};
pub use package::{
    Answer, ControllerVersion, HEADER_SIZE, MAX_ANSWER, MAX_NAMES, MAX_REQUEST, PROTOCOL, PackageKind, Recipe, Request,
    Setup, TextLevel, TextMessage, take_package,
};
pub use primary::KinematicsInfo;
pub use program::{ACKNOWLEDGED, INPUTS, Load, Order, PATIENCE_STEPS, PROGRAM, SERVO_LOOKAHEAD_S, program_name};
pub use value::{FieldType, IN_USE, NOT_FOUND, Value};

use spherecal_budget::robot::HTTP_BYTES;

/// Why bytes are no package.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum WireError {
    /// The package ends before its last field.
    #[error("a package of kind {kind} ends in the field {field}")]
    Cut {
        /// What is read.
        kind: &'static str,
        /// The field that is cut.
        field: &'static str,
    },
    /// A package has more bytes than its fields.
    #[error("a package of kind {kind} has {left} bytes too many")]
    TooLong {
        /// What is read.
        kind: &'static str,
        /// Bytes behind the last field.
        left: usize,
    },
    /// A size that no package has.
    #[error("a package of {size} bytes cannot be: give {least} to {most}")]
    Size {
        /// What the header says.
        size: usize,
        /// Header alone.
        least: usize,
        /// The largest that is accepted.
        most: usize,
    },
    /// An enumeration has a value that means nothing.
    #[error("the field {field} has the value {value}, which means nothing")]
    UnknownValue {
        /// The field.
        field: &'static str,
        /// The value that came.
        value: i32,
    },
    /// A type of a field that is none.
    #[error("the robot names the type \"{name}\", which is unknown")]
    UnknownType {
        /// The type, as it came.
        name: String,
    },
    /// Text that is not UTF-8.
    #[error("the text of a package of kind {kind} is not UTF-8")]
    Text {
        /// What is read.
        kind: &'static str,
    },
    /// A message that is no HTTP.
    #[error("a message of HTTP {fault}")]
    Http {
        /// What is wrong with it.
        fault: &'static str,
    },
    /// A number that is not finite.
    #[error("the field {field} is not a finite number")]
    NotFinite {
        /// The field.
        field: &'static str,
    },
}

/// Decodes the bytes as a stream of each interface, for fuzzing. What was decoded is encoded and decoded again; the second
/// result must equal the first.
///
/// # Panics
/// Never for any input, unless a decoder or encoder is wrong.
pub fn fuzz_decode(data: &[u8]) {
    let mut received = data.to_vec();
    while let Ok(Some((kind, payload))) = take_package(&mut received, MAX_ANSWER) {
        let again = |bytes: Vec<u8>| {
            take_package(&mut { bytes }, MAX_ANSWER)
                .ok()
                .flatten()
                .unwrap_or((kind, Vec::new()))
                .1
        };
        // A text with letters of another encoding grows, and may be cut.
        let text = kind == PackageKind::Text;
        match Request::decode(kind, &payload) {
            Ok(request) if !text => assert_eq!(Request::decode(kind, &again(request.encode())), Ok(request)),
            _ => {}
        }
        match Answer::decode(kind, &payload) {
            Ok(answer) if !text => assert_eq!(Answer::decode(kind, &again(answer.encode())), Ok(answer)),
            _ => {}
        }
        for &kind in FieldType::ALL {
            let fields = vec![(String::new(), kind)];
            let _ = Recipe { fields }.decode(&payload);
        }
    }
    // With its own lines a message may become too long.
    let again = |bytes: &[u8]| bytes.len() <= HTTP_BYTES;
    if let Ok(Some(request)) = HttpRequest::decode(data) {
        let bytes = request.encode("robot");
        assert!(!again(&bytes) || HttpRequest::decode(&bytes) == Ok(Some(request)));
    }
    for closed in [false, true] {
        if let Ok(Some(answer)) = HttpAnswer::decode(data, closed) {
            let bytes = answer.encode();
            assert!(!again(&bytes) || HttpAnswer::decode(&bytes, false) == Ok(Some(answer)));
        }
    }
    let mut received = data.to_vec();
    while let Ok(Some((kind, payload))) = primary::take_primary(&mut received) {
        if let Ok(Some(info)) = KinematicsInfo::find(kind, &payload) {
            let state = info.encode();
            assert_eq!(KinematicsInfo::find(state[4], &state[5..]), Ok(Some(info)));
        }
    }
}
