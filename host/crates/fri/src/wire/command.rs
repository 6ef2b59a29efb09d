//! The client's answer to a monitoring message.

use super::framing::{END_FIELD, EndOfMessage};
use super::protobuf::{FieldReader, FieldWriter};
use super::{MAX_MESSAGE_SIZE, WireError};
use crate::JOINTS;

const IDENTIFIER: u32 = 0x34001;

/// What the client commands (`FRICommandMessage`).
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CommandMessage {
    /// Counts the client's messages.
    pub sequence: u32,
    /// The sequence number of the monitoring message that this answers.
    pub reflected_sequence: u32,
    /// `jointPosition`: commanded or mirrored joint positions, rad.
    pub joint_position: Option<[f64; JOINTS]>,
    /// `cartesianWrenchFeedForward`: N and N m.
    pub wrench: Option<[f64; 6]>,
    /// `jointTorque`: the torque overlay, without gravity, N m.
    pub joint_torque: Option<[f64; JOINTS]>,
    /// Length and checksum, where the sender states them. Not encoded from here: see [`encode`](Self::encode).
    pub end: Option<EndOfMessage>,
}

impl CommandMessage {
    /// Decodes a message.
    ///
    /// # Errors
    /// A [`WireError`] for bytes that are no command message.
    pub fn decode(bytes: &[u8]) -> Result<Self, WireError> {
        if bytes.len() > MAX_MESSAGE_SIZE {
            return Err(WireError::TooLong { got: bytes.len() });
        }
        let mut message = Self::default();
        let mut header = None;
        let mut read = FieldReader::new("FRICommandMessage", bytes);
        loop {
            let before = read.at();
            let Some((field, value)) = read.next()? else { break };
            match field {
                1 => header = Some(MessageHeader::decode(value.bytes("header")?, IDENTIFIER)?),
                2 => {
                    let mut data = FieldReader::new("commandData", value.bytes("commandData")?);
                    while let Some((field, value)) = data.next()? {
                        match field {
                            1 => message.joint_position = Some(value.doubles("jointPosition")?),
                            2 => message.wrench = Some(value.doubles("cartesianWrenchFeedForward")?),
                            3 => message.joint_torque = Some(value.doubles("jointTorque")?),
                            _ => {}
                        }
                    }
                }
                END_FIELD => {
                    let before = bytes.get(..before).unwrap_or_default();
                    message.end = Some(EndOfMessage::decode(value.bytes("endOfMessageData")?, before)?);
                }
                _ => {}
            }
        }
        let header = header.ok_or(WireError::Missing { field: "header" })?;
        (message.sequence, message.reflected_sequence) = (header.sequence, header.reflected);
        Ok(message)
    }

    /// Encodes the message; returns its size in bytes. `checksum` appends `endOfMessageData`.
    ///
    /// # Errors
    /// [`WireError::TooLong`] never happens with the fields of this message; the type demands it.
    pub fn encode(&self, out: &mut [u8; MAX_MESSAGE_SIZE], checksum: bool) -> Result<usize, WireError> {
        let mut write = FieldWriter::new(out);
        MessageHeader {
            sequence: self.sequence,
            reflected: self.reflected_sequence,
        }
        .write(&mut write, IDENTIFIER);
        write.message(2, |w| {
            if let Some(position) = &self.joint_position {
                w.doubles(1, position);
            }
            if let Some(wrench) = &self.wrench {
                w.doubles(2, wrench);
            }
            if let Some(torque) = &self.joint_torque {
                w.doubles(3, torque);
            }
        });
        if checksum {
            EndOfMessage::write(&mut write);
        }
        write.finish()
    }
}

pub(super) struct MessageHeader {
    pub(super) sequence: u32,
    pub(super) reflected: u32,
}

impl MessageHeader {
    pub(super) fn decode(bytes: &[u8], expected: u32) -> Result<Self, WireError> {
        let (mut identifier, mut sequence, mut reflected) = (None, None, None);
        let mut read = FieldReader::new("header", bytes);
        while let Some((field, value)) = read.next()? {
            match field {
                1 => identifier = Some(value.u32("messageIdentifier")?),
                2 => sequence = Some(value.u32("sequenceCounter")?),
                3 => reflected = Some(value.u32("reflectedSequenceCounter")?),
                _ => {}
            }
        }
        let missing = |field| WireError::Missing { field };
        let got = identifier.ok_or(missing("messageIdentifier"))?;
        if got != expected {
            return Err(WireError::Identifier { expected, got });
        }
        Ok(Self {
            sequence: sequence.ok_or(missing("sequenceCounter"))?,
            reflected: reflected.ok_or(missing("reflectedSequenceCounter"))?,
        })
    }

    pub(super) fn write(&self, out: &mut FieldWriter<'_>, identifier: u32) {
        out.message(1, |w| {
            w.number(1, identifier.into());
            w.number(2, self.sequence.into());
            w.number(3, self.reflected.into());
        });
    }
}
