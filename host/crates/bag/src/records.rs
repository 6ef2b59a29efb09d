//! The messages of MCAP files, as a stream in bounded memory.

use std::collections::HashMap;
use std::io::{BufReader, Read};
use std::path::Path;
use std::rc::Rc;

use mcap::records::{Record, op};
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};
use mcap::{McapError, McapResult};
use spherecal_model::{FileError, open_regular};

use super::error::BagError;
use super::files::{LARGER, is_sqlite};
use super::sqlite;
use super::topics::{BagMessage, Topic, full_name};
use spherecal_budget::files::{BAG_BYTES, NAME_BYTES, RECORD_BYTES, UNPACKED};

/// Bytes that are read at once.
const PIECE: usize = 1 << 20;
/// Bytes between two reports of progress.
const REPORTED: u64 = 16 << 20;

/// Why the reading of a file ended early.
enum EarlyEnd {
    Mcap(McapError),
    Name(&'static str),
    System(std::io::Error),
    Caller(BagError),
}

impl From<McapError> for EarlyEnd {
    fn from(error: McapError) -> Self {
        Self::Mcap(error)
    }
}

/// Calls `each` for every message of a file, in the file's order, and `progress` with the bytes read so far. A file that
/// ends early gives the messages that are whole; then returns so in words.
/// Errors: a file that cannot be read or is damaged, and what `each` refuses.
pub(crate) fn each_message(
    path: &Path,
    progress: &mut dyn FnMut(u64),
    each: &mut dyn FnMut(&BagMessage<'_>) -> Result<(), BagError>,
) -> Result<Option<String>, BagError> {
    if is_sqlite(path) {
        return sqlite::each_message(path, progress, each).map(|()| None);
    }
    let (file, _) = open_regular(path, BAG_BYTES, LARGER)?;
    let source = BufReader::with_capacity(PIECE, file.take(BAG_BYTES));
    let damaged = |what: String| BagError::Damaged {
        path: path.display().to_string(),
        what,
    };
    let mut whole = 0_u64;
    let mut count = |message: &BagMessage<'_>| {
        whole += 1;
        each(message)
    };
    let ended = match read(source, progress, &mut count) {
        Ok(()) => return Ok(None),
        Err(EarlyEnd::Mcap(McapError::UnexpectedEof)) if whole > 0 => {
            return Ok(Some(format!(
                "{} ends early, as a killed recorder leaves it: its {whole} whole messages were read",
                spherecal_model::printable(&path.display().to_string())
            )));
        }
        Err(ended) => ended,
    };
    Err(match ended {
        EarlyEnd::Caller(error) => error,
        EarlyEnd::System(source) => BagError::File(FileError::Read {
            path: path.display().to_string(),
            source,
        }),
        EarlyEnd::Name(what) => damaged(what.to_owned()),
        EarlyEnd::Mcap(McapError::UnexpectedEof) => damaged("it ends early".to_owned()),
        EarlyEnd::Mcap(McapError::RecordTooLarge { opcode, len }) => damaged(format!(
            "a record of kind {opcode} has {len} bytes, and at most {RECORD_BYTES} are read"
        )),
        EarlyEnd::Mcap(error) => damaged(spherecal_model::printable(&error.to_string()).into_owned()),
    })
}

fn read(
    mut source: impl Read,
    progress: &mut dyn FnMut(u64),
    each: &mut dyn FnMut(&BagMessage<'_>) -> Result<(), BagError>,
) -> Result<(), EarlyEnd> {
    let options = LinearReaderOptions::default()
        .with_record_length_limit(RECORD_BYTES)
        .with_validate_chunk_crcs(true);
    let mut records = LinearReader::new_with_options(options);
    let mut types: HashMap<u16, String> = HashMap::new();
    let mut topics: HashMap<u16, Rc<Topic>> = HashMap::new();
    let (mut bytes, mut reported, mut unpacked) = (0, 0, 0);
    while let Some(event) = records.next_event() {
        let (opcode, data) = match event? {
            LinearReadEvent::ReadRequest(wanted) => {
                let count = some(&mut source, records.insert(wanted.min(RECORD_BYTES))).map_err(EarlyEnd::System)?;
                records.notify_read(count);
                bytes += count as u64;
                if bytes - reported >= REPORTED {
                    reported = bytes;
                    progress(bytes);
                }
                continue;
            }
            LinearReadEvent::Record { data, opcode } => (opcode, data),
        };
        unpacked += data.len() as u64;
        if unpacked > RECORD_BYTES as u64 + UNPACKED * bytes {
            return Err(EarlyEnd::Name(
                "its chunks unpack to more than 200 times their size, as no recording of a robot does",
            ));
        }
        // Other records are not needed, and some of them are parsed without a check of their length.
        if !matches!(opcode, op::SCHEMA | op::CHANNEL | op::MESSAGE) {
            continue;
        }
        match parse(opcode, data)? {
            Record::Schema { header, .. } => {
                named(&header.name)?;
                types.insert(header.id, full_name(&header.name));
            }
            Record::Channel(channel) => {
                named(&channel.topic)?;
                named(&channel.message_encoding)?;
                let topic = Topic {
                    name: channel.topic,
                    kind: types.get(&channel.schema_id).cloned().unwrap_or_default(),
                    encoding: channel.message_encoding,
                };
                topics.insert(channel.id, Rc::new(topic));
            }
            Record::Message { header, data } => {
                let topic = topics
                    .get(&header.channel_id)
                    .ok_or(EarlyEnd::Name("a message is of a topic that the file does not name"))?;
                each(&BagMessage {
                    topic,
                    time_ns: i64::try_from(header.log_time).unwrap_or(i64::MAX),
                    data: &data,
                })
                .map_err(EarlyEnd::Caller)?;
            }
            _ => {}
        }
    }
    progress(bytes);
    Ok(())
}

fn parse(opcode: u8, data: &[u8]) -> McapResult<Record<'_>> {
    mcap::parse_record(opcode, data)
}

fn named(name: &str) -> Result<(), EarlyEnd> {
    if name.len() > NAME_BYTES {
        return Err(EarlyEnd::Name(
            "the name of a topic or of its type has more than 1024 bytes",
        ));
    }
    Ok(())
}

/// Reads at least one byte, unless the source has ended.
fn some(source: &mut impl Read, into: &mut [u8]) -> std::io::Result<usize> {
    loop {
        match source.read(into) {
            Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
            found => return found,
        }
    }
}
