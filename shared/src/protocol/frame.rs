//! Framing of both links: header, postcard body, CRC-32C, COBS, zero byte.
//!
//! ```text
//! COBS( key[8] | sequence u32 LE | time_us u64 LE | postcard(message) | crc32c u32 LE ) 00
//! ```
//!
//! The key is the first eight bytes of the hash of the message type's schema. The
//! CRC covers all bytes before it. A receiver that starts in mid-stream, loses
//! bytes or receives wrong bits finds the next frame after the next zero byte.

use crc::{CRC_32_ISCSI, Crc, Table};
use postcard_schema::Schema;
use serde::Serialize;
use serde::de::DeserializeOwned;

mod sequence;

pub use sequence::{LinkCounters, SequenceWatch};

const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);
const HEADER: usize = 8 + 4 + 8;
const TRAILER: usize = 4;

/// Size of the largest encoded frame, with its zero byte.
pub const MAX_FRAME: usize = 2304;

/// A message type that a frame can carry.
pub trait Message: Schema + Serialize + DeserializeOwned {
    /// Key of the type's schema; another layout has another key.
    const KEY: [u8; 8];
}

/// Makes a type a message; its key comes from its schema and the path.
macro_rules! message {
    ($type:ty, $path:literal) => {
        impl $crate::protocol::frame::Message for $type {
            const KEY: [u8; 8] = postcard_schema::key::Key::for_path::<$type>($path).to_bytes();
        }
    };
}
pub(super) use message;

/// The fields of a frame besides its message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Schema key of the message.
    pub key: [u8; 8],
    /// Number of the frame in its direction of the link.
    pub sequence: u32,
    /// Time of the sender, in µs since it started.
    pub time_us: u64,
}

/// Why bytes are not a frame, or why a message was not encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// More bytes came without a zero byte than a frame may have.
    #[error("a frame is longer than {MAX_FRAME} bytes")]
    TooLong,
    /// The bytes are not COBS-encoded.
    #[error("a frame is not COBS-encoded")]
    NotCobs,
    /// There are fewer bytes than header and checksum need.
    #[error("a frame is shorter than its header and checksum")]
    TooShort,
    /// The checksum does not match.
    #[error("the CRC-32C of a frame does not match")]
    Crc,
    /// The frame carries another message type, or another version of it.
    #[error("a frame carries another message type or another protocol version")]
    Key,
    /// The body is not a message of its type.
    #[error("the body of a frame does not decode")]
    Body,
    /// The message does not fit into a frame.
    #[error("a message does not fit a frame")]
    Overflow,
}

/// Encodes `message` into `out`; returns the number of bytes with the zero byte.
///
/// # Errors
/// [`FrameError::Overflow`] if `out` or a frame is too small.
pub fn encode<M: Message>(message: &M, sequence: u32, time_us: u64, out: &mut [u8]) -> Result<usize, FrameError> {
    let mut raw = [0u8; MAX_FRAME];
    let (header, rest) = raw.split_at_mut(HEADER);
    let (key, counters) = header.split_at_mut(8);
    key.copy_from_slice(&M::KEY);
    let (count, time) = counters.split_at_mut(4);
    count.copy_from_slice(&sequence.to_le_bytes());
    time.copy_from_slice(&time_us.to_le_bytes());
    let body = postcard::to_slice(message, rest)
        .map_err(|_| FrameError::Overflow)?
        .len();
    let end = HEADER + body;
    let crc = CRC.checksum(raw.get(..end).ok_or(FrameError::Overflow)?);
    raw.get_mut(end..end + TRAILER)
        .ok_or(FrameError::Overflow)?
        .copy_from_slice(&crc.to_le_bytes());
    let payload = raw.get(..end + TRAILER).ok_or(FrameError::Overflow)?;
    if cobs::max_encoding_length(payload.len()) + 1 > out.len().min(MAX_FRAME) {
        return Err(FrameError::Overflow);
    }
    let length = cobs::try_encode(payload, out).map_err(|_| FrameError::Overflow)?;
    *out.get_mut(length).ok_or(FrameError::Overflow)? = 0;
    Ok(length + 1)
}

/// Checks one frame, given without its zero byte, and returns its header and its
/// postcard body. Overwrites `bytes`.
///
/// # Errors
/// Any except [`FrameError::Key`], [`FrameError::Body`] and [`FrameError::Overflow`].
pub fn open(bytes: &mut [u8]) -> Result<(Header, &[u8]), FrameError> {
    if bytes.len() > MAX_FRAME {
        return Err(FrameError::TooLong);
    }
    let length = decode_cobs(bytes).ok_or(FrameError::NotCobs)?;
    let raw = bytes.get(..length).ok_or(FrameError::NotCobs)?;
    let (covered, trailer) = raw.split_last_chunk::<TRAILER>().ok_or(FrameError::TooShort)?;
    let (key, rest) = covered.split_first_chunk::<8>().ok_or(FrameError::TooShort)?;
    let (sequence, rest) = rest.split_first_chunk::<4>().ok_or(FrameError::TooShort)?;
    let (time, body) = rest.split_first_chunk::<8>().ok_or(FrameError::TooShort)?;
    if CRC.checksum(covered) != u32::from_le_bytes(*trailer) {
        return Err(FrameError::Crc);
    }
    let header = Header {
        key: *key,
        sequence: u32::from_le_bytes(*sequence),
        time_us: u64::from_le_bytes(*time),
    };
    Ok((header, body))
}

/// Decodes COBS in place; returns the length. Unlike `cobs::decode_in_place` it
/// leaves no bounds check that could panic in the controller's image.
fn decode_cobs(bytes: &mut [u8]) -> Option<usize> {
    let (mut read, mut write) = (0usize, 0usize);
    while let Some(&code) = bytes.get(read) {
        read += 1;
        if code == 0 {
            return None;
        }
        for _ in 1..code {
            let byte = *bytes.get(read)?;
            *bytes.get_mut(write)? = byte;
            read += 1;
            write += 1;
        }
        if code != u8::MAX && read < bytes.len() {
            *bytes.get_mut(write)? = 0;
            write += 1;
        }
    }
    Some(write)
}

/// Decodes one frame, given without its zero byte, as message `M`.
///
/// # Errors
/// As [`open`], and for another message type or a body that does not decode.
pub fn decode<M: Message>(bytes: &mut [u8]) -> Result<(Header, M), FrameError> {
    let (header, body) = open(bytes)?;
    if header.key != M::KEY {
        return Err(FrameError::Key);
    }
    let message = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
    Ok((header, message))
}

/// Collects bytes until a zero byte ends a frame.
///
/// It holds one frame. A longer one is discarded up to the next zero byte and
/// reported once as [`FrameError::TooLong`].
#[derive(Clone, Debug, Default)]
pub struct Accumulator {
    buffer: heapless::Vec<u8, MAX_FRAME>,
    overrun: bool,
}

impl Accumulator {
    /// An empty accumulator.
    pub const fn new() -> Self {
        Self {
            buffer: heapless::Vec::new(),
            overrun: false,
        }
    }

    /// Takes one byte. When it ends a frame, calls `sink` with the frame without
    /// its zero byte, or with the error.
    pub fn push(&mut self, byte: u8, sink: &mut impl FnMut(Result<&mut [u8], FrameError>)) {
        if byte != 0 {
            if self.buffer.push(byte).is_err() {
                self.overrun = true;
            }
            return;
        }
        if self.overrun {
            sink(Err(FrameError::TooLong));
        } else if !self.buffer.is_empty() {
            sink(Ok(self.buffer.as_mut_slice()));
        }
        self.buffer.clear();
        self.overrun = false;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::drive::{DriveState, DriveStatus};
    use crate::protocol::host::Command;
    use crate::protocol::host::Downlink;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn state(tick: u64, values: &[f64]) -> DriveState {
        let joints = crate::Joints::from_slice(values).expect("at most eight");
        DriveState {
            session: 1,
            tick,
            q: joints.clone(),
            dq: joints.clone(),
            tau: joints,
            status: DriveStatus::Ready,
        }
    }

    fn frames_in(bytes: &[u8]) -> Vec<Result<(Header, DriveState), FrameError>> {
        let mut out = Vec::new();
        let mut accumulator = Accumulator::new();
        for byte in bytes {
            accumulator.push(*byte, &mut |frame| out.push(frame.and_then(decode)));
        }
        out
    }

    proptest! {
        // Fails if a value, counter or key changes on the wire.
        #[test]
        fn a_message_survives_the_wire(tick: u64, sequence: u32, time: u64, values in prop::collection::vec(-1e3f64..1e3, 0..8)) {
            let message = state(tick, &values);
            let mut bytes = [0u8; MAX_FRAME];
            let length = encode(&message, sequence, time, &mut bytes).expect("it fits");
            prop_assert!(!bytes[..length - 1].contains(&0));
            let received = frames_in(&bytes[..length]);
            prop_assert_eq!(received, [Ok((Header { key: DriveState::KEY, sequence, time_us: time }, message))]);
        }

        // Fails if any bytes cause a panic: they must decode to frames or errors.
        #[test]
        fn any_bytes_decode_or_fail(bytes in prop::collection::vec(any::<u8>(), 0..6000)) {
            let _ = frames_in(&bytes);
            let mut accumulator = Accumulator::new();
            for byte in &bytes {
                accumulator.push(*byte, &mut |frame| {
                    if let Ok(frame) = frame {
                        let _ = decode::<Downlink>(frame);
                    }
                });
            }
        }

        // Fails if this decoder and the one of the cobs crate differ on any bytes
        // without a zero byte, valid or not.
        #[test]
        fn decoding_agrees_with_the_cobs_crate(bytes in prop::collection::vec(1u8..=255, 0..700), data in prop::collection::vec(0u8..3, 0..700)) {
            let mut stuffed = std::vec![0; cobs::max_encoding_length(data.len())];
            let length = cobs::encode(&data, &mut stuffed);
            stuffed.truncate(length);
            for mut ours in [bytes, stuffed] {
                let mut theirs = ours.clone();
                let length = decode_cobs(&mut ours);
                prop_assert_eq!(length, if theirs.is_empty() { Some(0) } else { cobs::decode_in_place(&mut theirs).ok() });
                let length = length.unwrap_or(0);
                prop_assert_eq!(&ours[..length], &theirs[..length]);
            }
        }

        // Fails if a frame with one flipped bit is accepted, or the next frame is lost.
        #[test]
        fn a_flipped_bit_is_caught(bit in 0usize..1400, tick: u64) {
            let mut bytes = [0u8; 2 * MAX_FRAME];
            let length = encode(&state(tick, &[0.5; 7]), 1, 2, &mut bytes).expect("it fits");
            let second = encode(&state(7, &[0.25; 7]), 2, 3, &mut bytes[length..]).expect("it fits");
            let bit = bit % ((length - 1) * 8);
            bytes[bit / 8] ^= 1 << (bit % 8);
            let received = frames_in(&bytes[..length + second]);
            prop_assert!(received[..received.len() - 1].iter().all(Result::is_err));
            prop_assert_eq!(received.last().and_then(|r| r.as_ref().ok()).map(|r| r.1.tick), Some(7));
        }
    }

    #[test]
    fn another_message_is_refused_by_its_key() {
        let mut bytes = [0u8; MAX_FRAME];
        let message = Downlink::at_once(1, Command::Stop);
        let length = encode(&message, 1, 2, &mut bytes).expect("it fits");
        assert_eq!(decode::<DriveState>(&mut bytes[..length - 1]), Err(FrameError::Key));
    }
}
