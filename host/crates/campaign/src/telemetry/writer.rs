//! Writes telemetry as an MCAP file: messages of ROS 2 in CDR, each topic with its definition, chunks compressed by
//! Zstandard, and the URDF as an attachment. The modules [`messages`](super::messages), [`scene`](super::scene) and
//! [`log`](super::log) have the messages.

use std::collections::BTreeMap;
use std::io::{Seek, Write};
use std::sync::Arc;

use cdr::{CdrLe, Infinite};
use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use spherecal_shared::protocol::host::{Event, Sample};

use super::log::{ContactPoint, EventMessage, FaultMessage, Level, LogMessage};
use super::messages::{Control, JointState, PhaseState, Uncertainty, WrenchStamped};
use super::ros::{RosMessage, definition};
use super::scene::{DrawnArm, FrameTransforms, RobotDescription};
use super::utc::Moment;

/// What readers of the file are made for.
pub(super) const PROFILE: &str = "ros2";
/// Device time between two messages of what changes with the posture, in µs. The eye needs no more.
const POSTURE_PERIOD_US: u64 = 100_000;
/// Device time between two messages of `/phase` where nothing changes, in µs.
const PHASE_PERIOD_US: u64 = 1_000_000;

/// Why telemetry could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// The file could not be written.
    #[error("telemetry cannot be written ({0}): check the directory and the space left")]
    File(#[from] McapError),
    /// A message could not be encoded.
    #[error("a telemetry message cannot be encoded ({0})")]
    Encode(#[from] cdr::Error),
    /// The file is not a whole MCAP file.
    #[error("the file is not a whole MCAP file ({0}): repair it with `mcap recover`")]
    NotMcap(McapError),
    /// The messages have another encoding.
    #[error("messages of {topic} are encoded as \"{encoding}\", not as CDR: was the file written by another program?")]
    Encoding {
        /// Topic of the message.
        topic: String,
        /// Its encoding.
        encoding: String,
    },
    /// A message is not what its topic says.
    #[error("a message of {topic} cannot be read ({cause}): was the file written by another program?")]
    Decode {
        /// Topic of the message.
        topic: String,
        /// What is wrong.
        cause: cdr::Error,
    },
}

/// A topic in the file.
struct Channel {
    id: u16,
    /// Number of its next message.
    sequence: u32,
}

/// Writes samples into an MCAP file.
pub struct TelemetryWriter<W: Write + Seek> {
    writer: Writer<W>,
    channels: BTreeMap<&'static str, Channel>,
    /// The message that is being written.
    buffer: Vec<u8>,
    arm: Arc<DrawnArm>,
    /// Device time of the last messages of the posture, in µs.
    drawn_us: Option<u64>,
    /// The last message of `/phase`, and UTC at its device time 0, in ns.
    phase: Option<(PhaseState, u64)>,
}

/// Whether the time `now_us` is a period or more after `last_us`, or before it.
fn due(last_us: u64, now_us: u64, period_us: u64) -> bool {
    now_us.checked_sub(last_us).is_none_or(|passed| passed >= period_us)
}

impl<W: Write + Seek> TelemetryWriter<W> {
    /// Opens a file for a robot; `about` is kept as metadata, and `utc_ns` is the time of day in ns
    /// since 1970.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(file: W, arm: DrawnArm, about: &BTreeMap<String, String>, utc_ns: u64) -> Result<Self, TelemetryError> {
        let writer = WriteOptions::new()
            .compression(Some(Compression::Zstd))
            // Compressed where it is written: the program has better work for other threads.
            .compression_threads(0)
            .chunk_size(Some(1 << 20))
            .profile(PROFILE)
            .library(concat!("spherecal ", env!("CARGO_PKG_VERSION")))
            .create(file)?;
        let mut own = Self {
            writer,
            channels: BTreeMap::new(),
            buffer: Vec::new(),
            arm: Arc::new(arm),
            drawn_us: None,
            phase: None,
        };
        own.topic::<JointState<'_>>()?;
        own.topic::<WrenchStamped<'_>>()?;
        own.topic::<Uncertainty<'_>>()?;
        own.topic::<Control<'_>>()?;
        own.topic::<PhaseState>()?;
        own.topic::<FrameTransforms<'_>>()?;
        own.topic::<RobotDescription<'_>>()?;
        own.topic::<EventMessage>()?;
        own.topic::<FaultMessage>()?;
        own.topic::<ContactPoint>()?;
        own.topic::<LogMessage<'_>>()?;
        own.writer.write_metadata(&mcap::records::Metadata {
            name: "spherecal".to_owned(),
            metadata: about.clone(),
        })?;
        own.writer.attach(&mcap::Attachment {
            log_time: utc_ns,
            create_time: utc_ns,
            name: "robot.urdf".to_owned(),
            media_type: "application/xml".to_owned(),
            data: own.arm.urdf.as_bytes().into(),
        })?;
        // The file says what it is from the beginning, also if this program is killed.
        own.writer.flush()?;
        let data = own.arm.urdf.clone().into();
        own.put(utc_ns, &RobotDescription { data })?;
        Ok(own)
    }

    /// Adds the topic of a message type to the file.
    fn topic<M: RosMessage>(&mut self) -> Result<(), TelemetryError> {
        let schema = self
            .writer
            .add_schema(M::TYPE, "ros2msg", definition::<M>().as_bytes())?;
        let id = self.writer.add_channel(schema, M::TOPIC, "cdr", &BTreeMap::new())?;
        self.channels.insert(M::TOPIC, Channel { id, sequence: 0 });
        Ok(())
    }

    /// Writes one sample, and what belongs to its posture and its phase where that is due.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, at: Moment, sample: &Sample) -> Result<(), TelemetryError> {
        let utc_ns = at.utc_ns;
        let phase = PhaseState::new(utc_ns, at.device_us, sample);
        let start_ns = utc_ns.saturating_sub(at.device_us.saturating_mul(1000));
        let told = self.phase.as_ref().is_some_and(|(last, last_start_ns)| {
            let same = PhaseState {
                stamp: last.stamp,
                device_us: last.device_us,
                ..phase.clone()
            };
            same == *last && start_ns == *last_start_ns && !due(last.device_us, at.device_us, PHASE_PERIOD_US)
        });
        if !told {
            self.put(utc_ns, &phase)?;
            self.phase = Some((phase, start_ns));
        }
        // The arm lends its names to the messages.
        let arm = Arc::clone(&self.arm);
        let f0 = arm.frames.f0();
        if self
            .drawn_us
            .is_none_or(|last| due(last, at.device_us, POSTURE_PERIOD_US))
        {
            self.drawn_us = Some(at.device_us);
            self.put(utc_ns, &Uncertainty::new(utc_ns, f0, &arm.wrench_error(sample)))?;
            self.put(utc_ns, &arm.transforms(utc_ns, &arm.angles(sample)))?;
        }
        let names = arm.frames.joint_names();
        self.put(utc_ns, &WrenchStamped::new(utc_ns, f0, sample))?;
        self.put(utc_ns, &Control::new(utc_ns, f0, names.len(), sample))?;
        self.put(utc_ns, &JointState::new(utc_ns, names, sample))
    }

    /// Writes an event of the controller; a fault goes into the log too. Telemetry and statistics
    /// are left out.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn event(&mut self, at: Moment, event: &Event) -> Result<(), TelemetryError> {
        if let Some(message) = EventMessage::new(at.utc_ns, event) {
            self.put(at.utc_ns, &message)?;
        }
        match event {
            Event::Fault(report) => {
                let message = FaultMessage::new(at.utc_ns, report);
                self.put(at.utc_ns, &message)?;
                self.put(at.utc_ns, &LogMessage::new(at.utc_ns, Level::Error, &message.text))
            }
            Event::Recording(recording) => self.put(at.utc_ns, &ContactPoint::new(at, recording)),
            _ => Ok(()),
        }
    }

    /// Writes a remark into the log.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn note(&mut self, at: Moment, text: &str) -> Result<(), TelemetryError> {
        self.put(at.utc_ns, &LogMessage::new(at.utc_ns, Level::Info, text))
    }

    fn put<M: RosMessage>(&mut self, utc_ns: u64, message: &M) -> Result<(), TelemetryError> {
        let Some(channel) = self.channels.get_mut(M::TOPIC) else {
            return Ok(());
        };
        self.buffer.clear();
        cdr::serialize_into::<_, _, _, CdrLe>(&mut self.buffer, message, Infinite)?;
        let header = MessageHeader {
            channel_id: channel.id,
            sequence: channel.sequence,
            log_time: utc_ns,
            publish_time: utc_ns,
        };
        channel.sequence = channel.sequence.wrapping_add(1);
        Ok(self.writer.write_to_known_channel(&header, &self.buffer)?)
    }

    /// Writes the index and closes; without it the file can only be recovered.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn finish(mut self) -> Result<(), TelemetryError> {
        self.writer.finish()?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_model::robots;
    use spherecal_shared::protocol::host::{Fault, FaultReport, Phase, PhaseChange};

    const DAY_NS: u64 = 1_800_000_000_000_000_000;

    fn at(device_us: u64) -> Moment {
        Moment {
            utc_ns: DAY_NS + 1000 * device_us,
            device_us,
        }
    }

    // Fails if the file is not valid MCAP, loses a message, writes what changes slowly too often, or if it has no UTC
    // times, no description of the robot, or no frames. `tests/python/check_mcap.py` reads each message by its
    // definition.
    #[test]
    fn what_is_written_can_be_read() {
        let model = robots::built_in("iiwa7").unwrap();
        let arm = DrawnArm::new(&model, &model.tool_in_table());
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = TelemetryWriter::new(&mut bytes, arm, &BTreeMap::new(), DAY_NS).unwrap();
        let phase = PhaseChange {
            phase: Phase::Approaching,
            from: Phase::Taring,
            time_us: 0,
            tick: 0,
        };
        let fault = FaultReport {
            fault: Fault::Force,
            phase: Phase::Approaching,
            time_us: 0,
            tick: 0,
            joint: 0,
            value: 50.0,
            limit: f64::NAN,
        };
        writer.event(at(0), &Event::Phase(phase)).unwrap();
        writer.event(at(0), &Event::Fault(fault)).unwrap();
        writer.note(at(0), "a remark").unwrap();
        let telemetry = Event::Telemetry(heapless::Vec::new());
        writer.event(at(0), &telemetry).unwrap();
        for k in 0..500u16 {
            let sample = Sample {
                q: [0.1; spherecal_shared::MAX_JOINTS],
                force_n: [0.0, 0.0, f32::from(k)],
                // The arm comes near a singular posture once.
                flags: if k < 300 { 0 } else { 4 },
                ..Sample::default()
            };
            writer.write(at(u64::from(k) * 1000), &sample).unwrap();
        }
        writer.finish().unwrap();
        let bytes = bytes.into_inner();
        let mut count = BTreeMap::new();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            assert!(message.log_time >= DAY_NS);
            assert_eq!(message.channel.schema.as_ref().unwrap().encoding, "ros2msg");
            assert_eq!(message.channel.message_encoding, "cdr");
            *count.entry(message.channel.topic.clone()).or_insert(0) += 1;
        }
        let expected = [
            ("/control", 500),
            ("/events", 2),
            ("/faults", 1),
            ("/joint_states", 500),
            ("/log", 2),
            ("/phase", 2),
            ("/robot_description", 1),
            ("/tf", 5),
            ("/wrench", 500),
            ("/wrench_uncertainty", 5),
        ];
        assert_eq!(count, expected.map(|(topic, n)| (topic.to_owned(), n)).into());
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 1518);
        assert_eq!(summary.attachment_indexes[0].name, "robot.urdf");
        assert!(bytes.len() < 60_000, "{} bytes for 500 samples", bytes.len());
    }
}
