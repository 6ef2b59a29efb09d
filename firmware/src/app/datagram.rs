//! The drive link over datagrams: each frame is one datagram.
//!
//! [`Links::drive_in`](super::links::Links::drive_in) reads a stream of bytes in pieces of its own size. [`Datagram`] is
//! between the two: it holds one datagram until all of it is read.

use core::ops::Range;

/// Longest datagram that is held, in bytes. The longest message of a drive, the handshake of eight joints, has 371.
pub const LONGEST: usize = 512;

/// One datagram that is being read.
#[derive(Debug)]
pub struct Datagram {
    bytes: [u8; LONGEST],
    unread: Range<usize>,
}

impl Default for Datagram {
    fn default() -> Self {
        Self {
            bytes: [0; LONGEST],
            unread: 0..0,
        }
    }
}

impl Datagram {
    /// Where the socket writes the next datagram. What was not read is lost.
    pub fn room(&mut self) -> &mut [u8] {
        self.unread = 0..0;
        &mut self.bytes
    }

    /// The socket has written `length` bytes. Without the form of a frame they are dropped: part of a frame would
    /// spoil the next one, too.
    pub fn filled(&mut self, length: usize) {
        let bytes = self.bytes.get(..length).unwrap_or_default();
        // A frame has one zero byte, its last.
        let end = bytes.iter().position(|byte| *byte == 0).map_or(0, |zero| zero + 1);
        self.unread = if end == length { 0..length } else { 0..0 };
    }

    /// Whether nothing is left to read.
    pub fn is_read(&self) -> bool {
        self.unread.is_empty()
    }

    /// Copies what was not read yet to `out`, as far as it fits, and returns the number of bytes.
    pub fn read(&mut self, out: &mut [u8]) -> usize {
        let unread = self.bytes.get(self.unread.clone()).unwrap_or_default();
        let count = unread.len().min(out.len());
        for (slot, byte) in out.iter_mut().zip(unread) {
            *slot = *byte;
        }
        self.unread.start += count;
        count
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_shared::protocol::drive::{DriveHello, DriveMessage, DriveReceiver};
    use spherecal_shared::protocol::frame::{MAX_FRAME, encode};
    use spherecal_shared::robot::iiwa7;
    use spherecal_shared::{Joints, MAX_JOINTS};
    use std::vec::Vec;

    /// A socket receives `bytes`.
    fn receive(datagram: &mut Datagram, bytes: &[u8]) {
        datagram.room()[..bytes.len()].copy_from_slice(bytes);
        datagram.filled(bytes.len());
    }

    /// The longest message of a drive, every number at its longest.
    fn hello() -> Vec<u8> {
        let joint = iiwa7().joints[0].limits;
        let hello = DriveHello {
            protocol: u16::MAX,
            period_us: u32::MAX,
            latency_us: u32::MAX,
            motor_kg_m2: Joints::from([0.1; MAX_JOINTS]),
            ..DriveHello::new(u32::MAX, [joint; MAX_JOINTS])
        };
        let mut out = [0; MAX_FRAME];
        let length = encode(&hello, u32::MAX, u64::MAX, &mut out).expect("it fits");
        out[..length].to_vec()
    }

    // Fails if a byte is lost, repeated or added where the reader's pieces are shorter than the datagram, or if the
    // longest handshake does not fit.
    #[test]
    fn a_datagram_is_read_in_pieces() {
        let frame = hello();
        for piece in [1, 7, 256, LONGEST] {
            let (mut datagram, mut read) = (Datagram::default(), Vec::new());
            receive(&mut datagram, &frame);
            while !datagram.is_read() {
                let mut out = std::vec![0; piece];
                let count = datagram.read(&mut out);
                read.extend_from_slice(&out[..count]);
            }
            assert_eq!(read, frame, "pieces of {piece} bytes");
            assert_eq!(datagram.read(&mut [0; 8]), 0);
        }
    }

    // Fails if datagrams that are no frames spoil the frame after them, or make something panic: without an end, with
    // an end inside, empty, or of a length that the room does not have.
    #[test]
    fn what_is_no_frame_is_dropped() {
        let frame = hello();
        let (mut datagram, mut receiver, mut hellos) = (Datagram::default(), DriveReceiver::new(), 0);
        let half = &frame[..frame.len() / 2];
        for bytes in [half, &[1, 0, 2, 0], &[], &frame] {
            receive(&mut datagram, bytes);
            let mut out = [0; LONGEST];
            let count = datagram.read(&mut out);
            receiver.receive(&out[..count], &mut |message| {
                hellos += u32::from(matches!(message, DriveMessage::Hello(_)));
            });
        }
        assert_eq!((hellos, receiver.counters().crc_errors), (1, 0));
        datagram.room();
        datagram.filled(LONGEST + 1);
        assert!(datagram.is_read());
    }
}
