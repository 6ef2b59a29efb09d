//! The telemetry of a run as a ROS 2 bag: a folder with an MCAP file and its `metadata.yaml`, which
//! `ros2 bag play`, RViz and PlotJuggler open.
//!
//! | topic | type | message |
//! |---|---|---|
//! | `/joint_states` | `sensor_msgs/msg/RosJointState` | position (rad), velocity (rad/s), effort (measured, N m) |
//! | `/wrench` | `geometry_msgs/msg/WrenchStamped` | estimated force (N) and torque (N m) at the TCP, axes of F0 |
//! | `/tf` | `tf2_msgs/msg/TFMessage` | the frames of the nominal robot, 20 times a second |
//! | `/contact` | `geometry_msgs/msg/PointStamped` | per recording: the TCP is at (0, 0, 0) of the frame `sphere_N` |
//!
//! `/contact` has the time of the middle of the recording, so that `spherecal identify --data` makes the poses of the run
//! from the bag.
//!
//! Messages are in CDR, little endian, each topic with its definition. Times are UTC.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use cdr::{CdrLe, Infinite};
use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};
use serde::Serialize;
use spherecal_campaign::telemetry::messages::{JointStates, Stamp, StampedWrench, Xyz};
use spherecal_campaign::telemetry::scene::{FrameTransform, FrameTransforms};
use spherecal_campaign::telemetry::{Period, TelemetryReader};
use spherecal_model::NewFile;

use super::{ExportError, Exported, TornFile};
use definitions::{JOINT_STATE, POINT_STAMPED, TF_MESSAGE, WRENCH_STAMPED};

mod definitions;

/// Name of the file in the folder.
const FILE: &str = "ros2_0.mcap";

#[derive(Serialize)]
struct Time {
    sec: i32,
    nanosec: u32,
}

#[derive(Serialize)]
struct RosHeader<'a> {
    stamp: Time,
    frame_id: &'a str,
}

#[derive(Serialize)]
struct RosVector3 {
    x: f64,
    y: f64,
    z: f64,
}

#[derive(Serialize)]
struct RosQuaternion {
    x: f64,
    y: f64,
    z: f64,
    w: f64,
}

#[derive(Serialize)]
struct RosJointState<'a> {
    header: RosHeader<'a>,
    name: &'a [String],
    position: Vec<f64>,
    velocity: Vec<f64>,
    effort: Vec<f64>,
}

#[derive(Serialize)]
struct WrenchStamped<'a> {
    header: RosHeader<'a>,
    force: RosVector3,
    torque: RosVector3,
}

#[derive(Serialize)]
struct PointStamped<'a> {
    header: RosHeader<'a>,
    point: RosVector3,
}

#[derive(Serialize)]
struct TransformStamped<'a> {
    header: RosHeader<'a>,
    child_frame_id: &'a str,
    translation: RosVector3,
    rotation: RosQuaternion,
}

#[derive(Serialize)]
struct TfMessage<'a> {
    transforms: Vec<TransformStamped<'a>>,
}

impl<'a> RosHeader<'a> {
    fn new(stamp: Stamp, frame_id: &'a str) -> Self {
        Self {
            stamp: Time {
                // ROS counts seconds in 32 bits: until 2038.
                sec: i32::try_from(stamp.sec).unwrap_or(i32::MAX),
                nanosec: stamp.nsec,
            },
            frame_id,
        }
    }
}

impl From<Xyz> for RosVector3 {
    fn from(v: Xyz) -> Self {
        Self {
            x: v.x.into(),
            y: v.y.into(),
            z: v.z.into(),
        }
    }
}

impl<'a> From<&'a JointStates<'static>> for RosJointState<'a> {
    fn from(joints: &'a JointStates<'static>) -> Self {
        let wide = |values: &[f32]| values.iter().copied().map(f64::from).collect();
        Self {
            // Joint states belong to no frame.
            header: RosHeader::new(joints.timestamp, ""),
            name: &joints.name,
            position: wide(&joints.position),
            velocity: wide(&joints.velocity),
            effort: wide(&joints.effort),
        }
    }
}

impl<'a> From<&'a StampedWrench<'static>> for WrenchStamped<'a> {
    fn from(wrench: &'a StampedWrench<'static>) -> Self {
        Self {
            header: RosHeader::new(wrench.timestamp, &wrench.frame_id),
            force: wrench.wrench.force.into(),
            torque: wrench.wrench.torque.into(),
        }
    }
}

impl<'a> From<&'a FrameTransforms<'static>> for TfMessage<'a> {
    fn from(frames: &'a FrameTransforms<'static>) -> Self {
        let one = |frame: &'a FrameTransform<'static>| {
            let (t, r) = (frame.translation, frame.rotation);
            TransformStamped {
                header: RosHeader::new(frame.timestamp, &frame.parent_frame_id),
                child_frame_id: &frame.child_frame_id,
                translation: RosVector3 { x: t.x, y: t.y, z: t.z },
                rotation: RosQuaternion {
                    x: r.x,
                    y: r.y,
                    z: r.z,
                    w: r.w,
                },
            }
        };
        Self {
            transforms: frames.transforms.iter().map(one).collect(),
        }
    }
}

/// A topic, and what was written to it.
struct WrittenTopic {
    name: &'static str,
    kind: &'static str,
    channel: u16,
    messages: u64,
}

/// Why the bag cannot be written.
#[derive(Debug, thiserror::Error)]
enum BagExportError {
    #[error(transparent)]
    File(#[from] mcap::McapError),
    #[error(transparent)]
    Message(#[from] cdr::Error),
}

/// The bag while it is written.
struct BagWriter {
    writer: Writer<BufWriter<File>>,
    topics: Vec<WrittenTopic>,
    begin_ns: Option<u64>,
    end_ns: u64,
    /// UTC at device time 0, in ns, of the last period that has both times.
    device_start_ns: Option<u64>,
}

impl BagWriter {
    fn new(file: File) -> Result<Self, BagExportError> {
        let mut writer = WriteOptions::new()
            .compression(Some(Compression::Lz4))
            .profile("ros2")
            .library(concat!("spherecal ", env!("CARGO_PKG_VERSION")))
            .create(BufWriter::new(file))?;
        let kinds = [
            ("/joint_states", "sensor_msgs/msg/JointState", JOINT_STATE),
            ("/wrench", "geometry_msgs/msg/WrenchStamped", WRENCH_STAMPED),
            ("/tf", "tf2_msgs/msg/TFMessage", TF_MESSAGE),
            ("/contact", "geometry_msgs/msg/PointStamped", POINT_STAMPED),
        ];
        let mut topics = Vec::new();
        for (name, kind, definition) in kinds {
            let schema = writer.add_schema(kind, "ros2msg", definition.as_bytes())?;
            topics.push(WrittenTopic {
                name,
                kind,
                channel: writer.add_channel(schema, name, "cdr", &BTreeMap::new())?,
                messages: 0,
            });
        }
        Ok(Self {
            writer,
            topics,
            begin_ns: None,
            end_ns: 0,
            device_start_ns: None,
        })
    }

    /// Writes one message of the topic with number `topic`.
    fn put(&mut self, topic: usize, time_ns: u64, message: &impl Serialize) -> Result<(), BagExportError> {
        let data = cdr::serialize::<_, _, CdrLe>(message, Infinite)?;
        let Some(topic) = self.topics.get_mut(topic) else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id: topic.channel,
            sequence: topic.messages as u32,
            log_time: time_ns,
            publish_time: time_ns,
        };
        topic.messages += 1;
        self.begin_ns = Some(self.begin_ns.map_or(time_ns, |begin| begin.min(time_ns)));
        self.end_ns = self.end_ns.max(time_ns);
        Ok(self.writer.write_to_known_channel(&header, &data)?)
    }

    fn period(&mut self, period: &Period) -> Result<(), BagExportError> {
        if let Some(joints) = &period.joint_states {
            self.put(0, period.utc_ns, &RosJointState::from(joints))?;
        }
        if let Some(wrench) = &period.wrench {
            self.put(1, period.utc_ns, &WrenchStamped::from(wrench))?;
        }
        if let Some(frames) = &period.frames {
            self.put(2, period.utc_ns, &TfMessage::from(frames))?;
        }
        if period.phase.is_some() {
            self.device_start_ns = Some(period.utc_ns.saturating_sub(period.device_ns()));
        }
        for recorded in &period.recorded {
            let Some(start_ns) = self.device_start_ns else { continue };
            let middle_us = recorded.start_us.midpoint(recorded.end_us);
            let stamp = Stamp::from_ns(start_ns.saturating_add(middle_us.saturating_mul(1000)));
            let frame = format!("sphere_{}", recorded.sphere);
            let message = PointStamped {
                header: RosHeader::new(stamp, &frame),
                point: RosVector3 { x: 0.0, y: 0.0, z: 0.0 },
            };
            self.put(3, period.utc_ns, &message)?;
        }
        Ok(())
    }

    /// What rosbag2 wants to know of the file before it opens it.
    fn metadata(&self) -> String {
        let begin = self.begin_ns.unwrap_or(0);
        let duration = self.end_ns.saturating_sub(begin);
        let count: u64 = self.topics.iter().map(|t| t.messages).sum();
        let topics: String = self
            .topics
            .iter()
            .map(|t| {
                format!(
                    "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
                     offered_qos_profiles: \"\"\n      message_count: {}\n",
                    t.name, t.kind, t.messages
                )
            })
            .collect();
        format!(
            "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  duration:\n    \
             nanoseconds: {duration}\n  starting_time:\n    nanoseconds_since_epoch: {begin}\n  \
             message_count: {count}\n  topics_with_message_count:\n{topics}  compression_format: \"\"\n  \
             compression_mode: \"\"\n  relative_file_paths:\n    - {FILE}\n  files:\n    - path: {FILE}\n      \
             starting_time:\n        nanoseconds_since_epoch: {begin}\n      duration:\n        \
             nanoseconds: {duration}\n      message_count: {count}\n"
        )
    }
}

/// Writes the telemetry in `files`, one file after the other, as a bag: the folder `folder`.
///
/// # Errors
/// When the telemetry cannot be read or has no sample, or when a file cannot be written.
pub fn export_ros2(files: &[PathBuf], folder: &Path) -> Result<Exported, ExportError> {
    let paths = [folder.join(FILE), folder.join("metadata.yaml")];
    let failed = |path: &Path, what: String| ExportError::Write {
        path: path.display().to_string(),
        what,
    };
    let in_bag = |what: String| failed(&paths[0], what);
    std::fs::create_dir_all(folder).map_err(|e| failed(folder, e.to_string()))?;
    let new = NewFile::create(&paths[0]).map_err(|e| in_bag(e.to_string()))?;
    let in_file = |error: BagExportError| in_bag(error.to_string());
    let mut bag = BagWriter::new(new.handle().map_err(|e| in_bag(e.to_string()))?).map_err(in_file)?;
    let mut torn_telemetry = Vec::new();
    for file in files {
        let unreadable = |what: String| ExportError::Telemetry {
            path: file.display().to_string(),
            what,
        };
        let bytes = std::fs::read(file).map_err(|e| unreadable(e.to_string()))?;
        let mut reader = TelemetryReader::new(&bytes).map_err(|e| unreadable(e.to_string()))?;
        for period in reader.by_ref() {
            let period = period.map_err(|e| unreadable(e.to_string()))?;
            bag.period(&period).map_err(in_file)?;
        }
        torn_telemetry.extend(reader.torn().map(|read| TornFile {
            file: file.clone(),
            read,
        }));
    }
    if bag.begin_ns.is_none() {
        return Err(ExportError::Telemetry {
            path: files
                .first()
                .map_or_else(String::new, |file| file.display().to_string()),
            what: "has no sample".to_owned(),
        });
    }
    bag.writer.finish().map_err(|e| in_bag(e.to_string()))?;
    new.finish().map_err(|e| in_bag(e.to_string()))?;
    let in_metadata = |e: std::io::Error| failed(&paths[1], e.to_string());
    let new = NewFile::create(&paths[1]).map_err(in_metadata)?;
    let mut handle = new.handle().map_err(in_metadata)?;
    handle.write_all(bag.metadata().as_bytes()).map_err(in_metadata)?;
    new.finish().map_err(in_metadata)?;
    Ok(Exported {
        files: paths.into(),
        torn_telemetry,
        ..Exported::default()
    })
}
