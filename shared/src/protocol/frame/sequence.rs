//! Counters of a link, and the sequence numbers of its frames.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Counters of one end of a link.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LinkCounters {
    /// Frames accepted.
    pub frames: u32,
    /// Frames whose checksum or shape was wrong.
    pub crc_errors: u32,
    /// Frames missing according to their sequence numbers, damaged ones included.
    pub lost: u32,
    /// Frames that came more than once.
    pub duplicates: u32,
    /// Messages sent again because no answer came.
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

/// Watches the sequence numbers of one direction. Tells missing frames, late
/// frames (overtaken by a newer one) and repeated frames apart.
#[derive(Clone, Copy, Debug, Default)]
pub struct SequenceWatch {
    next: Option<u32>,
    /// Which of the 64 numbers before `next` have come; the newest is the lowest bit.
    seen: u64,
}

impl SequenceWatch {
    /// A watch before the first frame.
    pub const fn new() -> Self {
        Self { next: None, seen: 0 }
    }

    /// Adds a frame's sequence number to `counters`.
    pub fn record(&mut self, sequence: u32, counters: &mut LinkCounters) {
        counters.frames = counters.frames.wrapping_add(1);
        let Some(next) = self.next else {
            // No frame is missing before the first one.
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
        // A number too old to be remembered counts as a repeat.
        let bit = 1u64
            .checked_shl(next.wrapping_sub(sequence).wrapping_sub(1))
            .unwrap_or(0);
        if bit == 0 || self.seen & bit != 0 {
            counters.duplicates = counters.duplicates.wrapping_add(1);
        } else {
            // The frame was late, not lost.
            self.seen |= bit;
            counters.lost = counters.lost.wrapping_sub(1);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn lost_and_repeated_frames_are_counted() {
        let (mut watch, mut counters) = (SequenceWatch::default(), LinkCounters::default());
        for sequence in [u32::MAX, 0, 0, 3] {
            watch.record(sequence, &mut counters);
        }
        assert_eq!((counters.frames, counters.lost, counters.duplicates), (4, 2, 1));
        // One of the two was only late. When it comes again, it is a repeat.
        watch.record(1, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (1, 1));
        watch.record(1, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (1, 2));
        // A number too old to be remembered counts as a repeat.
        watch.record(4000, &mut counters);
        watch.record(2, &mut counters);
        assert_eq!((counters.lost, counters.duplicates), (3997, 3));
    }
}
