//! Writes telemetry as an MCAP file: four channels of JSON with schemas, chunks
//! compressed by LZ4. The module [`messages`](super::messages) has the channels.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use spherecal_shared::protocol::host::Sample;

use super::messages::{JointStates, PhaseState, Stamp, Tcp, TelemetryMessage, Wrench};

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
    names: Vec<String>,
    sequence: u32,
}

/// Ids of the channels in the file.
struct Channels {
    joint_states: u16,
    wrench: u16,
    tcp: u16,
    phase: u16,
}

/// Adds the channel of a message type to the file; returns its id.
fn add_channel<M: TelemetryMessage>(writer: &mut Writer<impl Write + Seek>) -> Result<u16, TelemetryError> {
    let schema = serde_json::to_vec(&M::schema())?;
    let schema = writer.add_schema(M::SCHEMA, "jsonschema", &schema)?;
    Ok(writer.add_channel(schema, M::TOPIC, "json", &BTreeMap::new())?)
}

impl<W: Write + Seek> TelemetryWriter<W> {
    /// Opens a file for a robot with the named joints; `about` is kept as metadata.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn new(file: W, joints: &[String], about: &BTreeMap<String, String>) -> Result<Self, TelemetryError> {
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .chunk_size(Some(1 << 20))
            .profile("")
            .library(concat!("spherecal ", env!("CARGO_PKG_VERSION")))
            .create(file)?;
        let channels = Channels {
            joint_states: add_channel::<JointStates<'_>>(&mut writer)?,
            wrench: add_channel::<Wrench<'_>>(&mut writer)?,
            tcp: add_channel::<Tcp<'_>>(&mut writer)?,
            phase: add_channel::<PhaseState>(&mut writer)?,
        };
        writer.write_metadata(&mcap::records::Metadata {
            name: "spherecal".to_owned(),
            metadata: about.clone(),
        })?;
        // The file says what it is from the beginning, also if this program is killed.
        writer.flush()?;
        Ok(Self {
            writer,
            channels,
            names: joints.to_vec(),
            sequence: 0,
        })
    }

    /// Writes one sample, taken at device time `time_us` (µs), into all channels.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, time_us: u64, sample: &Sample) -> Result<(), TelemetryError> {
        let stamp = Stamp::from_us(time_us);
        let joint_states = serde_json::to_vec(&JointStates::new(stamp, &self.names, sample))?;
        self.put(self.channels.joint_states, time_us, &joint_states)?;
        self.put(
            self.channels.wrench,
            time_us,
            &serde_json::to_vec(&Wrench::from((stamp, sample)))?,
        )?;
        self.put(
            self.channels.tcp,
            time_us,
            &serde_json::to_vec(&Tcp::from((stamp, sample)))?,
        )?;
        self.put(
            self.channels.phase,
            time_us,
            &serde_json::to_vec(&PhaseState::from((stamp, sample)))?,
        )?;
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
    }

    fn put(&mut self, channel_id: u16, time_us: u64, message: &[u8]) -> Result<(), TelemetryError> {
        let time_ns = time_us.saturating_mul(1000);
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

    /// Asserts that the schema describes every field of a value, and no other.
    fn assert_described(value: &Value, schema: &Value, path: &str) {
        let Some(fields) = value.as_object() else { return };
        let described = schema["properties"].as_object().expect(path);
        assert!(
            fields.keys().eq(described.keys()),
            "{path}: {fields:?} against {described:?}"
        );
        for (name, value) in fields {
            assert_described(value, &described[name], &format!("{path}.{name}"));
        }
    }

    // Fails if the file is not valid MCAP, loses a message, or if a message and
    // its schema have different fields.
    #[test]
    fn what_is_written_can_be_read() {
        let names: Vec<String> = (1..=7).map(|k| format!("joint_{k}")).collect();
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = TelemetryWriter::new(&mut bytes, &names, &BTreeMap::new()).unwrap();
        for k in 0..500u16 {
            let sample = Sample {
                q: [0.1; spherecal_shared::MAX_JOINTS],
                force_n: [0.0, 0.0, f32::from(k)],
                ..Sample::default()
            };
            writer.write(u64::from(k) * 1000, &sample).unwrap();
        }
        writer.finish().unwrap();
        let bytes = bytes.into_inner();
        let mut count = BTreeMap::new();
        for message in mcap::MessageStream::new(&bytes).unwrap() {
            let message = message.unwrap();
            let schema = message.channel.schema.as_ref().unwrap();
            assert_eq!(schema.encoding, "jsonschema");
            let schema: Value = serde_json::from_slice(&schema.data).unwrap();
            let value: Value = serde_json::from_slice(&message.data).unwrap();
            assert_described(&value, &schema, &message.channel.topic);
            *count.entry(message.channel.topic.clone()).or_insert(0) += 1;
        }
        assert_eq!(count.len(), 4);
        assert!(count.values().all(|n| *n == 500), "{count:?}");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 2000);
        assert!(bytes.len() < 120_000, "{} bytes for 500 samples", bytes.len());
    }
}
