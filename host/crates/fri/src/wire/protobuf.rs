//! Protocol buffers without allocation: keys, varints, doubles, nested messages.

use super::WireError;

/// The value of a field as it stands on the wire.
#[derive(Clone, Copy, Debug)]
pub(super) enum FieldValue<'a> {
    Varint(u64),
    Double(f64),
    Bytes(&'a [u8]),
    /// A 32-bit number: no field of the interface has one.
    Fixed32,
}

/// Reads the fields of one message.
pub(super) struct FieldReader<'a> {
    message: &'static str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> FieldReader<'a> {
    pub(super) fn new(message: &'static str, bytes: &'a [u8]) -> Self {
        Self { message, bytes, at: 0 }
    }

    /// How many bytes have been read.
    pub(super) fn at(&self) -> usize {
        self.at
    }

    fn malformed(&self) -> WireError {
        WireError::Malformed {
            message: self.message,
            at: self.at,
        }
    }

    fn varint(&mut self) -> Result<u64, WireError> {
        let mut value = 0_u64;
        for shift in (0..64).step_by(7) {
            let byte = *self.bytes.get(self.at).ok_or_else(|| self.malformed())?;
            let low = u64::from(byte & 0x7F);
            // The tenth byte holds one bit.
            if shift == 63 && low > 1 {
                return Err(self.malformed());
            }
            self.at += 1;
            value |= low << shift;
            if byte & 0x80 == 0 {
                return Ok(value);
            }
        }
        Err(self.malformed())
    }

    fn take(&mut self, count: usize) -> Result<&'a [u8], WireError> {
        let end = self.at.checked_add(count).ok_or_else(|| self.malformed())?;
        let taken = self.bytes.get(self.at..end).ok_or_else(|| self.malformed())?;
        self.at = end;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self) -> Result<[u8; N], WireError> {
        let taken = self.take(N)?;
        taken.try_into().map_err(|_| self.malformed())
    }

    /// The next field: its number and value. `None` at the end.
    pub(super) fn next(&mut self) -> Result<Option<(u32, FieldValue<'a>)>, WireError> {
        if self.at == self.bytes.len() {
            return Ok(None);
        }
        let key = self.varint()?;
        let field = u32::try_from(key >> 3).map_err(|_| self.malformed())?;
        if field == 0 || field >= 1 << 29 {
            return Err(self.malformed());
        }
        let value = match key & 7 {
            0 => FieldValue::Varint(self.varint()?),
            1 => FieldValue::Double(f64::from_le_bytes(self.array()?)),
            2 => {
                let size = usize::try_from(self.varint()?).map_err(|_| self.malformed())?;
                FieldValue::Bytes(self.take(size)?)
            }
            5 => {
                self.array::<4>()?;
                FieldValue::Fixed32
            }
            _ => return Err(self.malformed()),
        };
        Ok(Some((field, value)))
    }
}

impl<'a> FieldValue<'a> {
    pub(super) fn u64(self, field: &'static str) -> Result<u64, WireError> {
        match self {
            Self::Varint(value) => Ok(value),
            _ => Err(WireError::Kind { field }),
        }
    }

    /// A 32-bit number; what is more is cut off, as protocol buffers prescribe.
    pub(super) fn u32(self, field: &'static str) -> Result<u32, WireError> {
        self.u64(field).map(|v| v as u32)
    }

    pub(super) fn double(self, field: &'static str) -> Result<f64, WireError> {
        match self {
            Self::Double(value) if value.is_finite() => Ok(value),
            Self::Double(_) => Err(WireError::NotFinite { field, index: 0 }),
            _ => Err(WireError::Kind { field }),
        }
    }

    pub(super) fn bytes(self, field: &'static str) -> Result<&'a [u8], WireError> {
        match self {
            Self::Bytes(bytes) => Ok(bytes),
            _ => Err(WireError::Kind { field }),
        }
    }

    /// A message with the one field `1 repeated double`, which must have exactly `N` finite values.
    pub(super) fn doubles<const N: usize>(self, field: &'static str) -> Result<[f64; N], WireError> {
        let mut read = FieldReader::new(field, self.bytes(field)?);
        let mut out = [0.0; N];
        let mut count = 0;
        let mut add = |value: f64| {
            if !value.is_finite() {
                return Err(WireError::NotFinite { field, index: count });
            }
            let place = out.get_mut(count).ok_or(WireError::Count {
                field,
                expected: N,
                got: N + 1,
            })?;
            *place = value;
            count += 1;
            Ok(())
        };
        while let Some((number, value)) = read.next()? {
            match (number, value) {
                (1, FieldValue::Double(value)) => add(value)?,
                (1, FieldValue::Bytes(packed)) => {
                    let (values, rest) = packed.as_chunks::<8>();
                    if !rest.is_empty() {
                        return Err(WireError::Kind { field });
                    }
                    for value in values {
                        add(f64::from_le_bytes(*value))?;
                    }
                }
                (1, _) => return Err(WireError::Kind { field }),
                _ => {}
            }
        }
        if count == N {
            Ok(out)
        } else {
            Err(WireError::Count {
                field,
                expected: N,
                got: count,
            })
        }
    }
}

/// Writes a message into a buffer. What does not fit is counted and reported by [`finish`](Self::finish).
pub(super) struct FieldWriter<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl<'a> FieldWriter<'a> {
    pub(super) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// What has been written so far.
    pub(super) fn written(&self) -> &[u8] {
        self.bytes.get(..self.at).unwrap_or_default()
    }

    fn put(&mut self, data: &[u8]) {
        if let Some(room) = self.bytes.get_mut(self.at..self.at + data.len()) {
            room.copy_from_slice(data);
        }
        self.at += data.len();
    }

    fn varint(&mut self, mut value: u64) {
        while value >= 0x80 {
            self.put(&[value as u8 | 0x80]);
            value >>= 7;
        }
        self.put(&[value as u8]);
    }

    pub(super) fn number(&mut self, field: u32, value: u64) {
        self.varint(u64::from(field) << 3);
        self.varint(value);
    }

    /// A signed 32-bit number: negative ones take ten bytes.
    pub(super) fn int32(&mut self, field: u32, value: i32) {
        self.number(field, i64::from(value) as u64);
    }

    pub(super) fn double(&mut self, field: u32, value: f64) {
        self.varint(u64::from(field) << 3 | 1);
        self.put(&value.to_le_bytes());
    }

    /// A nested message, whose fields `body` writes.
    pub(super) fn message(&mut self, field: u32, body: impl FnOnce(&mut Self)) {
        self.varint(u64::from(field) << 3 | 2);
        let start = self.at;
        body(self);
        let size = self.at - start;
        // The length stands before the body and is known only now: the body moves up by the length's bytes.
        let mut length = [0; 10];
        let mut head = FieldWriter::new(&mut length);
        head.varint(size as u64);
        let shift = head.at;
        if let Some(room) = self.bytes.get_mut(start..start + size + shift) {
            room.copy_within(..size, shift);
            room[..shift].copy_from_slice(&length[..shift]);
        }
        self.at += shift;
    }

    /// A message with the one field `1 repeated double`, not packed.
    pub(super) fn doubles(&mut self, field: u32, values: &[f64]) {
        self.message(field, |w| {
            for value in values {
                w.double(1, *value);
            }
        });
    }

    /// The size of the message.
    pub(super) fn finish(self) -> Result<usize, WireError> {
        if self.at <= self.bytes.len() {
            Ok(self.at)
        } else {
            Err(WireError::TooLong { got: self.at })
        }
    }
}
