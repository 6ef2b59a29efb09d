//! A table's lines, one at a time, in bounded memory.
//!
//! Decodes the file's bytes to UTF-8 and cuts them at LF, CR LF or CR. The memory
//! is that of one line, and a line is at most [`MOST_LINE_BYTES`] long.

use std::io::Read;

use crate::encoding::{Decoder, EncodingError, HEAD, detect};

/// Longest line that is read, in bytes of UTF-8: a thousand columns of numbers.
pub const MOST_LINE_BYTES: usize = 64 << 10;
/// Bytes that are read at once.
const PIECE: usize = 64 << 10;

/// Why the lines end early.
#[derive(Debug)]
pub(super) enum LineError {
    /// The system failed.
    System(std::io::Error),
    /// Not text.
    Encoding(EncodingError),
    /// A line is too long; its number, from 1.
    TooLong(u64),
}

impl From<EncodingError> for LineError {
    fn from(error: EncodingError) -> Self {
        Self::Encoding(error)
    }
}

pub(super) struct Lines<R> {
    source: R,
    decoder: Decoder,
    raw: Vec<u8>,
    text: Vec<u8>,
    /// Start of the next line in `text`.
    at: usize,
    /// Start of what has not been searched for a line's end.
    searched: usize,
    ended: bool,
    number: u64,
    bytes: u64,
}

impl<R: Read> Lines<R> {
    /// Looks at the beginning of a source.
    /// Errors: a source that cannot be read or is not text.
    pub(super) fn new(mut source: R) -> Result<Self, LineError> {
        let mut raw = vec![0; PIECE];
        let mut head = 0;
        while head < HEAD {
            match read(&mut source, &mut raw[head..])? {
                0 => break,
                count => head += count,
            }
        }
        let (encoding, mark) = detect(&raw[..head.min(HEAD)])?;
        let mut lines = Self {
            source,
            decoder: Decoder::new(encoding),
            text: Vec::with_capacity(2 * PIECE),
            raw,
            at: 0,
            searched: 0,
            ended: head == 0,
            number: 0,
            bytes: head as u64,
        };
        lines.decoder.push(&lines.raw[mark.min(head)..head], &mut lines.text);
        Ok(lines)
    }

    /// Bytes of the source that have been read.
    pub(super) fn bytes(&self) -> u64 {
        self.bytes
    }

    /// The next line without its end, and its number from 1; `None` at the end.
    /// Errors: a line that is too long or is not text; a source that fails.
    pub(super) fn next(&mut self) -> Result<Option<(&str, u64)>, LineError> {
        let (end, next) = loop {
            let rest = &self.text[self.searched..];
            if let Some(k) = memchr::memchr2(b'\n', b'\r', rest) {
                let end = self.searched + k;
                // CR LF is one end; the LF may not have been read yet.
                if self.text[end] == b'\n' {
                    break (end, end + 1);
                }
                match self.text.get(end + 1) {
                    Some(b'\n') => break (end, end + 2),
                    Some(_) => break (end, end + 1),
                    None if self.ended => break (end, end + 1),
                    None => self.searched = end,
                }
            } else {
                self.searched = self.text.len();
                if self.ended {
                    if self.at == self.text.len() {
                        return Ok(None);
                    }
                    break (self.text.len(), self.text.len());
                }
            }
            if self.text.len() - self.at > MOST_LINE_BYTES {
                return Err(LineError::TooLong(self.number + 1));
            }
            self.fill()?;
        };
        if end - self.at > MOST_LINE_BYTES {
            return Err(LineError::TooLong(self.number + 1));
        }
        let range = self.at..end;
        self.number += 1;
        self.at = next;
        self.searched = next;
        let line = self.number;
        let bytes = &self.text[range];
        if bytes.contains(&0) {
            return Err(EncodingError::Binary { line }.into());
        }
        match std::str::from_utf8(bytes) {
            Ok(text) => Ok(Some((text, line))),
            Err(_) => Err(EncodingError::NotUtf8 { line }.into()),
        }
    }

    /// Reads a further piece.
    fn fill(&mut self) -> Result<(), LineError> {
        // What was handed out makes room; a line moves once a piece at most.
        self.text.drain(..self.at);
        self.searched -= self.at;
        self.at = 0;
        let count = read(&mut self.source, &mut self.raw)?;
        self.bytes += count as u64;
        if count == 0 {
            self.ended = true;
            self.decoder.finish(&mut self.text);
        } else {
            self.decoder.push(&self.raw[..count], &mut self.text);
        }
        Ok(())
    }
}

fn read(source: &mut impl Read, into: &mut [u8]) -> Result<usize, LineError> {
    loop {
        match source.read(into) {
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            found => return found.map_err(LineError::System),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encoding::tests::utf16;
    use proptest::prelude::*;

    /// Hands out at most `most` bytes at once.
    struct Drops<'a>(&'a [u8], usize);

    impl Read for Drops<'_> {
        fn read(&mut self, into: &mut [u8]) -> std::io::Result<usize> {
            let count = self.1.min(self.0.len()).min(into.len());
            into[..count].copy_from_slice(&self.0[..count]);
            self.0 = &self.0[count..];
            Ok(count)
        }
    }

    fn all(bytes: &[u8], piece: usize) -> Result<Vec<String>, LineError> {
        let mut lines = Lines::new(Drops(bytes, piece))?;
        let mut out = Vec::new();
        while let Some((text, number)) = lines.next()? {
            out.push(text.to_owned());
            assert_eq!(number, out.len() as u64);
        }
        assert_eq!(lines.bytes(), bytes.len() as u64);
        Ok(out)
    }

    #[test]
    fn every_line_end_counts_once() {
        for piece in 1..9 {
            assert_eq!(all(b"a\nb\r\n\r\nc\rd", piece).unwrap(), ["a", "b", "", "c", "d"]);
            assert_eq!(all(b"\r\r\n\n", piece).unwrap(), ["", "", ""]);
            assert_eq!(all(b"x\r", piece).unwrap(), ["x"]);
            assert_eq!(all(b"", piece).unwrap(), [""; 0]);
        }
    }

    proptest! {
        /// Fails if the lines depend on how the source is cut into pieces, or on the encoding.
        #[test]
        fn pieces_and_encodings_do_not_matter(
            parts in proptest::collection::vec("[a-zß,😀]{0,4}", 0..8),
            end in proptest::sample::select(vec!["\n", "\r\n"]),
            piece in 1..40_usize,
        ) {
            let text = parts.join(end);
            let mut expected = parts.clone();
            if expected.last().is_some_and(String::is_empty) {
                expected.pop();
            }
            prop_assert_eq!(&all(text.as_bytes(), piece).unwrap(), &expected);
            for big in [false, true] {
                prop_assert_eq!(&all(&utf16(&text, big), piece).unwrap(), &expected);
            }
        }
    }

    // Fails if a line without an end is gathered in memory before it is refused.
    #[test]
    fn a_line_without_end_is_refused_at_once() {
        let mut lines = Lines::new(std::io::repeat(b'7')).unwrap();
        assert!(matches!(lines.next(), Err(LineError::TooLong(1))));
        assert!(lines.bytes() <= (MOST_LINE_BYTES + 2 * PIECE) as u64);
        let mut long = vec![b'7'; MOST_LINE_BYTES];
        long.push(b'\n');
        assert_eq!(all(&long, PIECE).unwrap().len(), 1);
        long.insert(0, b'7');
        assert!(matches!(all(&long, PIECE), Err(LineError::TooLong(1))));
    }

    #[test]
    fn bytes_that_are_no_text_name_their_line() {
        assert!(matches!(
            all(b"a\nb\xff\n", 3),
            Err(LineError::Encoding(EncodingError::NotUtf8 { line: 2 }))
        ));
        assert!(matches!(
            all(b"abcdefghijklmnopqrst\nb\0c\n", 3),
            Err(LineError::Encoding(EncodingError::Binary { line: 2 }))
        ));
    }
}
