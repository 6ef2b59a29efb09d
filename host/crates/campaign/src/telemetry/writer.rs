//! The MCAP file: four channels of JSON with schemas, chunks compressed by LZ4.
//!
//! | topic | message |
//! |---|---|
//! | `/joint_states` | names, position (rad), velocity (rad/s), effort (measured, N m), command (N m) |
//! | `/wrench` | estimated force (N) and torque (N m) of the environment at the TCP, axes of F0 |
//! | `/tcp` | computed and commanded TCP in F0 (m) |
//! | `/phase` | phase of the procedure, by name and number, and flags |
//!
//! The shapes follow `sensor_msgs/JointState`, `geometry_msgs/WrenchStamped` and
//! `foxglove.PoseInFrame`, so that panels made for those find their fields.

use std::collections::BTreeMap;
use std::io::{Seek, Write};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use serde_json::{Value, json};

/// Why telemetry could not be written.
#[derive(Debug, thiserror::Error)]
pub enum TelemetryError {
    /// The file refused.
    #[error("telemetry cannot be written ({0}): check the directory and the space left")]
    File(#[from] McapError),
    /// A message could not be encoded.
    #[error("a telemetry message cannot be encoded ({0})")]
    Encode(#[from] serde_json::Error),
}

/// One sample of the control loop.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TelemetrySample<'a> {
    /// Device time, in ns.
    pub time_ns: u64,
    /// Joint angles, in rad.
    pub q: &'a [f32],
    /// Joint velocities, in rad/s.
    pub dq: &'a [f32],
    /// Measured joint torques, in N m.
    pub tau: &'a [f32],
    /// Commanded joint torques, in N m.
    pub command: &'a [f32],
    /// Estimated force at the TCP, F0, in N.
    pub force_n: [f32; 3],
    /// Estimated torque about the TCP, F0, in N m.
    pub torque_nm: [f32; 3],
    /// Computed TCP in F0, in m.
    pub tcp_m: [f32; 3],
    /// Commanded TCP in F0, in m.
    pub setpoint_m: [f32; 3],
    /// Phase by name.
    pub phase: &'a str,
    /// Phase by number.
    pub phase_number: u8,
    /// Flags of the control loop.
    pub flags: u8,
}

/// Writes samples into an MCAP file.
pub struct TelemetryWriter<W: Write + Seek> {
    writer: Writer<W>,
    channels: [u16; 4],
    names: Vec<String>,
    sequence: u32,
}

/// A JSON schema for an object.
fn object(title: &str, properties: Value) -> Value {
    json!({ "$schema": "https://json-schema.org/draft/2020-12/schema", "title": title, "type": "object", "properties": properties })
}

fn numbers() -> Value {
    json!({ "type": "array", "items": { "type": "number" } })
}

fn vector() -> Value {
    json!({ "type": "object", "properties": { "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" } } })
}

fn stamp() -> Value {
    json!({ "type": "object", "title": "time", "properties": { "sec": { "type": "integer" }, "nsec": { "type": "integer" } } })
}

fn pose() -> Value {
    json!({ "type": "object", "title": "foxglove.Pose", "properties": {
        "position": vector(),
        "orientation": { "type": "object", "properties": {
            "x": { "type": "number" }, "y": { "type": "number" }, "z": { "type": "number" }, "w": { "type": "number" } } } } })
}

/// Topic, schema name and schema of the four channels.
fn schemas() -> [(&'static str, &'static str, Value); 4] {
    [
        (
            "/joint_states",
            "sensor_msgs/JointState",
            object(
                "sensor_msgs/JointState",
                json!({ "timestamp": stamp(), "name": { "type": "array", "items": { "type": "string" } },
                        "position": numbers(), "velocity": numbers(), "effort": numbers(), "command": numbers() }),
            ),
        ),
        (
            "/wrench",
            "geometry_msgs/WrenchStamped",
            object(
                "geometry_msgs/WrenchStamped",
                json!({ "timestamp": stamp(), "frame_id": { "type": "string" }, "magnitude": { "type": "number" },
                        "wrench": { "type": "object", "properties": { "force": vector(), "torque": vector() } } }),
            ),
        ),
        (
            "/tcp",
            "foxglove.PoseInFrame",
            object(
                "foxglove.PoseInFrame",
                json!({ "timestamp": stamp(), "frame_id": { "type": "string" }, "pose": pose(), "setpoint": vector(),
                        "deviation_mm": { "type": "number" } }),
            ),
        ),
        (
            "/phase",
            "spherecal.Phase",
            object(
                "spherecal.Phase",
                json!({ "timestamp": stamp(), "phase": { "type": "string" }, "number": { "type": "integer" },
                        "saturated": { "type": "boolean" }, "rate_limited": { "type": "boolean" },
                        "near_singular": { "type": "boolean" } }),
            ),
        ),
    ]
}

fn xyz(v: [f32; 3]) -> Value {
    json!({ "x": v[0], "y": v[1], "z": v[2] })
}

fn length(v: [f32; 3]) -> f32 {
    v.iter().map(|x| x * x).sum::<f32>().sqrt()
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
        let mut channels = [0; 4];
        for (slot, (topic, name, schema)) in channels.iter_mut().zip(schemas()) {
            let schema = writer.add_schema(name, "jsonschema", &serde_json::to_vec(&schema)?)?;
            *slot = writer.add_channel(schema, topic, "json", &BTreeMap::new())?;
        }
        writer.write_metadata(&mcap::records::Metadata {
            name: "spherecal".to_owned(),
            metadata: about.clone(),
        })?;
        Ok(Self {
            writer,
            channels,
            names: joints.to_vec(),
            sequence: 0,
        })
    }

    /// Writes one sample into all channels.
    ///
    /// # Errors
    /// When it cannot be written.
    pub fn write(&mut self, s: &TelemetrySample<'_>) -> Result<(), TelemetryError> {
        let timestamp = json!({ "sec": s.time_ns / 1_000_000_000, "nsec": s.time_ns % 1_000_000_000 });
        let off: [f32; 3] = core::array::from_fn(|k| s.tcp_m[k] - s.setpoint_m[k]);
        let messages = [
            json!({ "timestamp": timestamp, "name": self.names, "position": s.q, "velocity": s.dq, "effort": s.tau,
                    "command": s.command }),
            json!({ "timestamp": timestamp, "frame_id": "base", "magnitude": length(s.force_n),
                    "wrench": { "force": xyz(s.force_n), "torque": xyz(s.torque_nm) } }),
            json!({ "timestamp": timestamp, "frame_id": "base",
                    "pose": { "position": xyz(s.tcp_m), "orientation": { "x": 0.0, "y": 0.0, "z": 0.0, "w": 1.0 } },
                    "setpoint": xyz(s.setpoint_m), "deviation_mm": 1e3 * length(off) }),
            json!({ "timestamp": timestamp, "phase": s.phase, "number": s.phase_number, "saturated": s.flags & 1 != 0,
                    "rate_limited": s.flags & 2 != 0, "near_singular": s.flags & 4 != 0 }),
        ];
        for (channel_id, message) in self.channels.into_iter().zip(messages) {
            let header = MessageHeader {
                channel_id,
                sequence: self.sequence,
                log_time: s.time_ns,
                publish_time: s.time_ns,
            };
            self.writer
                .write_to_known_channel(&header, &serde_json::to_vec(&message)?)?;
        }
        self.sequence = self.sequence.wrapping_add(1);
        Ok(())
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

    /// Fails if the file is not valid MCAP, loses a message, or a message does
    /// not parse as what its schema says.
    #[test]
    fn what_is_written_can_be_read() {
        let names: Vec<String> = (1..=7).map(|k| format!("joint_{k}")).collect();
        let mut bytes = std::io::Cursor::new(Vec::new());
        let mut writer = TelemetryWriter::new(&mut bytes, &names, &BTreeMap::new()).unwrap();
        let q = [0.1f32; 7];
        for k in 0..500u64 {
            writer
                .write(&TelemetrySample {
                    time_ns: k * 1_000_000,
                    q: &q,
                    dq: &q,
                    tau: &q,
                    command: &q,
                    force_n: [0.0, 0.0, k as f32],
                    phase: "approaching",
                    ..TelemetrySample::default()
                })
                .unwrap();
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
            for key in value.as_object().unwrap().keys() {
                assert!(schema["properties"].get(key).is_some(), "{key} is not in the schema");
            }
            *count.entry(message.channel.topic.clone()).or_insert(0) += 1;
        }
        assert_eq!(count.len(), 4);
        assert!(count.values().all(|n| *n == 500), "{count:?}");
        let summary = mcap::Summary::read(&bytes).unwrap().unwrap();
        assert_eq!(summary.stats.unwrap().message_count, 2000);
        assert!(bytes.len() < 120_000, "{} bytes for 500 samples", bytes.len());
    }
}
