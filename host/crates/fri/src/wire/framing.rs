//! How a datagram carries its message, and a message its checksum.
//!
//! Up to version 2.5 a datagram is the message. From version 2.7 on it is a frame: the message's length (u32), the
//! message, and a CRC-32 (u32). The public facts do not say in which order the bytes stand and what the CRC covers. This
//! crate takes the usual ones: little endian, the message, polynomial of IEEE 802.3. So a checksum that differs is
//! reported and not refused, as that of [`EndOfMessage`](super::EndOfMessage).

use super::protobuf::{FieldReader, FieldWriter};
use super::{MAX_MESSAGE_SIZE, WireError};

/// Bytes that a frame adds to its message.
const FRAME: usize = 8;

/// The largest datagram, bytes.
pub const MAX_DATAGRAM_SIZE: usize = MAX_MESSAGE_SIZE + FRAME;

/// How a datagram carries its message.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Framing {
    /// It is the message: versions 1.11 to 2.5.
    #[default]
    Bare,
    /// Length, message, CRC-32: version 2.7.
    Framed,
}

impl Framing {
    /// The message in a datagram, how it is framed, and what the frame's checksum says.
    ///
    /// A bare message cannot be taken for a frame: its first bytes, read as a length, are more than any datagram has.
    pub fn open(datagram: &[u8]) -> (Self, &[u8], Checksum) {
        let frame = datagram
            .split_first_chunk()
            .and_then(|(length, rest)| Some((length, rest.split_last_chunk()?)));
        match frame {
            Some((length, (message, crc))) if usize::try_from(u32::from_le_bytes(*length)) == Ok(message.len()) => {
                let matches = u32::from_le_bytes(*crc) == crc32fast::hash(message);
                let checksum = if matches { Checksum::Matches } else { Checksum::Differs };
                (Self::Framed, message, checksum)
            }
            _ => (Self::Bare, datagram, Checksum::Absent),
        }
    }

    /// Writes the datagram that carries this message; returns its size, bytes.
    pub fn close(self, message: &[u8], out: &mut [u8; MAX_DATAGRAM_SIZE]) -> usize {
        let message = message.get(..MAX_MESSAGE_SIZE).unwrap_or(message);
        let mut size = 0;
        let mut put = |bytes: &[u8]| {
            if let Some(place) = out.get_mut(size..size + bytes.len()) {
                place.copy_from_slice(bytes);
                size += bytes.len();
            }
        };
        match self {
            Self::Bare => put(message),
            Self::Framed => {
                put(&(message.len() as u32).to_le_bytes());
                put(message);
                put(&crc32fast::hash(message).to_le_bytes());
            }
        }
        size
    }
}

// The field `endOfMessageData`: length and checksum at a message's end.
//
// The public facts name its parts, a length and a CRC-32, but not the bytes that they cover. This crate takes the usual
// ones: all bytes before the field, polynomial of IEEE 802.3. So a checksum that differs is reported, not refused: UDP
// has a checksum of its own, and refusing would stop a robot whose convention is another.

/// The field's number in both messages.
pub(super) const END_FIELD: u32 = 15;

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
        out.message(END_FIELD, |w| {
            w.int32(1, length);
            w.message(2, |w| w.int32(1, crc32 as i32));
        });
    }
}

#[cfg(test)]
mod tests {
    use super::super::{CommandMessage, WireError};
    use super::*;

    // Fails if a byte of a frame is at the wrong position, or if the frame changes the message.
    #[test]
    fn a_frame_is_length_message_checksum() {
        let mut out = [0; MAX_DATAGRAM_SIZE];
        // The CRC-32 of "123456789" is the check value of the polynomial.
        let size = Framing::Framed.close(b"123456789", &mut out);
        let expected = [&[9, 0, 0, 0][..], b"123456789", &0xCBF4_3926_u32.to_le_bytes()].concat();
        assert_eq!(out[..size], expected);
        assert_eq!(
            Framing::open(&out[..size]),
            (Framing::Framed, &b"123456789"[..], Checksum::Matches)
        );
        out[5] = b'x';
        assert_eq!(Framing::open(&out[..size]).2, Checksum::Differs);
        let size = Framing::Bare.close(b"123456789", &mut out);
        assert_eq!(
            Framing::open(&out[..size]),
            (Framing::Bare, &b"123456789"[..], Checksum::Absent)
        );
        assert_eq!(Framing::Framed.close(&[0; 3000], &mut out), MAX_DATAGRAM_SIZE);
    }

    // Fails if a bare message is taken for a frame, or too few bytes end in a panic.
    #[test]
    fn a_bare_message_is_no_frame() -> Result<(), WireError> {
        let mut message = [0; MAX_MESSAGE_SIZE];
        for sequence in [0, 9, 0x1234_5678, u32::MAX] {
            let command = CommandMessage {
                sequence,
                joint_position: Some([1.0; 7]),
                ..CommandMessage::default()
            };
            let size = command.encode(&mut message, true)?;
            assert_eq!(Framing::open(&message[..size]).0, Framing::Bare);
        }
        for size in 0..9 {
            let _ = Framing::open(&message[..size]);
        }
        // An empty message, whose CRC-32 is 0.
        assert_eq!(Framing::open(&[0; 8]), (Framing::Framed, &[][..], Checksum::Matches));
        Ok(())
    }
}
