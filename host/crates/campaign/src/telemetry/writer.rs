//! Writes telemetry as an MCAP file: channels of JSON with schemas, chunks compressed by LZ4, and
//! the URDF as an attachment. The modules [`messages`](super::messages), [`scene`](super::scene) and
//! [`log`](super::log) have the channels.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use spherecal_shared::protocol::host::{Event, Sample};

use super::log::{EventMessage, FaultMessage, Level, LogMessage};
use super::messages::{JointStates, PhaseState, Stamp, StampedWrench, Tcp, TelemetryMessage};
use super::scene::{DrawnArm, FrameTransforms, RobotDescription};
use super::utc::Moment;

/// Device time between two messages of `/tf`, in µs. The eye needs no more, and each has all frames.
const TF_PERIOD_US: u64 = 50_000;

/// Why telemetry could not be written or read.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// The file could not be written.
    #[error("telemetry cannot be written ({0}): check the directory and the space left")]
    File(#[from] McapError),
    /// A message could not be encoded.
    #[error("a telemetry message cannot be encoded ({0})")]
    Encode(#[from] serde_json::Error),
    /// The file is not a whole MCAP file.
    #[error("the file is not a whole MCAP file ({0}): repair it with `mcap recover`")]
    NotMcap(McapError),
    /// A message is not what its topic says.
    #[error("a message of {topic} cannot be read ({cause}): was the file written by another program?")]
    Decode {
        /// Topic of the message.
        topic: String,
        /// What is wrong.
        cause: serde_json::Error,
    },
}

/// Writes samples into an MCAP file.
pub struct TelemetryWriter<W: Write + Seek> {
    writer: Writer<W>,
    channels: Channels,
    arm: DrawnArm,
    sequence: u32,
    /// Device time of the last message of `/tf`, in µs.
    drawn_us: Option<u64>,
}

/// Ids of the channels in the file.
struct Channels {
    joint_states: u16,
    wrench: u16,
    tcp: u16,
    phase: u16,
    tf: u16,
    description: u16,
    events: u16,
    faults: u16,
    log: u16,
}

/// Adds the channel of a message type to the file; returns its id.
fn add_channel<M: TelemetryMessage>(writer: &mut Writer<impl Write + Seek>) -> Result<u16, TelemetryError> {
    let schema = serde_json::to_vec(&M::schema())?;
    let schema = writer.add_schema(M::SCHEMA, "jsonschema", &schema)?;
    Ok(writer.add_channel(schema, M::TOPIC, "json", &BTreeMap::new())?)
}

impl<W: Write + Seek> TelemetryWriter<W> {
    /// Opens a file for a robot; `about` is kept as metadata, and `utc_ns` is the time of day in ns
    /// since 1970.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(file: W, arm: DrawnArm, about: &BTreeMap<String, String>, utc_ns: u64) -> Result<Self, TelemetryError> {
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(1 << 20))
            .profile("")
            .library(concat!("spherecal ", env!("CARGO_PKG_VERSION")))
            .create(file)?;
        let channels = Channels {
            joint_states: add_channel::<JointStates<'_>>(&mut writer)?,
            wrench: add_channel::<StampedWrench<'_>>(&mut writer)?,
            tcp: add_channel::<Tcp<'_>>(&mut writer)?,
            phase: add_channel::<PhaseState>(&mut writer)?,
            tf: add_channel::<FrameTransforms<'_>>(&mut writer)?,
            description: add_channel::<RobotDescription<'_>>(&mut writer)?,
            events: add_channel::<EventMessage>(&mut writer)?,
            faults: add_channel::<FaultMessage>(&mut writer)?,
            log: add_channel::<LogMessage>(&mut writer)?,
        };
        writer.write_metadata(&mcap::records::Metadata {
            name: "spherecal".to_owned(),
            metadata: about.clone(),
        })?;
        writer.attach(&mcap::Attachment {
            log_time: utc_ns,
            create_time: utc_ns,
            name: "robot.urdf".to_owned(),
            media_type: "application/xml".to_owned(),
            data: arm.urdf.as_bytes().into(),
        })?;
        // The file says what it is from the beginning, also if this program is killed.
        writer.flush()?;
        let mut own = Self {
            writer,
            channels,
            arm,
            sequence: 0,
            drawn_us: None,
        };
        let description = serde_json::to_vec(&RobotDescription {
            data: own.arm.urdf.as_str().into(),
        })?;
        own.put(own.channels.description, utc_ns, &description)?;
        Ok(own)
    }

    /// Writes one sample into the channels of the signals, and the frames where they are due.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, at: Moment, sample: &Sample) -> Result<(), TelemetryError> {
        let stamp = Stamp::from_ns(at.utc_ns);
        let q = self.arm.angles(sample);
        let f0 = self.arm.frames.f0();
        let joint_states = serde_json::to_vec(&JointStates::new(stamp, self.arm.frames.joint_names(), sample))?;
        let wrench = serde_json::to_vec(&StampedWrench::new(stamp, f0, sample, &self.arm.wrench_error(sample)))?;
        let orientation = self.arm.tcp_orientation(&q);
        let tcp = serde_json::to_vec(&Tcp::new(stamp, f0, sample, orientation))?;
        let device_time = Stamp::from_ns(at.device_us.saturating_mul(1000));
        let phase = serde_json::to_vec(&PhaseState::new(stamp, device_time, sample))?;
        self.put(self.channels.joint_states, at.utc_ns, &joint_states)?;
        self.put(self.channels.wrench, at.utc_ns, &wrench)?;
        self.put(self.channels.tcp, at.utc_ns, &tcp)?;
        self.put(self.channels.phase, at.utc_ns, &phase)?;
        let fresh = |last: u64| (last..last.saturating_add(TF_PERIOD_US)).contains(&at.device_us);
        if !self.drawn_us.is_some_and(fresh) {
            self.drawn_us = Some(at.device_us);
            let frames = serde_json::to_vec(&self.arm.transforms(stamp, &q))?;
            self.put(self.channels.tf, at.utc_ns, &frames)?;
        }
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
    }

    /// Writes an event of the controller; a fault goes into the log too. Telemetry and statistics
    /// are left out.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn event(&mut self, at: Moment, event: &Event) -> Result<(), TelemetryError> {
        let stamp = Stamp::from_ns(at.utc_ns);
        if let Some(message) = EventMessage::new(stamp, event) {
            self.put(self.channels.events, at.utc_ns, &serde_json::to_vec(&message)?)?;
        }
        if let Event::Fault(report) = event {
            let message = FaultMessage::new(stamp, report);
            self.put(self.channels.faults, at.utc_ns, &serde_json::to_vec(&message)?)?;
            self.log(at, Level::Error, &message.text)?;
        }
        Ok(())
    }

    /// Writes a remark into the log.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn note(&mut self, at: Moment, text: &str) -> Result<(), TelemetryError> {
        self.log(at, Level::Info, text)
    }

    fn log(&mut self, at: Moment, level: Level, text: &str) -> Result<(), TelemetryError> {
        let message = LogMessage::new(Stamp::from_ns(at.utc_ns), level, text);
        self.put(self.channels.log, at.utc_ns, &serde_json::to_vec(&message)?)
    }

    fn put(&mut self, channel_id: u16, time_ns: u64, message: &[u8]) -> Result<(), TelemetryError> {
        let header = MessageHeader {
            channel_id,
            sequence: self.sequence,
            log_time: time_ns,
            publish_time: time_ns,
        };
        Ok(self.writer.write_to_known_channel(&header, message)?)
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
    use serde_json::Value;

    use spherecal_model::robots;
    use spherecal_shared::protocol::host::{Fault, FaultReport, Phase, PhaseChange};

    /// Asserts that the schema describes every field of a value, and no other.
    fn assert_described(value: &Value, schema: &Value, path: &str) {
        if let Some(items) = value.as_array() {
            for item in items {
                assert_described(item, &schema["items"], path);
            }
        }
        let Some(fields) = value.as_object() else { return };
        // The fields of an event are those of the protocol.
        if path == "/events.data" {
            return;
        }
        let described = schema["properties"].as_object().expect(path);
        assert!(
            fields.keys().collect::<std::collections::BTreeSet<_>>() == described.keys().collect(),
            "{path}: {fields:?} against {described:?}"
        );
        for (name, value) in fields {
            assert_described(value, &described[name], &format!("{path}.{name}"));
        }
    }

    const DAY_NS: u64 = 1_800_000_000_000_000_000;

    fn at(device_us: u64) -> Moment {
        Moment {
            utc_ns: DAY_NS + 1000 * device_us,
            device_us,
        }
    }

    // Fails if the file is not valid MCAP, loses a message, if a message and its schema have
    // different fields, or if it has no UTC times, no description of the robot, or no frames.
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
            let schema = message.channel.schema.as_ref().unwrap();
            assert_eq!(schema.encoding, "jsonschema");
            let schema: Value = serde_json::from_slice(&schema.data).unwrap();
            let value: Value = serde_json::from_slice(&message.data).unwrap();
            assert_described(&value, &schema, &message.channel.topic);
            *count.entry(message.channel.topic.clone()).or_insert(0) += 1;
        }
        let expected = [
            ("/events", 2),
            ("/faults", 1),
            ("/joint_states", 500),
            ("/log", 2),
            ("/phase", 500),
            ("/robot_description", 1),
            ("/tcp", 500),
            ("/tf", 10),
            ("/wrench", 500),
        ];
        assert_eq!(count, expected.map(|(topic, n)| (topic.to_owned(), n)).into());
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 2016);
        assert_eq!(summary.attachment_indexes[0].name, "robot.urdf");
        assert!(bytes.len() < 140_000, "{} bytes for 500 samples", bytes.len());
    }
}
