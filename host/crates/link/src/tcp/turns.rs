//! Turns of the host link: each side's bytes of one period, which end with a zero byte that has no frame before it.

use super::TcpError;
use spherecal_budget::link::TURN_BYTES;

/// Splits a byte stream into turns.
#[derive(Debug, Default)]
pub(super) struct Turns {
    bytes: Vec<u8>,
    /// Bytes of the present turn that were looked at.
    at: usize,
    /// Bytes of the last turn, to be removed before the next.
    spent: usize,
}

impl Turns {
    /// Adds what was received.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// Bytes of a turn that has no end yet.
    pub(super) fn waiting(&self) -> usize {
        self.bytes.len() - self.spent
    }

    /// Fails if the present turn has too many bytes.
    pub(super) fn check(&self, peer: &str) -> Result<(), TcpError> {
        let bytes = self.waiting();
        if bytes <= TURN_BYTES {
            return Ok(());
        }
        Err(TcpError::Endless {
            peer: peer.to_owned(),
            bytes,
        })
    }

    /// The next whole turn, without its end.
    pub(super) fn next(&mut self) -> Option<&[u8]> {
        if self.spent > 0 {
            self.bytes.drain(..self.spent);
            self.spent = 0;
            self.at = 0;
        }
        while let Some(byte) = self.bytes.get(self.at) {
            let ends = *byte == 0 && (self.at == 0 || self.bytes.get(self.at - 1) == Some(&0));
            self.at += 1;
            if ends {
                self.spent = self.at;
                return self.bytes.get(..self.at - 1);
            }
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::Turns;

    // Fails if a period's bytes are cut, merged or kept back, however the stream is cut.
    #[test]
    fn turns_come_out_whole_however_the_bytes_are_cut() {
        let bytes = [5, 6, 0, 7, 0, 0, 0, 8, 0, 0, 9];
        for size in 1..=bytes.len() {
            let (mut turns, mut seen) = (Turns::default(), Vec::new());
            for chunk in bytes.chunks(size) {
                turns.push(chunk);
                while let Some(turn) = turns.next() {
                    seen.push(turn.to_vec());
                }
            }
            assert_eq!(seen, [vec![5, 6, 0, 7, 0], vec![], vec![8, 0]], "in chunks of {size}");
        }
    }
}
