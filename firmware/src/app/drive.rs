//! The drive link's receiving end on a board: bytes to drive states.

use spherecal_shared::protocol::drive::{DriveHello, DriveState};
use spherecal_shared::protocol::frame::{Accumulator, FrameError, LinkCounters, Message, SequenceWatch, open};

/// A message of the drive.
#[derive(Clone, Debug, PartialEq)]
#[allow(clippy::large_enum_variant)] // No allocation on a controller.
pub enum FromDrive {
    /// A state.
    State {
        /// It.
        state: DriveState,
        /// Time of the drive when it was sent, in µs.
        time_us: u64,
    },
    /// The drive introduces itself.
    Hello(DriveHello),
}

/// Collects bytes into messages of the drive and counts what went wrong.
#[derive(Clone, Debug, Default)]
pub struct DriveReceiver {
    accumulator: Accumulator,
    sequence: SequenceWatch,
    counters: LinkCounters,
}

impl DriveReceiver {
    /// A receiver that has heard nothing.
    pub const fn new() -> Self {
        Self {
            accumulator: Accumulator::new(),
            sequence: SequenceWatch::new(),
            counters: LinkCounters::new(),
        }
    }

    /// Takes `bytes`; whole messages go to `sink`.
    pub fn receive(&mut self, bytes: &[u8], sink: &mut impl FnMut(FromDrive)) {
        let Self {
            accumulator,
            sequence,
            counters,
        } = self;
        for &byte in bytes {
            accumulator.push(byte, &mut |frame| match frame.and_then(message) {
                Ok((number, message)) => {
                    sequence.note(number, counters);
                    sink(message);
                }
                Err(_) => counters.crc_errors = counters.crc_errors.wrapping_add(1),
            });
        }
    }

    /// What it has counted.
    pub fn counters(&self) -> LinkCounters {
        self.counters
    }
}

fn message(frame: &mut [u8]) -> Result<(u32, FromDrive), FrameError> {
    let (header, body) = open(frame)?;
    if header.key == DriveState::KEY {
        let state = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
        let time_us = header.time_us;
        Ok((header.sequence, FromDrive::State { state, time_us }))
    } else if header.key == DriveHello::KEY {
        let hello = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
        Ok((header.sequence, FromDrive::Hello(hello)))
    } else {
        Err(FrameError::Key)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::protocol::drive::{DriveCommand, TorqueSign};
    use spherecal_shared::protocol::frame::{MAX_FRAME, encode};
    use std::vec::Vec;

    fn frame<M: Message>(message: &M, sequence: u32) -> Vec<u8> {
        let mut out = [0; MAX_FRAME];
        let length = encode(message, sequence, 0, &mut out).expect("it fits");
        out[..length].to_vec()
    }

    // Fails if a message is lost or misread, however its bytes are cut, or if
    // damage and foreign messages are not counted.
    #[test]
    fn messages_come_out_whole_however_the_bytes_are_cut() {
        let hello = DriveHello {
            protocol: 1,
            limits: heapless::Vec::new(),
            period_us: 1000,
            compensates_gravity: false,
            torque_sign: TorqueSign::OfActuator,
            lock_step: true,
        };
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
                    FromDrive::Hello(hello.clone()),
                    FromDrive::State {
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
