//! Bags for tests, written message by message.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};

use mcap::records::MessageHeader;
use mcap::{Compression, WriteOptions, Writer};

/// A message in CDR, little endian.
pub(crate) struct CdrMessage(Vec<u8>);

impl CdrMessage {
    pub(crate) fn new() -> Self {
        Self(vec![0, 1, 0, 0])
    }

    fn align(&mut self, to: usize) {
        while !(self.0.len() - 4).is_multiple_of(to) {
            self.0.push(0);
        }
    }

    pub(crate) fn u32(mut self, value: u32) -> Self {
        self.align(4);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(crate) fn f64(mut self, value: f64) -> Self {
        self.align(8);
        self.0.extend(value.to_le_bytes());
        self
    }

    pub(crate) fn text(self, text: &str) -> Self {
        let mut own = self.u32(text.len() as u32 + 1);
        own.0.extend(text.as_bytes());
        own.0.push(0);
        own
    }

    pub(crate) fn f64s(self, values: &[f64]) -> Self {
        values
            .iter()
            .fold(self.u32(values.len() as u32), |own, value| own.f64(*value))
    }

    pub(crate) fn header(self, time_ns: u64, frame: &str) -> Self {
        let (seconds, rest) = (time_ns / 1_000_000_000, time_ns % 1_000_000_000);
        self.u32(seconds as u32).u32(rest as u32).text(frame)
    }

    pub(crate) fn bytes(self) -> Vec<u8> {
        self.0
    }
}

pub(crate) fn joint_state(time_ns: u64, names: &[&str], position: &[f64], effort: &[f64]) -> Vec<u8> {
    let named = CdrMessage::new().header(time_ns, "").u32(names.len() as u32);
    let named = names.iter().fold(named, |own, name| own.text(name));
    named.f64s(position).f64s(&[]).f64s(effort).bytes()
}

pub(crate) fn point(time_ns: u64, frame: &str, at: [f64; 3]) -> Vec<u8> {
    at.iter()
        .fold(CdrMessage::new().header(time_ns, frame), |own, x| own.f64(*x))
        .bytes()
}

/// A bag while it is written.
pub(crate) struct TestBag {
    writer: Writer<std::io::BufWriter<std::fs::File>>,
    channels: BTreeMap<String, u16>,
    path: PathBuf,
}

impl TestBag {
    pub(crate) fn new(folder: &Path) -> Self {
        Self::compressed(folder, Some(Compression::Lz4))
    }

    pub(crate) fn compressed(folder: &Path, compression: Option<Compression>) -> Self {
        Self::with(folder, WriteOptions::new().compression(compression))
    }

    /// Plain chunks of so many bytes.
    pub(crate) fn in_chunks(folder: &Path, bytes: u64) -> Self {
        Self::with(folder, WriteOptions::new().compression(None).chunk_size(Some(bytes)))
    }

    fn with(folder: &Path, options: WriteOptions) -> Self {
        let path = folder.join("bag.mcap");
        let writer = options
            .profile("ros2")
            .create(std::io::BufWriter::new(std::fs::File::create(&path).unwrap()))
            .unwrap();
        Self {
            writer,
            channels: BTreeMap::new(),
            path,
        }
    }

    pub(crate) fn put(&mut self, topic: &str, kind: &str, encoding: &str, time_ns: u64, data: &[u8]) {
        let writer = &mut self.writer;
        let channel_id = *self.channels.entry(topic.to_owned()).or_insert_with(|| {
            let schema = writer.add_schema(kind, "ros2msg", b"").unwrap();
            writer.add_channel(schema, topic, encoding, &BTreeMap::new()).unwrap()
        });
        let header = MessageHeader {
            channel_id,
            sequence: 0,
            log_time: time_ns,
            publish_time: time_ns,
        };
        self.writer.write_to_known_channel(&header, data).unwrap();
    }

    pub(crate) fn finish(mut self) -> PathBuf {
        self.writer.finish().unwrap();
        self.path
    }
}

/// Changes a bag in SQLite.
pub(crate) fn execute(db3: &Path, statements: &[&'static str]) {
    use sqlx::ConnectOptions as _;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new().filename(db3);
    let mut connection = runtime.block_on(options.connect()).unwrap();
    for statement in statements {
        runtime
            .block_on(sqlx::query(*statement).execute(&mut connection))
            .unwrap();
    }
    runtime.block_on(sqlx::Connection::close(connection)).unwrap();
}

/// Writes the messages of an MCAP file as rosbag2 writes them in SQLite.
pub(crate) fn to_sqlite(mcap: &Path, db3: &Path) {
    use sqlx::ConnectOptions as _;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .unwrap();
    let options = sqlx::sqlite::SqliteConnectOptions::new()
        .filename(db3)
        .create_if_missing(true);
    let mut connection = runtime.block_on(options.connect()).unwrap();
    for statement in [
        "CREATE TABLE topics(id INTEGER PRIMARY KEY, name TEXT NOT NULL, type TEXT NOT NULL, serialization_format TEXT NOT NULL, \
         offered_qos_profiles TEXT NOT NULL)",
        "CREATE TABLE messages(id INTEGER PRIMARY KEY, topic_id INTEGER NOT NULL, timestamp INTEGER NOT NULL, data BLOB NOT NULL)",
        "CREATE INDEX timestamp_idx ON messages (timestamp ASC)",
        "BEGIN",
    ] {
        runtime
            .block_on(sqlx::query(statement).execute(&mut connection))
            .unwrap();
    }
    let mut topics: Vec<String> = Vec::new();
    super::records::each_message(mcap, &mut |_| {}, &mut |message| {
        let topic = message.topic;
        let known = topics.iter().position(|name| *name == topic.name);
        let id = known.unwrap_or(topics.len()) as i64 + 1;
        if known.is_none() {
            topics.push(topic.name.clone());
            let insert = sqlx::query("INSERT INTO topics VALUES (?, ?, ?, ?, '')")
                .bind(id)
                .bind(&topic.name)
                .bind(&topic.kind)
                .bind(&topic.encoding);
            runtime.block_on(insert.execute(&mut connection)).unwrap();
        }
        let insert = sqlx::query("INSERT INTO messages (topic_id, timestamp, data) VALUES (?, ?, ?)")
            .bind(id)
            .bind(message.time_ns)
            .bind(message.data);
        runtime.block_on(insert.execute(&mut connection)).unwrap();
        Ok(())
    })
    .unwrap();
    runtime
        .block_on(sqlx::query("COMMIT").execute(&mut connection))
        .unwrap();
    runtime.block_on(sqlx::Connection::close(connection)).unwrap();
}
