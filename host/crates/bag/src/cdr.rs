//! Reads Common Data Representation, the bytes of a ROS 2 message, without a copy.
//!
//! The crate `cdr`, which writes the exported bags, allocates every string of every message; a bag has millions.
//! Plain CDR of version 1 and 2 is read, little and big endian. In version 2 a number of eight bytes stands at a
//! multiple of four.

/// Why bytes are not the message that they should be.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum CdrError {
    /// The first bytes name another encoding.
    Encoding([u8; 2]),
    /// The message ends early.
    Short,
    /// A text is not UTF-8.
    Text,
}

impl CdrError {
    pub(crate) fn words(self) -> String {
        match self {
            Self::Encoding([a, b]) => format!("its encoding has the number {a:02x}{b:02x}, not that of plain CDR"),
            Self::Short => "it ends before its last field".to_owned(),
            Self::Text => "a text in it is not UTF-8".to_owned(),
        }
    }
}

/// A place in a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Cdr<'a> {
    /// The message without the two bytes that name its encoding and the two of options.
    body: &'a [u8],
    at: usize,
    big: bool,
    /// Largest alignment, in bytes.
    widest: usize,
}

impl<'a> Cdr<'a> {
    pub(crate) fn new(bytes: &'a [u8]) -> Result<Self, CdrError> {
        let (big, widest) = match bytes {
            [0, 0, _, _, ..] => (true, 8),
            [0, 1, _, _, ..] => (false, 8),
            [0, 6, _, _, ..] => (true, 4),
            [0, 7, _, _, ..] => (false, 4),
            [a, b, _, _, ..] => return Err(CdrError::Encoding([*a, *b])),
            _ => return Err(CdrError::Short),
        };
        Ok(Self {
            body: &bytes[4..],
            at: 0,
            big,
            widest,
        })
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], CdrError> {
        let end = self.at.checked_add(count).ok_or(CdrError::Short)?;
        let found = self.body.get(self.at..end).ok_or(CdrError::Short)?;
        self.at = end;
        Ok(found)
    }

    fn number<const N: usize>(&mut self) -> Result<[u8; N], CdrError> {
        self.at = self.at.next_multiple_of(N.min(self.widest).max(1));
        let mut bytes = [0; N];
        bytes.copy_from_slice(self.take(N)?);
        if self.big {
            bytes.reverse();
        }
        Ok(bytes)
    }

    pub(crate) fn u32(&mut self) -> Result<u32, CdrError> {
        Ok(u32::from_le_bytes(self.number()?))
    }

    pub(crate) fn i32(&mut self) -> Result<i32, CdrError> {
        Ok(i32::from_le_bytes(self.number()?))
    }

    pub(crate) fn f64(&mut self) -> Result<f64, CdrError> {
        Ok(f64::from_le_bytes(self.number()?))
    }

    /// A whole number of `bytes` bytes (1, 2, 4 or 8).
    pub(crate) fn whole(&mut self, bytes: u8, signed: bool) -> Result<i128, CdrError> {
        Ok(match (bytes, signed) {
            (1, true) => i8::from_le_bytes(self.number()?).into(),
            (1, false) => u8::from_le_bytes(self.number()?).into(),
            (2, true) => i16::from_le_bytes(self.number()?).into(),
            (2, false) => u16::from_le_bytes(self.number()?).into(),
            (4, true) => i32::from_le_bytes(self.number()?).into(),
            (4, false) => u32::from_le_bytes(self.number()?).into(),
            (_, true) => i64::from_le_bytes(self.number()?).into(),
            (_, false) => u64::from_le_bytes(self.number()?).into(),
        })
    }

    pub(crate) fn text(&mut self) -> Result<&'a str, CdrError> {
        let length = self.u32()? as usize;
        let bytes = self.take(length)?;
        // The zero at the end counts; some writers leave it out of an empty text.
        let bytes = bytes.strip_suffix(&[0]).unwrap_or(bytes);
        std::str::from_utf8(bytes).map_err(|_| CdrError::Text)
    }

    /// The length of a sequence; each of its elements has at least one byte.
    pub(crate) fn length(&mut self) -> Result<usize, CdrError> {
        let length = self.u32()? as usize;
        if length > self.body.len() - self.at {
            return Err(CdrError::Short);
        }
        Ok(length)
    }

    /// A sequence of numbers; their number, and a place at the first of them.
    pub(crate) fn f64s(&mut self) -> Result<Numbers<'a>, CdrError> {
        let length = self.u32()? as usize;
        if length == 0 {
            return Ok(Numbers {
                bytes: &[],
                big: self.big,
            });
        }
        self.at = self.at.next_multiple_of(self.widest);
        let bytes = self.take(length.checked_mul(8).ok_or(CdrError::Short)?)?;
        Ok(Numbers { bytes, big: self.big })
    }

    /// The bytes between an earlier place in the same message and this one.
    pub(crate) fn since(&self, earlier: &Self) -> &'a [u8] {
        self.body.get(earlier.at..self.at).unwrap_or_default()
    }
}

/// A sequence of numbers in a message.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Numbers<'a> {
    bytes: &'a [u8],
    big: bool,
}

impl Numbers<'_> {
    pub(crate) fn len(&self) -> usize {
        self.bytes.len() / 8
    }

    pub(crate) fn get(&self, k: usize) -> Option<f64> {
        let at = k.checked_mul(8)?;
        let bytes: [u8; 8] = self.bytes.get(at..at.checked_add(8)?)?.try_into().ok()?;
        Some(if self.big {
            f64::from_be_bytes(bytes)
        } else {
            f64::from_le_bytes(bytes)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a number is looked for at another place than the standard says: eight-byte numbers at multiples of eight
    // from the end of the first four bytes, in version 2 of four.
    #[test]
    fn alignment_and_order_of_bytes() {
        let message = |head: u8, number: [u8; 8], length: [u8; 4], pad: usize| {
            let mut bytes = vec![0, head, 0, 0];
            bytes.extend(length);
            bytes.extend(std::iter::repeat_n(0xee, pad));
            bytes.extend(number);
            bytes
        };
        for (bytes, big) in [
            (message(1, 1.5f64.to_le_bytes(), 1u32.to_le_bytes(), 4), false),
            (message(0, 1.5f64.to_be_bytes(), 1u32.to_be_bytes(), 4), true),
            (message(7, 1.5f64.to_le_bytes(), 1u32.to_le_bytes(), 0), false),
            (message(6, 1.5f64.to_be_bytes(), 1u32.to_be_bytes(), 0), true),
        ] {
            let mut at = Cdr::new(&bytes).unwrap();
            assert_eq!(at.big, big);
            assert_eq!((at.u32(), at.f64()), (Ok(1), Ok(1.5)), "{bytes:?}");
            assert_eq!(at.f64(), Err(CdrError::Short));
            let numbers = Cdr::new(&bytes).unwrap().f64s().unwrap();
            assert_eq!((numbers.len(), numbers.get(0), numbers.get(1)), (1, Some(1.5), None));
        }
    }

    #[test]
    fn lengths_beyond_the_end_are_refused() {
        let bytes = [0, 1, 0, 0, 0xff, 0xff, 0xff, 0xff, 1, 2, 3];
        let start = Cdr::new(&bytes).unwrap();
        assert_eq!(start.clone().text(), Err(CdrError::Short));
        assert_eq!(start.clone().length(), Err(CdrError::Short));
        assert!(start.clone().f64s().is_err());
        assert_eq!(Cdr::new(&[0, 3, 0, 0]).unwrap_err(), CdrError::Encoding([0, 3]));
        assert_eq!(Cdr::new(&[0, 1]).unwrap_err(), CdrError::Short);
        assert_eq!(Cdr::new(&[0, 1, 0, 0, 2, 0, 0, 0, b'a', 0]).unwrap().text(), Ok("a"));
        assert_eq!(Cdr::new(&[0, 1, 0, 0, 0, 0, 0, 0]).unwrap().text(), Ok(""));
        assert_eq!(
            Cdr::new(&[0, 1, 0, 0, 2, 0, 0, 0, 0xff, 0]).unwrap().text(),
            Err(CdrError::Text)
        );
    }
}
