//! Reads big-endian numbers from bytes.

use super::WireError;

/// The bytes of one package that were not read yet.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Bytes<'a> {
    left: &'a [u8],
    kind: &'static str,
}

impl<'a> Bytes<'a> {
    /// All of `left`; `kind` is for errors.
    pub(crate) fn new(left: &'a [u8], kind: &'static str) -> Self {
        Self { left, kind }
    }

    pub(super) fn take(&mut self, count: usize, field: &'static str) -> Result<&'a [u8], WireError> {
        let kind = self.kind;
        let (taken, left) = self
            .left
            .split_at_checked(count)
            .ok_or(WireError::Cut { kind, field })?;
        self.left = left;
        Ok(taken)
    }

    fn array<const N: usize>(&mut self, field: &'static str) -> Result<[u8; N], WireError> {
        let kind = self.kind;
        let (taken, left) = self.left.split_first_chunk().ok_or(WireError::Cut { kind, field })?;
        self.left = left;
        Ok(*taken)
    }

    pub(super) fn u8(&mut self, field: &'static str) -> Result<u8, WireError> {
        Ok(u8::from_be_bytes(self.array(field)?))
    }

    pub(super) fn u16(&mut self, field: &'static str) -> Result<u16, WireError> {
        Ok(u16::from_be_bytes(self.array(field)?))
    }

    pub(super) fn u32(&mut self, field: &'static str) -> Result<u32, WireError> {
        Ok(u32::from_be_bytes(self.array(field)?))
    }

    pub(super) fn u64(&mut self, field: &'static str) -> Result<u64, WireError> {
        Ok(u64::from_be_bytes(self.array(field)?))
    }

    pub(crate) fn i32(&mut self, field: &'static str) -> Result<i32, WireError> {
        Ok(i32::from_be_bytes(self.array(field)?))
    }

    pub(crate) fn f64(&mut self, field: &'static str) -> Result<f64, WireError> {
        Ok(f64::from_be_bytes(self.array(field)?))
    }

    pub(crate) fn doubles<const N: usize>(&mut self, field: &'static str) -> Result<[f64; N], WireError> {
        let mut numbers = [0.0; N];
        numbers
            .iter_mut()
            .try_for_each(|number| self.f64(field).map(|read| *number = read))?;
        Ok(numbers)
    }

    /// Everything that is left.
    pub(super) fn rest(&mut self) -> &'a [u8] {
        std::mem::take(&mut self.left)
    }

    pub(super) fn text(&mut self) -> Result<&'a str, WireError> {
        std::str::from_utf8(self.rest()).map_err(|_| WireError::Text { kind: self.kind })
    }

    /// Nothing may be left.
    pub(crate) fn end(self) -> Result<(), WireError> {
        match self.left.len() {
            0 => Ok(()),
            left => Err(WireError::TooLong { kind: self.kind, left }),
        }
    }
}
