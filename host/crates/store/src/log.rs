//! Frames of SQLite's write-ahead log.
//!
//! ```text
//!   header │ frame │ frame │ frame (commit) │ frame ▒▒▒▒ damaged │ frame │ frame (commit)
//!          └────── SQLite reads these ──────┘                    └─ sound, and not read ─┘
//! ```
//!
//! SQLite reads a log up to the first frame whose checksum is wrong, and a program that opens the file then
//! overwrites the rest. The checksum of a frame continues that of the frame before it, which is stored there. So
//! the frames behind a damaged one can be checked, too.

use std::path::{Path, PathBuf};

use super::StoreError;
use super::acknowledged::statement_of;

/// Sizes of the header of the log and of a frame, in bytes (SQLite's file format, section 4.1).
const HEADER: usize = 32;
const FRAME: usize = 24;
/// The first four bytes of a log whose checksums read words in the little-endian order. One more: in the other.
const MAGIC: u32 = 0x377f_0682;
/// The size of a page of this program's databases, in bytes: SQLite's default.
const PAGE: usize = 4096;

/// The log of a database. That of a link is beside the file that it leads to.
pub(super) fn log_of(database: &Path) -> PathBuf {
    let mut name = std::fs::canonicalize(database)
        .unwrap_or_else(|_| database.to_owned())
        .into_os_string();
    name.push("-wal");
    name.into()
}

/// One frame: a page as a transaction wrote it.
#[derive(Clone, Copy, Debug)]
struct Frame {
    /// Number of the page, from 1.
    page: usize,
    /// Pages of the database after this frame, if it ends a transaction; else 0.
    pages: usize,
    /// Where the page's bytes begin in the log.
    at: usize,
    /// Whether it is as it was written.
    sound: bool,
    /// Whether SQLite accepts it, after all frames before it.
    read: bool,
}

pub(super) struct Log {
    bytes: Vec<u8>,
    page: usize,
    frames: Vec<Frame>,
}

/// The two sums of a checksum.
type Sums = [u32; 2];

/// Continues a checksum over some bytes; their number is a multiple of eight.
fn summed(mut sums: Sums, bytes: &[u8], little: bool) -> Sums {
    let (words, _) = bytes.as_chunks::<4>();
    for pair in words.chunks_exact(2) {
        let [a, b] = [pair[0], pair[1]].map(|word| {
            if little {
                u32::from_le_bytes(word)
            } else {
                u32::from_be_bytes(word)
            }
        });
        sums[0] = sums[0].wrapping_add(a).wrapping_add(sums[1]);
        sums[1] = sums[1].wrapping_add(b).wrapping_add(sums[0]);
    }
    sums
}

fn word(bytes: &[u8], at: usize) -> u32 {
    let word = bytes.get(at..at + 4).and_then(|word| word.try_into().ok());
    word.map_or(0, u32::from_be_bytes)
}

impl Log {
    /// The log of these bytes; `None` if they hold no frame.
    fn new(bytes: Vec<u8>) -> Option<Self> {
        // A damaged header may name the wrong order.
        let frames = [true, false].map(|little| frames_of(&bytes, little));
        let sound = |frames: &[Frame]| frames.iter().filter(|frame| frame.sound).count();
        let [(page, frames), (other, others)] = frames;
        let (page, frames) = if sound(&others) > sound(&frames) {
            (other, others)
        } else {
            (page, frames)
        };
        (!frames.is_empty()).then_some(Self { bytes, page, frames })
    }

    /// The log at a path; `None` if there is none, or if it holds no frame.
    pub(super) fn read(path: &Path) -> std::io::Result<Option<Self>> {
        match std::fs::read(path) {
            Ok(bytes) => Ok(Self::new(bytes)),
            Err(error) if error.kind() == std::io::ErrorKind::NotFound => Ok(None),
            Err(error) => Err(error),
        }
    }

    /// Sound frames that SQLite does not read, because one before them is damaged. Frames behind the last
    /// end of a transaction do not count.
    fn behind(&self) -> impl Iterator<Item = &Frame> {
        let damaged = self.frames.iter().position(|frame| !frame.read);
        let last = self.frames.iter().rposition(|frame| frame.sound && frame.pages > 0);
        let range = damaged.unwrap_or(usize::MAX)..last.map_or(0, |last| last + 1);
        self.frames.get(range).unwrap_or_default().iter().filter(|f| f.sound)
    }

    /// How many sound frames stand behind a damaged one.
    pub(super) fn salvageable(&self) -> usize {
        self.behind().count()
    }

    /// Whether a transaction was finished behind the one that is damaged.
    fn has_later_transaction(&self) -> bool {
        self.behind().filter(|frame| frame.pages > 0).count() > 1
    }

    /// Writes every sound frame up to the last end of a transaction into the bytes of the database.
    pub(super) fn apply(&self, database: &mut Vec<u8>) {
        let Some(last) = self.frames.iter().rposition(|frame| frame.sound && frame.pages > 0) else {
            return;
        };
        // No larger than the file and the log together: the number of pages is read from the log.
        let most = database.len() + self.bytes.len();
        let kept = self.frames.iter().take(last + 1).filter(|frame| frame.sound);
        for frame in kept {
            let Some(place) = frame.page.checked_sub(1).map(|number| number * self.page) else {
                continue;
            };
            if place + self.page > most {
                continue;
            }
            if database.len() < place + self.page {
                database.resize(place + self.page, 0);
            }
            let source = self.bytes.get(frame.at..frame.at + self.page);
            if let (Some(to), Some(from)) = (database.get_mut(place..place + self.page), source) {
                to.copy_from_slice(from);
            }
        }
    }
}

/// The size of a page, and the frames of a log whose checksums read words in this order.
fn frames_of(bytes: &[u8], little: bool) -> (usize, Vec<Frame>) {
    let header = bytes.get(..HEADER).unwrap_or_default();
    let stored = |bytes: &[u8], at: usize| [word(bytes, at), word(bytes, at + 4)];
    let computed = summed([0, 0], header.get(..24).unwrap_or_default(), little);
    let sound = word(header, 0) == MAGIC + u32::from(!little) && stored(header, 24) == computed;
    let page = match word(header, 8) as usize {
        size if sound && size.is_power_of_two() && (512..=65_536).contains(&size) => size,
        _ => PAGE,
    };
    let all = bytes.get(HEADER..).unwrap_or_default();
    // A damaged header does not state the log's salts; the first frame does.
    let salts = if sound { stored(header, 16) } else { stored(all, 8) };
    // What the next frame's checksum may continue: the stored sum of the frame before, or the computed one.
    let mut before = [stored(header, 24), computed];
    let (mut frames, mut read, mut sound_before) = (Vec::new(), sound, sound);
    for (number, frame) in all.chunks_exact(FRAME + page).enumerate() {
        let (head, data) = frame.split_at(FRAME);
        let own = stored(head, 16);
        let sums = before.map(|sums| summed(summed(sums, &head[..8], little), data, little));
        let same = stored(head, 8) == salts;
        // Frames of an earlier use of the log continue each other, but no frame of this use.
        let good = sums.contains(&own) && (same || sound_before);
        read &= good && same && own == sums[1];
        frames.push(Frame {
            page: word(head, 0) as usize,
            pages: word(head, 4) as usize,
            at: HEADER + number * (FRAME + page) + FRAME,
            sound: good,
            read,
        });
        before = [own, if good { own } else { sums[1] }];
        sound_before = good;
    }
    (page, frames)
}

/// Refuses a database whose log has sound frames behind a damaged one, before a program that opens it
/// overwrites them.
///
/// A power cut may tear the last transaction, of which nothing was acknowledged. Such a log is accepted.
pub(super) fn refuse_damaged(database: &Path) -> Result<(), StoreError> {
    let path = log_of(database);
    let io = StoreError::io(&path);
    let mut earlier: Option<Vec<u8>> = None;
    // Another program may be writing while the log is read. Damage stays.
    loop {
        let Some(log) = Log::read(&path).map_err(io)? else {
            return Ok(());
        };
        let frames = log.salvageable();
        let acknowledged = frames > 0 && statement_of(database).exists();
        if !acknowledged && !log.has_later_transaction() {
            return Ok(());
        }
        if earlier.is_some_and(|earlier| earlier == log.bytes) {
            return Err(StoreError::Damaged {
                path: database.to_owned(),
                what: format!(
                    "a frame of its log {} is damaged, and {frames} sound ones follow",
                    path.display()
                ),
            });
        }
        earlier = Some(log.bytes);
        std::thread::sleep(std::time::Duration::from_millis(50));
    }
}
