//! Reads a telemetry file that the writer wrote, sample by sample.

use mcap::McapError;
use mcap::read::ChannelAccumulator;
use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use serde::Deserialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use super::log::EventMessage;
use super::messages::{JointStates, PhaseState, StampedWrench, Tcp, TelemetryMessage as _};
use super::scene::FrameTransforms;
use super::writer::TelemetryError;

/// The messages of one control period. A message that the file lacks is `None`.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Period {
    /// UTC, in ns since 1970. Device time in files of programs before version 0.2, which had no UTC.
    pub utc_ns: u64,
    /// Joints.
    pub joint_states: Option<JointStates<'static>>,
    /// Force and torque.
    pub wrench: Option<StampedWrench<'static>>,
    /// TCP.
    pub tcp: Option<Tcp<'static>>,
    /// Phase and flags.
    pub phase: Option<PhaseState>,
    /// Frames of the arm, which few periods have.
    pub frames: Option<FrameTransforms<'static>>,
    /// Recordings that were completed: few periods have one.
    pub recorded: Vec<Recorded>,
}

/// A completed recording: the nest sat on a sphere.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Deserialize)]
pub struct Recorded {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time of the first sample, in us.
    pub start_us: u64,
    /// Device time of the last sample, in us.
    pub end_us: u64,
}

/// An event of the controller, as far as the reader needs it.
#[derive(Deserialize)]
struct EventRead {
    kind: String,
    data: Value,
}

impl Period {
    /// Device time since the controller's start, in ns.
    pub fn device_ns(&self) -> u64 {
        let told = self.phase.and_then(|phase| phase.device_time);
        told.map_or(self.utc_ns, |time| time.time_ns())
    }
}

/// The longest record that is read, in bytes. A chunk of the writer has 1 MiB. The limit keeps a
/// damaged length from taking all memory.
const LONGEST_RECORD: usize = 64 << 20;
/// The last bytes of a whole file.
const END: &[u8] = mcap::MAGIC;

/// Iterates over the control periods of a telemetry file, in the file's order.
///
/// The messages of one control period follow each other and have one time. A
/// message on a topic that this program does not write is skipped. Every chunk is
/// compared with its checksum before its first message is read.
///
/// A file whose writer was killed ends in the middle of a record, or with an open chunk, whose length is not
/// known yet. Its whole chunks are read, and then [`torn`](Self::torn) counts them. Any other damage is an error.
pub struct TelemetryReader<'a> {
    rest: &'a [u8],
    records: LinearReader,
    channels: ChannelAccumulator<'static>,
    period: Option<Period>,
    ended: bool,
    torn: Option<Torn>,
}

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

/// A message with the topic of its channel.
struct TopicMessage {
    topic: String,
    time_ns: u64,
    data: Vec<u8>,
}

impl<'a> TelemetryReader<'a> {
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
            .with_record_length_limit(LONGEST_RECORD)
            .with_prevalidate_chunk_crcs(true)
            .with_validate_data_section_crc(true);
        Ok(Self {
            rest: bytes.get(..whole).unwrap_or(bytes),
            records: LinearReader::new_with_options(options),
            channels: ChannelAccumulator::default(),
            period: None,
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
    fn message(&mut self) -> Result<Option<TopicMessage>, McapError> {
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
                    return Ok(Some(TopicMessage {
                        topic: self.channels.get(header.channel_id).ok_or(unknown)?.topic.clone(),
                        time_ns: header.log_time,
                        data: data.into_owned(),
                    }));
                }
                _ => {}
            }
        }
        Ok(None)
    }

    /// Takes one message. Returns the period before it, if it begins the next.
    fn take(&mut self, message: &TopicMessage) -> Result<Option<Period>, TelemetryError> {
        let topic = message.topic.as_str();
        let mut next = Period {
            utc_ns: message.time_ns,
            ..Period::default()
        };
        let current = self.period.as_ref().is_some_and(|p| p.utc_ns == message.time_ns);
        let target = if current {
            self.period.get_or_insert_default()
        } else {
            &mut next
        };
        match topic {
            JointStates::TOPIC => target.joint_states = Some(decode(topic, &message.data)?),
            StampedWrench::TOPIC => target.wrench = Some(decode(topic, &message.data)?),
            Tcp::TOPIC => target.tcp = Some(decode(topic, &message.data)?),
            PhaseState::TOPIC => target.phase = Some(decode(topic, &message.data)?),
            FrameTransforms::TOPIC => target.frames = Some(decode(topic, &message.data)?),
            EventMessage::TOPIC => {
                let event: EventRead = decode(topic, &message.data)?;
                if event.kind != "Recording" {
                    return Ok(None);
                }
                let recorded = Recorded::deserialize(event.data).map_err(|cause| TelemetryError::Decode {
                    topic: topic.to_owned(),
                    cause,
                })?;
                target.recorded.push(recorded);
            }
            _ => return Ok(None),
        }
        Ok(if current { None } else { self.period.replace(next) })
    }
}

fn decode<M: DeserializeOwned>(topic: &str, data: &[u8]) -> Result<M, TelemetryError> {
    serde_json::from_slice(data).map_err(|cause| TelemetryError::Decode {
        topic: topic.to_owned(),
        cause,
    })
}

impl Iterator for TelemetryReader<'_> {
    type Item = Result<Period, TelemetryError>;

    fn next(&mut self) -> Option<Self::Item> {
        while !self.ended {
            let taken = match self.message() {
                Ok(Some(message)) => self.take(&message),
                // The last period may lack messages: it is left out.
                Err(McapError::UnexpectedEof) if self.torn.is_some() => {
                    self.ended = true;
                    return None;
                }
                Err(error) => Err(TelemetryError::NotMcap(error)),
                Ok(None) => {
                    self.ended = true;
                    return self.period.take().map(Ok);
                }
            };
            match taken {
                Ok(None) => {}
                Ok(Some(period)) => {
                    if let Some(torn) = &mut self.torn {
                        torn.periods += 1;
                    }
                    return Some(Ok(period));
                }
                Err(error) => {
                    self.ended = true;
                    return Some(Err(error));
                }
            }
        }
        None
    }
}

#[cfg(test)]
#[path = "reader_tests.rs"]
mod tests;
