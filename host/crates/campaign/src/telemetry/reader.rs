//! Reads a telemetry file that the writer wrote, message by message or sample by sample.

use std::sync::Arc;

use mcap::read::ChannelAccumulator;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{Channel, McapError};
use serde::de::DeserializeOwned;

use super::messages::{Control, JointState, PhaseState, Uncertainty, Wrench, WrenchStamped};
use super::ros::RosMessage;
use super::writer::TelemetryError;
use spherecal_budget::files::RECORD_BYTES;

/// One sample of the control loop. What the file lacks is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Period {
    /// UTC, in ns since 1970.
    pub utc_ns: u64,
    /// Device time since the controller's start, in ns.
    pub device_ns: u64,
    /// Joints.
    pub joints: JointState<'static>,
    /// Force and torque.
    pub wrench: Option<Wrench>,
    /// Standard uncertainties of both, at the latest posture that has them.
    pub uncertainty: Option<Wrench>,
    /// Commanded torques, and TCP.
    pub control: Option<Control<'static>>,
    /// Phase and flags, as they were told last.
    pub phase: Option<PhaseState>,
}

/// The last bytes of a whole file.
const END: &[u8] = mcap::MAGIC;

/// What is read of a file whose writer was killed.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Torn {
    /// Control periods.
    pub periods: u64,
    /// Bytes at the end that are left out: they have no checksum yet.
    pub left_out: usize,
}

/// The bytes of a file up to the end of its last whole record. A chunk that its writer has not closed has the
/// largest length: the writer puts the length in at the end.
fn whole_records(bytes: &[u8]) -> usize {
    const HEAD: usize = 9;
    let mut at = mcap::MAGIC.len();
    while let Some([_, length @ ..]) = bytes.get(at..).and_then(|rest| rest.first_chunk::<HEAD>()) {
        let end = usize::try_from(u64::from_le_bytes(*length)).ok();
        match end.and_then(|length| length.checked_add(at + HEAD)) {
            Some(end) if end <= bytes.len() => at = end,
            _ => break,
        }
    }
    at
}

/// A message of a telemetry file.
#[derive(Clone, Debug)]
pub struct TelemetryMessage {
    /// Its topic and its type.
    pub channel: Arc<Channel<'static>>,
    /// UTC, in ns since 1970.
    pub utc_ns: u64,
    /// The message, in CDR.
    pub data: Vec<u8>,
}

impl TelemetryMessage {
    fn decode<M: RosMessage + DeserializeOwned>(&self) -> Result<M, TelemetryError> {
        cdr::deserialize(&self.data).map_err(|cause| TelemetryError::Decode {
            topic: self.channel.topic.clone(),
            cause,
        })
    }
}

/// Iterates over the messages of a telemetry file, in the file's order. Every chunk is compared with its checksum before
/// its first message is read.
///
/// A file whose writer was killed ends in the middle of a record, or with an open chunk, whose length is not
/// known yet. Its whole chunks are read, and then [`torn`](Self::torn) counts them. Any other damage is an error.
pub struct TelemetryMessages<'a> {
    rest: &'a [u8],
    records: LinearReader,
    channels: ChannelAccumulator<'static>,
    ended: bool,
    torn: Option<Torn>,
}

impl<'a> TelemetryMessages<'a> {
    /// Over the bytes of a file.
    ///
    /// # Errors
    /// When they do not begin as an MCAP file.
    pub fn new(bytes: &'a [u8]) -> Result<Self, TelemetryError> {
        if !bytes.starts_with(mcap::MAGIC) {
            return Err(TelemetryError::NotMcap(McapError::BadMagic));
        }
        let closed = bytes.len() >= 2 * END.len() && bytes.ends_with(END);
        let whole = if closed { bytes.len() } else { whole_records(bytes) };
        let options = LinearReaderOptions::default()
            .with_record_length_limit(RECORD_BYTES)
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true);
        Ok(Self {
            rest: bytes.get(..whole).unwrap_or(bytes),
            records: LinearReader::new_with_options(options),
            channels: ChannelAccumulator::default(),
            ended: false,
            torn: (!closed).then_some(Torn {
                periods: 0,
                left_out: bytes.len() - whole,
            }),
        })
    }

    /// What was read, if the file ended in the middle of a record; `None` if it is whole. Known after the last
    /// period.
    pub fn torn(&self) -> Option<Torn> {
        self.torn
    }

    /// The next message of the file; `None` at its end.
    fn message(&mut self) -> Result<Option<TelemetryMessage>, McapError> {
        while let Some(event) = self.records.next_event() {
            let (opcode, data) = match event? {
                LinearReadEvent::ReadRequest(wanted) => {
                    let (now, rest) = self.rest.split_at(wanted.min(self.rest.len()));
                    self.records.insert(now.len()).copy_from_slice(now);
                    self.records.notify_read(now.len());
                    self.rest = rest;
                    continue;
                }
                LinearReadEvent::Record { data, opcode } => (opcode, data),
            };
            // Other records are not needed, and some of them are parsed without a check of their
            // length.
            if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
                continue;
            }
            match mcap::parse_record(opcode, data)? {
                Record::Schema { header, data } => self.channels.add_schema_from_slice(header, &data)?,
                Record::Channel(channel) => self.channels.add_channel(channel)?,
                Record::Message { header, data } => {
                    let unknown = McapError::UnknownChannel(header.sequence, header.channel_id);
                    return Ok(Some(TelemetryMessage {
                        channel: self.channels.get(header.channel_id).ok_or(unknown)?,
                        utc_ns: header.log_time,
                        data: data.into_owned(),
                    }));
                }
                _ => {}
            }
        }
        Ok(None)
    }

    fn checked(&mut self) -> Result<Option<TelemetryMessage>, TelemetryError> {
        let message = match self.message() {
            Ok(message) => message,
            Err(McapError::UnexpectedEof) if self.torn.is_some() => None,
            Err(error) => return Err(TelemetryError::NotMcap(error)),
        };
        if let Some(TelemetryMessage { channel, .. }) = &message {
            if channel.message_encoding != "cdr" {
                return Err(TelemetryError::Encoding {
                    topic: channel.topic.clone(),
                    encoding: channel.message_encoding.clone(),
                });
            }
            if let Some(torn) = &mut self.torn
                && channel.topic == JointState::TOPIC
            {
                torn.periods += 1;
            }
        }
        Ok(message)
    }
}

impl Iterator for TelemetryMessages<'_> {
    type Item = Result<TelemetryMessage, TelemetryError>;

    fn next(&mut self) -> Option<Self::Item> {
        if self.ended {
            return None;
        }
        let next = self.checked().transpose();
        self.ended = !matches!(next, Some(Ok(_)));
        next
    }
}

/// Iterates over the samples of a telemetry file, in the file's order. A message on a topic that this program does not
/// write is skipped.
pub struct TelemetryReader<'a> {
    messages: TelemetryMessages<'a>,
    wrench: Option<(u64, Wrench)>,
    control: Option<(u64, Control<'static>)>,
    uncertainty: Option<Wrench>,
    /// The phase as it was told last, and when.
    phase: Option<(u64, PhaseState)>,
}

impl<'a> TelemetryReader<'a> {
    /// Over the bytes of a file.
    ///
    /// # Errors
    /// When they do not begin as an MCAP file.
    pub fn new(bytes: &'a [u8]) -> Result<Self, TelemetryError> {
        Ok(Self {
            messages: TelemetryMessages::new(bytes)?,
            wrench: None,
            control: None,
            uncertainty: None,
            phase: None,
        })
    }

    /// As of its messages: [`TelemetryMessages::torn`].
    pub fn torn(&self) -> Option<Torn> {
        self.messages.torn()
    }

    /// Takes one message. Returns the sample that it completes.
    fn take(&mut self, message: &TelemetryMessage) -> Result<Option<Period>, TelemetryError> {
        let utc_ns = message.utc_ns;
        match message.channel.topic.as_str() {
            WrenchStamped::TOPIC => self.wrench = Some((utc_ns, message.decode::<WrenchStamped<'_>>()?.wrench)),
            Uncertainty::TOPIC => self.uncertainty = Some(message.decode::<Uncertainty<'_>>()?.0.wrench),
            Control::TOPIC => self.control = Some((utc_ns, message.decode()?)),
            PhaseState::TOPIC => self.phase = Some((utc_ns, message.decode()?)),
            JointState::TOPIC => {
                let passed_ns = |(told_ns, phase): &(u64, PhaseState)| {
                    let told_device_ns = phase.device_us.saturating_mul(1000);
                    told_device_ns.saturating_add(utc_ns.saturating_sub(*told_ns))
                };
                return Ok(Some(Period {
                    utc_ns,
                    device_ns: self.phase.as_ref().map_or(utc_ns, passed_ns),
                    joints: message.decode()?,
                    wrench: self
                        .wrench
                        .take()
                        .filter(|(at, _)| *at == utc_ns)
                        .map(|(_, wrench)| wrench),
                    uncertainty: self.uncertainty,
                    control: self
                        .control
                        .take()
                        .filter(|(at, _)| *at == utc_ns)
                        .map(|(_, control)| control),
                    phase: self.phase.as_ref().map(|(_, phase)| phase.clone()),
                }));
            }
            _ => {}
        }
        Ok(None)
    }
}

impl Iterator for TelemetryReader<'_> {
    type Item = Result<Period, TelemetryError>;

    fn next(&mut self) -> Option<Self::Item> {
        loop {
            let taken = match self.messages.next()? {
                Ok(message) => self.take(&message).transpose(),
                Err(error) => Some(Err(error)),
            };
            if let Some(taken) = taken {
                self.messages.ended |= taken.is_err();
                return Some(taken);
            }
        }
    }
}

#[cfg(test)]
#[path = "reader_tests.rs"]
mod tests;
