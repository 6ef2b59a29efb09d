//! The field `endOfMessageData`: length and checksum at a message's end.
//!
//! The public facts name its parts, a length and a CRC-32, but not the bytes that they cover. This crate takes the usual
//! ones: all bytes before the field, polynomial of IEEE 802.3. So a checksum that differs is reported, not refused: UDP
//! has a checksum of its own, and refusing would stop a robot whose convention is another.

use super::WireError;
use super::protobuf::{FieldReader, FieldWriter};

/// The field's number in both messages.
pub(super) const FIELD: u32 = 15;

/// What a message says at its end.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct EndOfMessage {
    /// The length that the sender states, bytes.
    pub length: Option<i32>,
    /// The checksum that the sender states.
    pub crc32: Option<u32>,
    /// How the checksum compares with ours.
    pub checksum: Checksum,
}

/// How the checksum of a message compares with ours.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Checksum {
    /// The message has none.
    Absent,
    /// It equals the CRC-32 of the bytes before the field.
    Matches,
    /// It does not: the message is damaged, or the sender covers other bytes.
    Differs,
}

impl EndOfMessage {
    /// Decodes the field's content; `before` are the bytes of the message before the field.
    pub(super) fn decode(content: &[u8], before: &[u8]) -> Result<Self, WireError> {
        let mut end = Self {
            length: None,
            crc32: None,
            checksum: Checksum::Absent,
        };
        let mut read = FieldReader::new("endOfMessageData", content);
        while let Some((field, value)) = read.next()? {
            match field {
                1 => end.length = Some(value.u32("messageLength")? as i32),
                2 => {
                    let mut inner = FieldReader::new("messageChecksum", value.bytes("messageChecksum")?);
                    while let Some((field, value)) = inner.next()? {
                        if field == 1 {
                            end.crc32 = Some(value.u32("crc32")?);
                        }
                    }
                }
                _ => {}
            }
        }
        if let Some(crc32) = end.crc32 {
            let matches = crc32 == crc32fast::hash(before);
            end.checksum = if matches { Checksum::Matches } else { Checksum::Differs };
        }
        Ok(end)
    }

    /// Appends the field with length and checksum of what has been written.
    pub(super) fn write(out: &mut FieldWriter<'_>) {
        let (length, crc32) = (out.written().len() as i32, crc32fast::hash(out.written()));
        out.message(FIELD, |w| {
            w.int32(1, length);
            w.message(2, |w| w.int32(1, crc32 as i32));
        });
    }
}
