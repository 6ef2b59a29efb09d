//! The telemetry of a run as a ROS 2 bag: a folder with an MCAP file and its `metadata.yaml`, which
//! `ros2 bag play`, RViz and PlotJuggler open.
//!
//! Telemetry is made of messages of ROS 2. The bag has those of ROS's own types, as they are, from all pieces of the run:
//! `/joint_states`, `/wrench`, `/wrench_uncertainty`, `/tf`, `/contact`, `/robot_description` and `/log`. `ros2 bag play`
//! does not know the others, whose package is `spherecal_msgs`.
//!
//! `/contact` has the time of the middle of a recording, so that `spherecal identify --data` makes the poses of the run
//! from the bag.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::{BufWriter, Write as _};
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, McapError, WriteOptions, Writer};
use spherecal_campaign::telemetry::{TelemetryMessage, TelemetryMessages};
use spherecal_model::NewFile;

use super::{ExportError, Exported, TornFile};

/// Name of the file in the folder.
const FILE: &str = "ros2_0.mcap";
/// Begin of the types that are spherecal's own.
const OWN: &str = "spherecal_msgs/";

struct WrittenTopic {
    kind: String,
    channel: u16,
    messages: u64,
}

/// The bag while it is written.
struct BagWriter {
    writer: Writer<BufWriter<File>>,
    topics: BTreeMap<String, WrittenTopic>,
    begin_ns: Option<u64>,
    end_ns: u64,
}

impl BagWriter {
    fn new(file: File) -> Result<Self, McapError> {
        Ok(Self {
            writer: WriteOptions::new()
                .compression(Some(Compression::Zstd))
                .profile("ros2")
                .library(concat!("spherecal ", env!("CARGO_PKG_VERSION")))
                .create(BufWriter::new(file))?,
            topics: BTreeMap::new(),
            begin_ns: None,
            end_ns: 0,
        })
    }

    /// Writes a message, if its type is ROS's own.
    fn put(&mut self, message: &TelemetryMessage) -> Result<(), McapError> {
        let channel = &message.channel;
        let Some(schema) = channel.schema.as_ref().filter(|schema| !schema.name.starts_with(OWN)) else {
            return Ok(());
        };
        if !self.topics.contains_key(&channel.topic) {
            let id = self.writer.add_schema(&schema.name, &schema.encoding, &schema.data)?;
            let topic = WrittenTopic {
                kind: schema.name.clone(),
                channel: self.writer.add_channel(id, &channel.topic, "cdr", &BTreeMap::new())?,
                messages: 0,
            };
            self.topics.insert(channel.topic.clone(), topic);
        }
        let Some(topic) = self.topics.get_mut(&channel.topic) else {
            return Ok(());
        };
        let header = MessageHeader {
            channel_id: topic.channel,
            sequence: topic.messages as u32,
            log_time: message.utc_ns,
            publish_time: message.utc_ns,
        };
        topic.messages += 1;
        self.begin_ns = Some(self.begin_ns.unwrap_or(u64::MAX).min(message.utc_ns));
        self.end_ns = self.end_ns.max(message.utc_ns);
        self.writer.write_to_known_channel(&header, &message.data)
    }

    /// What rosbag2 wants to know of the file before it opens it.
    fn metadata(&self) -> String {
        let begin = self.begin_ns.unwrap_or(0);
        let duration = self.end_ns.saturating_sub(begin);
        let count: u64 = self.topics.values().map(|t| t.messages).sum();
        let topics: String = self
            .topics
            .iter()
            .map(|(name, t)| {
                format!(
                    "    - topic_metadata:\n        name: {}\n        type: {}\n        serialization_format: cdr\n        \
                     offered_qos_profiles: \"\"\n      message_count: {}\n",
                    name, t.kind, t.messages
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
    std::fs::create_dir_all(folder).map_err(ExportError::unwritten(folder))?;
    let new = NewFile::create(&paths[0]).map_err(ExportError::unwritten(&paths[0]))?;
    let in_file = ExportError::unwritten::<McapError>(&paths[0]);
    let mut bag = BagWriter::new(new.handle().map_err(ExportError::unwritten(&paths[0]))?).map_err(in_file)?;
    let mut torn_telemetry = Vec::new();
    for file in files {
        let unreadable = |what: String| ExportError::Telemetry {
            path: file.display().to_string(),
            what,
        };
        let bytes = std::fs::read(file).map_err(|e| unreadable(e.to_string()))?;
        let mut messages = TelemetryMessages::new(&bytes).map_err(|e| unreadable(e.to_string()))?;
        for message in messages.by_ref() {
            let message = message.map_err(|e| unreadable(e.to_string()))?;
            bag.put(&message).map_err(in_file)?;
        }
        torn_telemetry.extend(messages.torn().map(|read| TornFile {
            file: file.clone(),
            read,
        }));
    }
    if !bag.topics.contains_key("/joint_states") {
        return Err(ExportError::Telemetry {
            path: files
                .first()
                .map_or_else(String::new, |file| file.display().to_string()),
            what: "has no sample".to_owned(),
        });
    }
    bag.writer.finish().map_err(in_file)?;
    new.finish().map_err(ExportError::unwritten(&paths[0]))?;
    let in_metadata = ExportError::unwritten::<std::io::Error>(&paths[1]);
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
