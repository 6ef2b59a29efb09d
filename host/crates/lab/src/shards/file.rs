//! The file of a shard: JSON lines. The first line is the header, each other line one outcome with
//! its CRC-32.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions, TryLockError};
use std::io::{BufRead as _, BufReader, Seek as _, SeekFrom, Write as _};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, PoisonError};

use serde::{Deserialize, Serialize};
use serde_json::Value;

use super::{Shard, ShardError, ShardedStudy};

/// First line of a file.
#[derive(Serialize, Deserialize)]
struct ShardHeader<S> {
    study: String,
    /// Program and version: other versions may give other numbers.
    program: String,
    /// Processor and system: other mathematical libraries may give other numbers.
    machine: String,
    /// Number of shards.
    shards: u64,
    /// Items of all shards.
    items: u64,
    options: S,
    /// Number of this shard, from 1.
    shard: u64,
}

impl<S: ShardedStudy> ShardHeader<&S> {
    fn of(study: &S, shard: Shard) -> ShardHeader<&S> {
        ShardHeader {
            study: S::NAME.to_owned(),
            program: concat!("spherecal ", env!("CARGO_PKG_VERSION")).to_owned(),
            machine: format!("{}-{}", std::env::consts::ARCH, std::env::consts::OS),
            shards: shard.numbers().1,
            items: study.items(),
            options: study,
            shard: shard.numbers().0,
        }
    }
}

/// Any other line of a file.
#[derive(Serialize, Deserialize)]
struct OutcomeLine<T> {
    item: u64,
    /// Of the number and the outcome's text.
    crc32: u32,
    outcome: T,
}

/// The text of an outcome, and the CRC-32 of its number and text.
fn encoded<T: Serialize>(item: u64, outcome: &T) -> Option<(String, u32)> {
    let text = serde_json::to_string(outcome).ok()?;
    let crc = crc32fast::hash(format!("{item} {text}").as_bytes());
    Some((text, crc))
}

/// Reads a line. `None` if it is not as it was written.
fn decoded<S: ShardedStudy>(line: &[u8]) -> Option<(u64, S::Outcome)> {
    let line: OutcomeLine<S::Outcome> = serde_json::from_slice(line).ok()?;
    let (_, crc) = encoded(line.item, &line.outcome)?;
    (crc == line.crc32).then_some((line.item, line.outcome))
}

/// The file of one shard, open for this process alone.
pub struct ShardFile {
    path: PathBuf,
    file: Mutex<File>,
}

fn name_of<S: ShardedStudy>(shard: Shard) -> String {
    let (number, of) = shard.numbers();
    format!("{}-shard-{number}-of-{of}.jsonl", S::NAME)
}

/// The shard whose file has this name.
fn shard_of<S: ShardedStudy>(name: &str) -> Option<Shard> {
    let numbers = name
        .strip_prefix(S::NAME)?
        .strip_prefix("-shard-")?
        .strip_suffix(".jsonl")?;
    let (number, of) = numbers.split_once("-of-")?;
    Shard::new(number.parse().ok()?, of.parse().ok()?)
}

impl ShardFile {
    /// Opens or creates the file of a shard in `folder`. Returns the items that it holds. A last line
    /// that was not written to its end is removed.
    ///
    /// # Errors
    /// See [`ShardError`].
    pub(super) fn open<S: ShardedStudy>(
        study: &S,
        shard: Shard,
        folder: &Path,
    ) -> Result<(Self, BTreeSet<u64>), ShardError> {
        std::fs::create_dir_all(folder).map_err(|e| failed(folder, &e))?;
        let path = folder.join(name_of::<S>(shard));
        let mut file = OpenOptions::new()
            .read(true)
            .write(true)
            .create(true)
            .truncate(false)
            .open(&path)
            .map_err(|e| failed(&path, &e))?;
        match file.try_lock() {
            Ok(()) => {}
            Err(TryLockError::WouldBlock) => return Err(ShardError::Busy { path }),
            Err(TryLockError::Error(error)) => return Err(failed(&path, &error)),
        }
        let wanted = serde_json::to_value(ShardHeader::of(study, shard)).map_err(|e| failed(&path, &e))?;
        let read = read::<S>(&path, &file)?;
        let mut done = BTreeSet::new();
        if let Some(header) = &read.header {
            compare(&path, header, &wanted, &[])?;
            done.extend(read.outcomes.iter().map(|(item, _)| *item));
            check_items(&path, &read, &shard.range(study.items()))?;
        }
        file.set_len(read.whole).map_err(|e| failed(&path, &e))?;
        file.seek(SeekFrom::Start(read.whole)).map_err(|e| failed(&path, &e))?;
        if read.header.is_none() {
            file.write_all(format!("{wanted}\n").as_bytes())
                .map_err(|e| failed(&path, &e))?;
        }
        let file = Mutex::new(file);
        Ok((Self { path, file }, done))
    }

    /// Where it is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Appends an outcome. A process that ends after this call does not lose it.
    pub(super) fn append<S: ShardedStudy>(&self, item: u64, outcome: &S::Outcome) -> Result<(), ShardError> {
        let not_finite = ShardError::NotFinite { study: S::NAME, item };
        let Some((text, crc32)) = encoded(item, outcome) else {
            return Err(not_finite);
        };
        let line = format!("{{\"item\":{item},\"crc32\":{crc32},\"outcome\":{text}}}\n");
        // JSON has no NaN: what is read back must be what was written.
        if decoded::<S>(line.as_bytes()).is_none() {
            return Err(not_finite);
        }
        let mut file = self.file.lock().unwrap_or_else(PoisonError::into_inner);
        file.write_all(line.as_bytes()).map_err(|e| failed(&self.path, &e))
    }
}

fn failed(path: &Path, error: &impl std::fmt::Display) -> ShardError {
    ShardError::File {
        path: path.to_owned(),
        what: error.to_string(),
    }
}

/// What a file holds.
struct Contents<T> {
    /// `None` for an empty file, or one whose first line was not written to its end.
    header: Option<Value>,
    outcomes: Vec<(u64, T)>,
    /// Bytes up to the end of the last whole line.
    whole: u64,
}

fn read<S: ShardedStudy>(path: &Path, file: &File) -> Result<Contents<S::Outcome>, ShardError> {
    let mut contents = Contents {
        header: None,
        outcomes: Vec::new(),
        whole: 0,
    };
    let mut reader = BufReader::new(file);
    let mut line = Vec::new();
    for number in 1.. {
        line.clear();
        let length = reader.read_until(b'\n', &mut line).map_err(|e| failed(path, &e))?;
        // A line without an end was cut off when its writer was stopped.
        if line.pop() != Some(b'\n') {
            break;
        }
        let damaged = || ShardError::Damaged {
            path: path.to_owned(),
            line: number,
        };
        if contents.header.is_none() {
            contents.header = Some(serde_json::from_slice(&line).map_err(|_| damaged())?);
        } else {
            contents.outcomes.push(decoded::<S>(&line).ok_or_else(damaged)?);
        }
        contents.whole += length as u64;
    }
    Ok(contents)
}

/// Fails if an outcome is none of the shard's, or is there twice.
fn check_items<T>(path: &Path, contents: &Contents<T>, own: &std::ops::Range<u64>) -> Result<(), ShardError> {
    let mut seen = BTreeSet::new();
    for (line, (item, _)) in (2..).zip(&contents.outcomes) {
        if !own.contains(item) || !seen.insert(*item) {
            return Err(ShardError::Damaged {
                path: path.to_owned(),
                line,
            });
        }
    }
    Ok(())
}

/// Fails at the first field in which two headers differ, but for those in `may_differ`.
fn compare(path: &Path, theirs: &Value, ours: &Value, may_differ: &[&str]) -> Result<(), ShardError> {
    let (Some(a), Some(b)) = (theirs.as_object(), ours.as_object()) else {
        return Err(ShardError::Damaged {
            path: path.to_owned(),
            line: 1,
        });
    };
    let short = |value: Option<&Value>| {
        let text = value.map_or_else(|| "missing".to_owned(), Value::to_string);
        let cut: String = text.chars().take(60).collect();
        if cut.len() < text.len() { cut + "..." } else { cut }
    };
    for name in b.keys().filter(|name| !may_differ.contains(&name.as_str())) {
        let (x, y) = (a.get(name), b.get(name));
        if x == y {
            continue;
        }
        // Of the options, the one that differs.
        let inner = match (x.and_then(Value::as_object), y.and_then(Value::as_object)) {
            (Some(x), Some(y)) => y
                .keys()
                .find(|k| x.get(*k) != y.get(*k))
                .map(|k| (k, x.get(k), y.get(k))),
            _ => None,
        };
        let (field, x, y) = inner.unwrap_or((name, x, y));
        return Err(ShardError::OtherStudy {
            path: path.to_owned(),
            field: format!("`{field}`"),
            theirs: short(x),
            ours: short(y),
        });
    }
    Ok(())
}

/// See [`merged`](super::merged).
pub(super) fn read_all<S: ShardedStudy>(folder: &Path) -> Result<(S, Vec<S::Outcome>), ShardError> {
    let mut paths: Vec<(PathBuf, Shard)> = std::fs::read_dir(folder)
        .map_err(|e| failed(folder, &e))?
        .filter_map(|entry| Some(entry.ok()?.path()))
        .filter_map(|path| {
            let shard = shard_of::<S>(path.file_name()?.to_str()?)?;
            Some((path, shard))
        })
        .collect();
    paths.sort();
    let mut first: Option<Value> = None;
    let mut outcomes: Vec<(u64, S::Outcome)> = Vec::new();
    for (path, named) in &paths {
        let file = File::open(path).map_err(|e| failed(path, &e))?;
        let contents = read::<S>(path, &file)?;
        // The header of a shard that has only just begun may not be there yet.
        let Some(header) = contents.header.as_ref() else {
            continue;
        };
        compare(path, header, first.as_ref().unwrap_or(header), &["shard"])?;
        let damaged = || ShardError::Damaged {
            path: path.clone(),
            line: 1,
        };
        let number = |name: &str| header.get(name).and_then(Value::as_u64).ok_or_else(damaged);
        let shard = Shard::new(number("shard")?, number("shards")?).filter(|shard| shard == named);
        let shard = shard.ok_or_else(damaged)?;
        check_items(path, &contents, &shard.range(number("items")?))?;
        outcomes.extend(contents.outcomes);
        first.get_or_insert_with(|| header.clone());
    }
    let Some(header) = first else {
        return Err(ShardError::Empty {
            folder: folder.to_owned(),
            study: S::COMMAND,
        });
    };
    let header: ShardHeader<S> = serde_json::from_value(header).map_err(|e| failed(folder, &e))?;
    complete::<S>(&header, &mut outcomes)?;
    Ok((
        header.options,
        outcomes.into_iter().map(|(_, outcome)| outcome).collect(),
    ))
}

/// Sorts the outcomes by item. Fails at the first shard that has not all of its own.
fn complete<S: ShardedStudy>(header: &ShardHeader<S>, outcomes: &mut [(u64, S::Outcome)]) -> Result<(), ShardError> {
    outcomes.sort_by_key(|(item, _)| *item);
    for shard in (1..=header.shards).filter_map(|number| Shard::new(number, header.shards)) {
        let own = shard.range(header.items);
        let from = outcomes.partition_point(|(item, _)| *item < own.start);
        let to = outcomes.partition_point(|(item, _)| *item < own.end);
        let (done, wanted) = ((to - from) as u64, own.end - own.start);
        if done != wanted {
            return Err(ShardError::Incomplete {
                shard,
                done,
                wanted,
                items: S::ITEMS,
            });
        }
    }
    Ok(())
}
