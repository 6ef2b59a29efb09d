//! Framing of both links: header, postcard body, CRC-32C, COBS, zero byte.
//!
//! ```text
//! COBS( key[8] | sequence u32 LE | time_us u64 LE | postcard(message) | crc32c u32 LE ) 00
//! ```
//!
//! The key is the first eight bytes of the message type's schema hash. The CRC
//! covers everything before it. A receiver that starts in mid-stream, loses
//! bytes or meets bit flips finds the next frame at the next zero byte.

use crc::{CRC_32_ISCSI, Crc, Table};
use postcard_schema::Schema;
use postcard_schema::key::Key;
use serde::Serialize;
use serde::de::DeserializeOwned;

use super::drive::{DriveCommand, DriveHello, DriveState};
use super::host::{Downlink, Uplink};

const CRC: Crc<u32, Table<1>> = Crc::<u32, Table<1>>::new(&CRC_32_ISCSI);
const HEADER: usize = 8 + 4 + 8;
const TRAILER: usize = 4;

/// Largest encoded frame, its zero byte included.
pub const MAX_FRAME: usize = 2304;

/// A message with a schema key: what may travel in a frame.
pub trait Message: Schema + Serialize + DeserializeOwned {
    /// Key of the type's schema; differs when the layout differs.
    const KEY: [u8; 8];
}

macro_rules! message {
    ($type:ty, $path:literal) => {
        impl Message for $type {
            const KEY: [u8; 8] = Key::for_path::<$type>($path).to_bytes();
        }
    };
}

message!(DriveHello, "drive/hello");
message!(DriveState, "drive/state");
message!(DriveCommand, "drive/command");
message!(Downlink, "host/down");
message!(Uplink, "host/up");

/// What a frame says besides its message.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Header {
    /// Schema key of the message.
    pub key: [u8; 8],
    /// Counts the frames of one direction of a link.
    pub sequence: u32,
    /// Time of the sender, in µs since its start.
    pub time_us: u64,
}

/// Why bytes were not a frame, or a message not encoded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum FrameError {
    /// More bytes than a frame may have came without a zero byte.
    #[error("a frame is longer than {MAX_FRAME} bytes")]
    TooLong,
    /// COBS decoding failed.
    #[error("a frame is not COBS")]
    NotCobs,
    /// Fewer bytes than header and checksum.
    #[error("a frame is shorter than its header")]
    TooShort,
    /// The checksum does not match.
    #[error("a frame's CRC-32C does not match")]
    Crc,
    /// The message is another type, or another version of it.
    #[error("a frame carries another message or another protocol version")]
    Key,
    /// The body is not a message of its type.
    #[error("a frame's body does not decode")]
    Body,
    /// The message does not fit a frame.
    #[error("a message does not fit a frame")]
    Overflow,
}

/// Encodes `message` into `out`; returns the number of bytes, zero byte included.
///
/// # Errors
/// [`FrameError::Overflow`] when `out` or a frame is too small.
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

/// Decodes one frame, given without its zero byte; `bytes` is overwritten.
///
/// Returns the header and the postcard body.
///
/// # Errors
/// Anything but [`FrameError::Key`], [`FrameError::Body`] and [`FrameError::Overflow`].
pub fn open(bytes: &mut [u8]) -> Result<(Header, &[u8]), FrameError> {
    if bytes.len() > MAX_FRAME {
        return Err(FrameError::TooLong);
    }
    let length = unstuff(bytes).ok_or(FrameError::NotCobs)?;
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

/// Undoes COBS in place, without a way to panic (`cobs::decode_in_place` has
/// bounds checks that stay in the controller's image); returns the length.
fn unstuff(bytes: &mut [u8]) -> Option<usize> {
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

/// Decodes one frame as message `M`, given without its zero byte.
///
/// # Errors
/// What [`open`] refuses, another message type, a body that does not decode.
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
/// Holds one frame; what is longer is thrown away up to the next zero byte and
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

    /// Takes one byte; when it ends a frame, hands the frame (without the zero
    /// byte) or the error to `sink`.
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

/// What a receiver counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, serde::Deserialize, Schema)]
pub struct LinkCounters {
    /// Frames accepted.
    pub frames: u32,
    /// Frames whose checksum or shape was wrong.
    pub crc_errors: u32,
    /// Frames missing by their sequence numbers, the damaged among them.
    pub lost: u32,
    /// Frames that came again.
    pub duplicates: u32,
    /// Messages sent again for want of an answer.
    pub resent: u32,
    /// Messages dropped because a queue was full.
    pub overflow: u32,
}

impl LinkCounters {
    /// All zero.
    pub const fn new() -> Self {
        Self {
            frames: 0,
            crc_errors: 0,
            lost: 0,
            duplicates: 0,
            resent: 0,
            overflow: 0,
        }
    }
}

/// Watches the sequence numbers of one direction: tells frames that are missing
/// from those that were overtaken and from those that come again.
#[derive(Clone, Copy, Debug, Default)]
pub struct SequenceWatch {
    next: Option<u32>,
    /// Of the 64 numbers before `next`, the newest in the lowest bit: which have come.
    seen: u64,
}

impl SequenceWatch {
    /// A watch that has seen nothing.
    pub const fn new() -> Self {
        Self { next: None, seen: 0 }
    }

    /// Notes a frame's sequence number in `counters`.
    pub fn note(&mut self, sequence: u32, counters: &mut LinkCounters) {
        counters.frames = counters.frames.wrapping_add(1);
        let Some(next) = self.next else {
            // Nothing is missing before the first.
            self.seen = u64::MAX;
            self.next = Some(sequence.wrapping_add(1));
            return;
        };
        let ahead = sequence.wrapping_sub(next);
        if ahead < 1 << 31 {
            counters.lost = counters.lost.wrapping_add(ahead);
            self.seen = self.seen.checked_shl(ahead.saturating_add(1)).unwrap_or(0) | 1;
            self.next = Some(sequence.wrapping_add(1));
            return;
        }
        // What is older than can be remembered counts as a repeat.
        let bit = 1u64
            .checked_shl(next.wrapping_sub(sequence).wrapping_sub(1))
            .unwrap_or(0);
        if bit == 0 || self.seen & bit != 0 {
            counters.duplicates = counters.duplicates.wrapping_add(1);
        } else {
            // It was overtaken, not lost.
            self.seen |= bit;
            counters.lost = counters.lost.wrapping_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::drive::DriveStatus;
    use crate::protocol::host::Command;
    use proptest::prelude::*;
    use std::vec::Vec;

    fn state(tick: u64, values: &[f64]) -> DriveState {
        let joints = crate::Joints::from_slice(values).expect("at most eight");
        DriveState {
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
        // Fails if any value, counter or key does not survive the wire.
        #[test]
        fn what_is_sent_is_received(tick: u64, sequence: u32, time: u64, values in prop::collection::vec(-1e3f64..1e3, 0..8)) {
            let message = state(tick, &values);
            let mut bytes = [0u8; MAX_FRAME];
            let length = encode(&message, sequence, time, &mut bytes).expect("it fits");
            prop_assert!(!bytes[..length - 1].contains(&0));
            let received = frames_in(&bytes[..length]);
            prop_assert_eq!(received, [Ok((Header { key: DriveState::KEY, sequence, time_us: time }, message))]);
        }

        // Any bytes decode to frames or typed errors; a panic fails the test.
        #[test]
        fn any_bytes_are_survived(bytes in prop::collection::vec(any::<u8>(), 0..6000)) {
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

        // Fails if our decoder and the cobs crate's differ on anything without
        // a zero byte, well-formed or not.
        #[test]
        fn unstuffing_is_cobs(bytes in prop::collection::vec(1u8..=255, 0..700), data in prop::collection::vec(0u8..3, 0..700)) {
            let mut stuffed = std::vec![0; cobs::max_encoding_length(data.len())];
            let length = cobs::encode(&data, &mut stuffed);
            stuffed.truncate(length);
            for mut ours in [bytes, stuffed] {
                let mut theirs = ours.clone();
                let length = unstuff(&mut ours);
                prop_assert_eq!(length, if theirs.is_empty() { Some(0) } else { cobs::decode_in_place(&mut theirs).ok() });
                let length = length.unwrap_or(0);
                prop_assert_eq!(&ours[..length], &theirs[..length]);
            }
        }

        // One flipped bit never passes for a frame; the next frame is found.
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

    #[test]
    fn lost_and_repeated_frames_are_counted() {
        let (mut watch, mut counters) = (SequenceWatch::default(), LinkCounters::default());
        for sequence in [u32::MAX, 0, 0, 3] {
            watch.note(sequence, &mut counters);
        }
        assert_eq!((counters.frames, counters.lost, counters.duplicates), (4, 2, 1));
        // One of the two was only late; the second time it is a repeat.
        watch.note(1, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (1, 1));
        watch.note(1, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (1, 2));
        // What nobody remembers any more counts as one that came before.
        watch.note(4000, &mut counters);
        watch.note(2, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (3997, 3));
    }
}
