//! The receiving end of the drive link: bytes in, messages of the drive out.
//!
//! Used by the boards (bytes from a UART), by the host's TCP drive and by its
//! fault injection. The bytes may come in pieces of any length.

use super::{DriveHello, DriveState};
use crate::protocol::frame::{Accumulator, FrameError, LinkCounters, Message, SequenceWatch, open};

/// A message from the drive.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // The controller does not allocate.
pub enum DriveMessage {
    /// A joint state.
    State {
        /// The state.
        state: DriveState,
        /// Time of the drive when it sent the state, in µs since its start.
        time_us: u64,
    },
    /// The drive's handshake.
    Hello(DriveHello),
}

/// Assembles the bytes of the drive link into messages and counts errors.
#[derive(Clone, Debug, Default)]
pub struct DriveReceiver {
    accumulator: Accumulator,
    sequence: SequenceWatch,
    counters: LinkCounters,
}

impl DriveReceiver {
    /// A receiver without any bytes.
    pub const fn new() -> Self {
        Self {
            accumulator: Accumulator::new(),
            sequence: SequenceWatch::new(),
            counters: LinkCounters::new(),
        }
    }

    /// Takes `bytes` and calls `sink` with every message that they complete.
    pub fn receive(&mut self, bytes: &[u8], sink: &mut impl FnMut(DriveMessage)) {
        let Self {
            accumulator,
            sequence,
            counters,
        } = self;
        for &byte in bytes {
            accumulator.push(byte, &mut |frame| match frame.and_then(message) {
                Ok((number, message)) => {
                    sequence.record(number, counters);
                    sink(message);
                }
                Err(_) => counters.crc_errors = counters.crc_errors.wrapping_add(1),
            });
        }
    }

    /// Frames received, damaged, lost and repeated so far.
    pub fn counters(&self) -> LinkCounters {
        self.counters
    }
}

/// Decodes one frame; returns its sequence number and its message.
fn message(frame: &mut [u8]) -> Result<(u32, DriveMessage), FrameError> {
    let (header, body) = open(frame)?;
    if header.key == DriveState::KEY {
        let state = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
        let time_us = header.time_us;
        Ok((header.sequence, DriveMessage::State { state, time_us }))
    } else if header.key == DriveHello::KEY {
        let hello = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
        Ok((header.sequence, DriveMessage::Hello(hello)))
    } else {
        Err(FrameError::Key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::drive::DriveCommand;
    use crate::protocol::frame::{MAX_FRAME, encode};
    use std::vec::Vec;

    fn frame<M: Message>(message: &M, sequence: u32) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let length = encode(message, sequence, 0, &mut out).expect("it fits");
        out[..length].to_vec()
    }

    // Fails if a message is lost or misread when its bytes come in pieces, or if
    // damaged frames and messages of other types are not counted.
    #[test]
    fn messages_are_complete_however_the_bytes_are_split() {
        let hello = DriveHello::new(3, []);
        let state = DriveState {
            tick: 7,
            ..DriveState::default()
        };
        let mut bytes = frame(&hello, 0);
        bytes.extend([1, 2, 3, 0]);
        bytes.extend(frame(&DriveCommand::default(), 1));
        bytes.extend(frame(&state, 2));
        for size in [1, 5, 64, 4096] {
            let (mut receiver, mut seen) = (DriveReceiver::new(), Vec::new());
            for chunk in bytes.chunks(size) {
                receiver.receive(chunk, &mut |message| seen.push(message));
            }
            assert_eq!(
                seen,
                [
                    DriveMessage::Hello(hello.clone()),
                    DriveMessage::State {
                        state: state.clone(),
                        time_us: 0
                    }
                ]
            );
            let counters = receiver.counters();
            assert_eq!((counters.frames, counters.crc_errors, counters.lost), (2, 2, 1));
        }
    }
}
