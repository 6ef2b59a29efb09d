//! The text encodings that users' files come in, as UTF-8.
//!
//! Spreadsheets write UTF-8 with or without a byte order mark, or UTF-16 with
//! one ("Unicode text"). Anything else is refused with the remedy, never guessed.

/// How a file writes its characters.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Utf8,
    Utf16Le,
    Utf16Be,
}

/// Why bytes are not text that this program reads.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum EncodingError {
    /// A spreadsheet's own file format.
    #[error("is a spreadsheet or another ZIP archive: save the sheet as \"CSV UTF-8\"")]
    Archive,
    /// A compressed file.
    #[error("is compressed: unpack it first")]
    Compressed,
    /// UTF-16 without a byte order mark.
    #[error("looks like UTF-16 without a byte order mark: save it as UTF-8")]
    NoMark,
    /// Bytes that no text holds.
    #[error("line {line} holds bytes that are not text: save the file as plain text in UTF-8")]
    Binary {
        /// Line, from 1.
        line: u64,
    },
    /// Bytes that are not UTF-8.
    #[error("line {line} is not UTF-8 text: save the file as \"CSV UTF-8\" or plain text in UTF-8")]
    NotUtf8 {
        /// Line, from 1.
        line: u64,
    },
}

/// Bytes that tell the encoding of a file.
pub(crate) const HEAD: usize = 16;

/// The encoding of a file that begins with `head` (its first [`HEAD`] bytes, or
/// all of it), and the length of its byte order mark.
/// Errors: formats that are not text, with the remedy.
pub(crate) fn detect(head: &[u8]) -> Result<(Encoding, usize), EncodingError> {
    match head {
        [0xef, 0xbb, 0xbf, ..] => return Ok((Encoding::Utf8, 3)),
        [0xff, 0xfe, ..] => return Ok((Encoding::Utf16Le, 2)),
        [0xfe, 0xff, ..] => return Ok((Encoding::Utf16Be, 2)),
        [b'P', b'K', 3, 4, ..] | [0xd0, 0xcf, 0x11, 0xe0, ..] => return Err(EncodingError::Archive),
        [0x1f, 0x8b, ..] | [0x28, 0xb5, 0x2f, 0xfd, ..] | [b'B', b'Z', b'h', ..] | [0xfd, b'7', b'z', b'X', ..] => {
            return Err(EncodingError::Compressed);
        }
        _ => {}
    }
    let zeros = |odd: usize| head.iter().skip(odd).step_by(2).filter(|b| **b == 0).count();
    let half = head.len() / 2;
    if half >= 2 && (zeros(0) == half || zeros(1) == half) {
        return Err(EncodingError::NoMark);
    }
    Ok((Encoding::Utf8, 0))
}

/// Turns the bytes of a file into UTF-8, piece by piece.
#[derive(Clone, Debug)]
pub(crate) struct Decoder {
    encoding: Encoding,
    /// First byte of a unit whose second has not come yet.
    odd: Option<u8>,
    /// First half of a surrogate pair.
    high: Option<u16>,
}

impl Decoder {
    pub(crate) fn new(encoding: Encoding) -> Self {
        Self {
            encoding,
            odd: None,
            high: None,
        }
    }

    /// Adds a piece of the file to `out`. UTF-8 is passed on unchecked; units of
    /// UTF-16 that are no characters become U+FFFD.
    pub(crate) fn push(&mut self, bytes: &[u8], out: &mut Vec<u8>) {
        if self.encoding == Encoding::Utf8 {
            out.extend_from_slice(bytes);
            return;
        }
        for &byte in bytes {
            let Some(first) = self.odd.take() else {
                self.odd = Some(byte);
                continue;
            };
            let unit = match self.encoding {
                Encoding::Utf16Be => u16::from_be_bytes([first, byte]),
                _ => u16::from_le_bytes([first, byte]),
            };
            self.unit(unit, out);
        }
    }

    /// Ends the file: half a character becomes U+FFFD.
    pub(crate) fn finish(&mut self, out: &mut Vec<u8>) {
        if self.odd.take().is_some() | self.high.take().is_some() {
            put(char::REPLACEMENT_CHARACTER, out);
        }
    }

    fn unit(&mut self, unit: u16, out: &mut Vec<u8>) {
        if let Some(high) = self.high.take() {
            if let Some(Ok(letter)) = char::decode_utf16([high, unit]).next() {
                put(letter, out);
                return;
            }
            put(char::REPLACEMENT_CHARACTER, out);
        }
        match char::from_u32(u32::from(unit)) {
            Some(letter) => put(letter, out),
            None if unit < 0xdc00 => self.high = Some(unit),
            None => put(char::REPLACEMENT_CHARACTER, out),
        }
    }
}

fn put(letter: char, out: &mut Vec<u8>) {
    out.extend_from_slice(letter.encode_utf8(&mut [0; 4]).as_bytes());
}

/// A whole file's text.
/// Errors: bytes that are not text, with the line and the remedy.
pub(crate) fn decode(bytes: &[u8]) -> Result<String, EncodingError> {
    let (encoding, mark) = detect(bytes.get(..HEAD).unwrap_or(bytes))?;
    let mut out = Vec::with_capacity(bytes.len());
    let mut decoder = Decoder::new(encoding);
    decoder.push(bytes.get(mark..).unwrap_or_default(), &mut out);
    decoder.finish(&mut out);
    let line = |until: usize| 1 + out.iter().take(until).filter(|b| **b == b'\n').count() as u64;
    if let Some(at) = out.iter().position(|b| *b == 0) {
        return Err(EncodingError::Binary { line: line(at) });
    }
    match std::str::from_utf8(&out) {
        Ok(_) => Ok(String::from_utf8(out).unwrap_or_default()),
        Err(_) if out.trim_ascii_start().first() == Some(&b'<') => Ok(latin_xml(&out)),
        Err(e) => Err(EncodingError::NotUtf8 {
            line: line(e.valid_up_to()),
        }),
    }
}

/// XML whose bytes are not UTF-8, read as ISO-8859-1. Its declaration then says UTF-8, as which it is written again.
fn latin_xml(bytes: &[u8]) -> String {
    let text: String = bytes.iter().map(|b| char::from(*b)).collect();
    let end = text.find("?>").filter(|_| text.trim_start().starts_with("<?xml"));
    let (head, rest) = text.split_at(end.unwrap_or(0));
    let Some((before, named)) = head.split_once("encoding=") else {
        return text;
    };
    let quote = named.chars().next().unwrap_or('"');
    let behind = named
        .get(1..)
        .and_then(|n| n.split_once(quote))
        .map_or("", |(_, behind)| behind);
    format!("{before}encoding={quote}UTF-8{quote}{behind}{rest}")
}

#[cfg(test)]
pub(crate) mod tests {
    use super::*;
    use proptest::prelude::*;

    /// Text as UTF-16 with a byte order mark.
    pub(crate) fn utf16(text: &str, big: bool) -> Vec<u8> {
        let unit = |u: u16| if big { u.to_be_bytes() } else { u.to_le_bytes() };
        std::iter::once(0xfeff)
            .chain(text.encode_utf16())
            .flat_map(unit)
            .collect()
    }

    proptest! {
        /// Fails if any character is lost, wherever the file is cut into pieces.
        #[test]
        fn utf16_in_pieces_is_the_same_text(text in "\\PC{0,30}", big in any::<bool>(), piece in 1..7_usize) {
            let bytes = utf16(&text, big);
            let (encoding, mark) = detect(&bytes).unwrap();
            let mut decoder = Decoder::new(encoding);
            let mut out = Vec::new();
            for part in bytes[mark..].chunks(piece) {
                decoder.push(part, &mut out);
            }
            decoder.finish(&mut out);
            prop_assert_eq!(String::from_utf8(out).unwrap(), text);
        }

        /// Any bytes are text or a refusal.
        #[test]
        fn any_bytes_decode_or_are_refused(bytes in proptest::collection::vec(any::<u8>(), 0..60)) {
            if let Ok(text) = decode(&bytes) {
                prop_assert!(!text.contains('\0'));
            }
        }
    }

    #[test]
    fn what_is_no_text_is_named() {
        assert_eq!(decode(b"PK\x03\x04rest"), Err(EncodingError::Archive));
        assert_eq!(decode(b"\x1f\x8b\x08"), Err(EncodingError::Compressed));
        assert_eq!(decode(b"q\x001\x00,\x00"), Err(EncodingError::NoMark));
        assert_eq!(decode(b"\0q\x001\0,"), Err(EncodingError::NoMark));
        assert_eq!(decode(b"a\nb\0c"), Err(EncodingError::Binary { line: 2 }));
        assert_eq!(decode(b"a\nb\nM\xfcller"), Err(EncodingError::NotUtf8 { line: 3 }));
        assert_eq!(decode(b"\xef\xbb\xbfa").unwrap(), "a");
        assert_eq!(decode(b"").unwrap(), "");
        // A lone surrogate and half a unit are shown as such, not dropped.
        assert_eq!(decode(b"\xff\xfe\x00\xd8a\0b").unwrap(), "\u{fffd}a\u{fffd}");
    }
}
