//! Which telemetry files in a folder are of which run.
//!
//! A file is named by its run: `telemetry-run-3.mcap`. If the run is resumed, the further pieces are
//! `telemetry-run-3-2.mcap`, `telemetry-run-3-3.mcap`, ... Each file also holds the number of its run
//! and the time at which the run was created. So a file of an earlier database in the same folder is
//! not taken for the file of a run with the same number.

use std::collections::BTreeMap;
use std::fs::File;
use std::io::Read as _;
use std::path::{Path, PathBuf};

use mcap::McapError;
use mcap::records::op;
use mcap::sans_io::{LinearReadEvent, LinearReader, LinearReaderOptions};

use super::writer::PROFILE;

/// The run that telemetry belongs to.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct RunKey {
    /// Number of the run in its store.
    pub number: i64,
    /// Time at which the run was created (RFC 3339), as the store has it.
    pub created_utc: String,
}

/// Key of the run's number in a file's metadata.
const RUN: &str = "run";
/// Key of the time at which the run was created.
const CREATED: &str = "created_utc";
/// Where a file's metadata stand at the latest, in bytes.
const HEAD: u64 = 256 << 10;

impl RunKey {
    /// Adds the run to what a file says about itself.
    pub(super) fn describe(&self, about: &mut BTreeMap<String, String>) {
        about.insert(RUN.to_owned(), self.number.to_string());
        about.insert(CREATED.to_owned(), self.created_utc.clone());
    }

    /// Whether metadata are those of a file of this run. A file that names no run is believed by its
    /// own name.
    fn wrote(&self, about: &BTreeMap<String, String>) -> bool {
        about.get(RUN).is_none_or(|run| *run == self.number.to_string())
            && about.get(CREATED).is_none_or(|created| *created == self.created_utc)
    }
}

/// The name of a piece of a run's telemetry; pieces count from 1.
fn name(run: i64, piece: u32) -> String {
    match piece {
        0 | 1 => format!("telemetry-run-{run}.mcap"),
        more => format!("telemetry-run-{run}-{more}.mcap"),
    }
}

/// The number of a piece: 1 for `STEM.mcap`, K for `STEM-K.mcap`.
fn piece(file: &str, stem: &str) -> Option<u32> {
    let rest = file.strip_suffix(".mcap")?.strip_prefix(stem)?;
    if rest.is_empty() {
        return Some(1);
    }
    rest.strip_prefix('-')?.parse().ok().filter(|k| *k > 1)
}

/// The files of a folder that are pieces of `stem`, in order.
fn pieces(folder: &Path, stem: &str) -> Vec<PathBuf> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let mut found: Vec<(u32, PathBuf)> = entries
        .filter_map(|entry| Some((piece(entry.file_name().to_str()?, stem)?, entry.path())))
        .filter(|(_, path)| path.is_file())
        .collect();
    found.sort();
    found.into_iter().map(|(_, path)| path).collect()
}

/// The first name of a run's telemetry that is free in `folder`.
pub(super) fn free_name(folder: &Path, run: i64) -> PathBuf {
    let last = pieces(folder, &format!("telemetry-run-{run}")).pop();
    let last = last.as_deref().and_then(Path::file_name).and_then(|n| n.to_str());
    let next = last
        .and_then(|file| piece(file, &format!("telemetry-run-{run}")))
        .map_or(1, |k| k.saturating_add(1));
    folder.join(name(run, next))
}

/// The telemetry files of a run in `folder`, in the order in which they were written. A file that
/// another run wrote under this run's number, or another program, is left out, as is a file that was killed before its
/// first sample.
pub fn files_of_run(folder: &Path, run: &RunKey) -> Vec<PathBuf> {
    let mut files = pieces(folder, &format!("telemetry-run-{}", run.number));
    files.retain(|path| match about(path) {
        Ok(Some(about)) => about.profile == PROFILE && run.wrote(&about.metadata),
        Ok(None) => false,
        // Whoever reads it says what is wrong with it.
        Err(_) => true,
    });
    files
}

/// What a file says about itself.
#[derive(Default)]
struct About {
    profile: String,
    metadata: BTreeMap<String, String>,
}

/// What a file says about itself. `None` if it ends before that.
fn about(path: &Path) -> Result<Option<About>, McapError> {
    let mut head = Vec::new();
    File::open(path)?.take(HEAD).read_to_end(&mut head)?;
    let options = LinearReaderOptions::default()
        .with_record_length_limit(head.len())
        .with_emit_chunks(true);
    let mut reader = LinearReader::new_with_options(options);
    let mut rest = head.as_slice();
    let mut about = About::default();
    while let Some(event) = reader.next_event() {
        match event {
            Ok(LinearReadEvent::ReadRequest(wanted)) => {
                let (now, later) = rest.split_at(wanted.min(rest.len()));
                reader.insert(now.len()).copy_from_slice(now);
                reader.notify_read(now.len());
                rest = later;
            }
            Ok(LinearReadEvent::Record { mut data, opcode }) if opcode == op::HEADER => {
                about.profile = text(&mut data).unwrap_or_default();
            }
            Ok(LinearReadEvent::Record { data, opcode }) if opcode == op::METADATA => {
                about.metadata = pairs(data).unwrap_or_default();
                return Ok(Some(about));
            }
            Ok(LinearReadEvent::Record { .. }) => {}
            Err(McapError::UnexpectedEof) => return Ok(None),
            Err(error) => return Err(error),
        }
    }
    Ok(Some(about))
}

/// The bytes of a record's next field, which begins with their number. Lengths are checked here, because the file may be
/// damaged.
fn bytes<'a>(from: &mut &'a [u8]) -> Option<&'a [u8]> {
    let (length, rest) = from.split_first_chunk::<4>()?;
    let (field, rest) = rest.split_at_checked(u32::from_le_bytes(*length) as usize)?;
    *from = rest;
    Some(field)
}

/// A record's next field, as text.
fn text(from: &mut &[u8]) -> Option<String> {
    bytes(from).map(|t| String::from_utf8_lossy(t).into_owned())
}

/// The pairs of a metadata record: a name, then a map of texts.
fn pairs(mut record: &[u8]) -> Option<BTreeMap<String, String>> {
    let _name = bytes(&mut record)?;
    let mut map = bytes(&mut record)?;
    let mut pairs = BTreeMap::new();
    while !map.is_empty() {
        let key = text(&mut map)?;
        pairs.insert(key, text(&mut map)?);
    }
    Some(pairs)
}

#[cfg(test)]
mod tests {
    use super::super::{DrawnArm, TelemetryWriter};
    use super::*;
    use mcap::WriteOptions;

    fn arm() -> DrawnArm {
        let model = spherecal_model::robots::built_in("iiwa7").expect("built in");
        DrawnArm::new(&model, &model.tool)
    }

    fn key(number: i64, created: &str) -> RunKey {
        RunKey {
            number,
            created_utc: created.to_owned(),
        }
    }

    /// Writes an empty file for a run under the next free name.
    fn write(folder: &Path, run: &RunKey) -> PathBuf {
        let path = free_name(folder, run.number);
        let mut about = BTreeMap::new();
        run.describe(&mut about);
        let file = File::create(&path).expect("made");
        let writer = TelemetryWriter::new(std::io::BufWriter::new(file), arm(), &about, 0).expect("a writer");
        writer.finish().expect("closed");
        path
    }

    // Fails if a run gets a file of another run, of another database with the same number, of run 10
    // for run 1, or loses a piece; if a piece replaces another; or if a file of another program is taken for one of a run.
    #[test]
    fn each_run_has_its_own_files() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let (one, two, ten) = (key(1, "a"), key(2, "b"), key(10, "c"));
        let old = write(folder, &key(1, "an earlier database"));
        let first: Vec<PathBuf> = (0..11).map(|_| write(folder, &one)).collect();
        let second = write(folder, &two);
        let tenth = write(folder, &ten);
        for name in [
            "telemetry.mcap",
            "telemetry-2.mcap",
            "telemetry-x.mcap",
            "telemetry-run-1-0.mcap",
        ] {
            std::fs::copy(&old, folder.join(name)).expect("copied");
        }
        assert!(first[0].ends_with("telemetry-run-1-2.mcap") && first[10].ends_with("telemetry-run-1-12.mcap"));
        assert_eq!(files_of_run(folder, &one), first);
        assert_eq!(files_of_run(folder, &two), [second]);
        assert_eq!(files_of_run(folder, &ten), [tenth]);
        assert!(files_of_run(folder, &key(3, "d")).is_empty());
        // A file of another program.
        let path = free_name(folder, 10);
        let mut writer = WriteOptions::new()
            .profile("")
            .create(File::create(&path).expect("made"));
        writer.as_mut().expect("a writer").finish().expect("closed");
        assert_eq!(files_of_run(folder, &ten), [folder.join("telemetry-run-10.mcap")]);
    }

    // Fails if a file that ends before its first sample counts, if one that names no run is refused,
    // or if a damaged one is passed over in silence.
    #[test]
    fn files_that_say_nothing() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let run = key(1, "a");
        let path = write(folder, &run);
        let whole = std::fs::read(&path).expect("read");
        for cut in [0, 5, 40] {
            std::fs::write(&path, &whole[..cut]).expect("written");
            assert!(files_of_run(folder, &run).is_empty(), "{cut} bytes");
        }
        std::fs::write(&path, b"no telemetry at all").expect("written");
        assert_eq!(files_of_run(folder, &run), std::slice::from_ref(&path));
        let file = File::create(&path).expect("made");
        let writer = TelemetryWriter::new(file, arm(), &BTreeMap::new(), 0).expect("a writer");
        writer.finish().expect("closed");
        assert_eq!(files_of_run(folder, &run), [path]);
        // Damaged lengths are no panic.
        assert_eq!(pairs(&[255, 255, 255, 255, 1]), None);
        assert_eq!(pairs(&[0, 0, 0, 0, 9, 0, 0, 0, 1]), None);
    }
}
