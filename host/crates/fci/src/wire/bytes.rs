//! Little-endian numbers in and out of byte slices. Reading past the end is an error, never a panic.

use super::WireError;

/// Reads fields one after the other.
pub(super) struct FieldReader<'a> {
    message: &'static str,
    bytes: &'a [u8],
    at: usize,
}

impl<'a> FieldReader<'a> {
    pub(super) fn new(message: &'static str, bytes: &'a [u8]) -> Self {
        Self { message, bytes, at: 0 }
    }

    fn take<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let short = WireError::Short {
            message: self.message,
            field,
            got: self.bytes.len(),
        };
        let rest = self.bytes.get(self.at..).ok_or(short)?;
        let (head, _) = rest.split_first_chunk::<N>().ok_or(short)?;
        self.at += N;
        Ok(*head)
    }

    pub(super) fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        Ok(u8::from_le_bytes(self.take(field)?))
    }

    /// Any value but 0 is true.
    pub(super) fn bool(&mut self, field: &'static str) -> Result<bool, WireError> {
        Ok(self.u8(field)? != 0)
    }

    pub(super) fn u16(&mut self, field: &'static str) -> Result<u16, WireError> {
        Ok(u16::from_le_bytes(self.take(field)?))
    }

    pub(super) fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        Ok(u32::from_le_bytes(self.take(field)?))
    }

    pub(super) fn u64(&mut self, field: &'static str) -> Result<u64, WireError> {
        Ok(u64::from_le_bytes(self.take(field)?))
    }

    pub(super) fn f32(&mut self, field: &'static str) -> Result<f64, WireError> {
        Ok(f64::from(f32::from_le_bytes(self.take(field)?)))
    }

    pub(super) fn f64(&mut self, field: &'static str) -> Result<f64, WireError> {
        Ok(f64::from_le_bytes(self.take(field)?))
    }

    pub(super) fn finite<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], WireError> {
        let mut out = [0.0; N];
        for (index, out) in out.iter_mut().enumerate() {
            let value = self.f64(field)?;
            if !value.is_finite() {
                return Err(WireError::NotFinite { field, index });
            }
            *out = value;
        }
        Ok(out)
    }

    pub(super) fn skip(&mut self, count: usize) {
        self.at = self.at.saturating_add(count);
    }

    /// What has not been read yet.
    pub(super) fn rest(&self) -> &'a [u8] {
        self.bytes.get(self.at..).unwrap_or_default()
    }

    /// Refuses bytes after the last field.
    pub(super) fn end(self) -> Result<(), WireError> {
        if self.at == self.bytes.len() {
            Ok(())
        } else {
            Err(WireError::Length {
                message: self.message,
                expected: self.at,
                got: self.bytes.len(),
            })
        }
    }
}

/// Writes fields one after the other into a buffer of fixed size. The callers' buffers have room by construction.
pub(super) struct FieldWriter<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl<'a> FieldWriter<'a> {
    pub(super) fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// Writes what fits. The number of bytes stays right either way, so that a wrong size shows in tests.
    pub(super) fn put(&mut self, data: &[u8]) {
        if let Some(room) = self.bytes.get_mut(self.at..self.at + data.len()) {
            room.copy_from_slice(data);
        }
        self.at += data.len();
    }

    pub(super) fn f64s(&mut self, values: &[f64]) {
        for value in values {
            self.put(&value.to_le_bytes());
        }
    }

    pub(super) fn f32s(&mut self, values: &[f64]) {
        for value in values {
            self.put(&(*value as f32).to_le_bytes());
        }
    }

    pub(super) fn written(&self) -> usize {
        self.at
    }
}
