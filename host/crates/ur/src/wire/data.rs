//! Data packages of the fast path: read and written in place, without memory of their own.

use super::bytes::Bytes;
use super::{HEADER_SIZE, MAX_ANSWER, PackageKind, WireError};

/// A package that came.
pub(crate) enum Taken<T> {
    /// A data package of the recipe.
    Data(T),
    /// Another package.
    Other,
}

/// Takes the first package from what has come; `None` while it is not whole. `read` reads a data package of this recipe.
/// Errors: a [`WireError`] if it is no package, or not the one that `read` expects.
pub(crate) fn take_data<T>(
    received: &mut Vec<u8>,
    recipe: u8,
    read: impl FnOnce(&mut Bytes<'_>) -> Result<T, WireError>,
) -> Result<Option<Taken<T>>, WireError> {
    let Some(&[high, low, kind]) = received.first_chunk::<HEADER_SIZE>() else {
        return Ok(None);
    };
    let size = usize::from(u16::from_be_bytes([high, low]));
    if size < HEADER_SIZE {
        return Err(WireError::Size {
            size,
            least: HEADER_SIZE,
            most: MAX_ANSWER,
        });
    }
    let kind = PackageKind::from_number(kind.into())?;
    let Some(package) = received.get(HEADER_SIZE..size) else {
        return Ok(None);
    };
    let found = match package.split_first() {
        Some((number, values)) if kind == PackageKind::Data && *number == recipe => {
            let mut bytes = Bytes::new(values, kind.name());
            let value = read(&mut bytes)?;
            bytes.end()?;
            Taken::Data(value)
        }
        _ => Taken::Other,
    };
    received.drain(..size);
    Ok(Some(found))
}

/// A data package of `N` bytes with these values. What does not fit is left out: no caller sends such.
pub(crate) fn data_package<'a, const N: usize>(
    recipe: u8,
    integers: [i32; 2],
    doubles: impl Iterator<Item = &'a f64>,
) -> [u8; N] {
    let header = (N as u16)
        .to_be_bytes()
        .into_iter()
        .chain([PackageKind::Data.number() as u8, recipe]);
    let values = integers
        .into_iter()
        .flat_map(i32::to_be_bytes)
        .chain(doubles.flat_map(|double| double.to_be_bytes()));
    let mut package = [0; N];
    for (slot, byte) in package.iter_mut().zip(header.chain(values)) {
        *slot = byte;
    }
    package
}
