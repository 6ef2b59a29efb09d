//! Studies that are too large for one machine: each machine works on one *shard*, and a merge of all
//! shards gives the bits of one run.
//!
//! A [`ShardedStudy`] is a list of *items* (robots, runs with faults) that do not depend on each other.
//! Shard I of N is the I-th of N contiguous parts of that list. Its outcomes go into a file, one line
//! each ([`ShardFile`]). A shard that is stopped continues from its file.
//!
//! ```text
//!   Study ─ items ─▶ outcomes ──────────────────────────────────────▶ table     (one machine)
//!              └─ shard 1/3 ─▶ worlds-shard-1-of-3.jsonl ─┐
//!              └─ shard 2/3 ─▶ worlds-shard-2-of-3.jsonl ─┼─ merge ─▶ table     (three machines)
//!              └─ shard 3/3 ─▶ worlds-shard-3-of-3.jsonl ─┘
//! ```

mod file;

use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;
use serde::Serialize;
use serde::de::DeserializeOwned;

pub use file::ShardFile;

/// A study whose items do not depend on each other. Its serialized form is all of its options: two
/// shards belong together only if these are the same.
pub trait ShardedStudy: Serialize + DeserializeOwned + Sync {
    /// Name in messages and in the names of files.
    const NAME: &'static str;
    /// The command with its options that make this study.
    const COMMAND: &'static str;
    /// What an item is, in the plural.
    const ITEMS: &'static str;
    /// What is computed once for a range of items.
    type Context: Sync;
    /// What an item gives: all that the study's table needs of it. Every number is finite.
    type Outcome: Serialize + DeserializeOwned + Send;
    /// Why an item fails.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Number of items.
    fn items(&self) -> u64;

    /// Prepares a range of items.
    ///
    /// # Errors
    /// What the items need cannot be made.
    fn prepare(&self, items: Range<u64>) -> Result<Self::Context, Self::Error>;

    /// Works on one item. The outcome depends on the options and on the number of the item alone.
    ///
    /// # Errors
    /// The item fails.
    fn run(&self, context: &Self::Context, item: u64) -> Result<Self::Outcome, Self::Error>;
}

/// Why a shard or a merge failed.
#[derive(Debug, thiserror::Error)]
pub enum ShardError {
    /// An item of the study failed.
    #[error(transparent)]
    Study(Box<dyn std::error::Error + Send + Sync>),
    /// A file or folder failed.
    #[error("{}: {what}: check the folder, its permissions and its free space", path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What happened.
        what: String,
    },
    /// Another process works on the shard.
    #[error("{}: another process works on this shard: wait for its end, or stop it", path.display())]
    Busy {
        /// The file.
        path: PathBuf,
    },
    /// The file belongs to another study.
    #[error("{}: the file is of another study: its {field} is {theirs}, not {ours}: choose another folder with --out", path.display())]
    OtherStudy {
        /// The file.
        path: PathBuf,
        /// What differs.
        field: String,
        /// As it is in the file.
        theirs: String,
        /// As it is asked for, or as it is in the first shard.
        ours: String,
    },
    /// A line is not as it was written.
    #[error("{}: line {line} is not as it was written: remove the file, and run this shard again", path.display())]
    Damaged {
        /// The file.
        path: PathBuf,
        /// Number of the line, from 1.
        line: u64,
    },
    /// An outcome that does not read back as it was written.
    #[error("{study}: item {item} gave a number that is not finite: it cannot be stored")]
    NotFinite {
        /// Name of the study.
        study: &'static str,
        /// Number of the item.
        item: u64,
    },
    /// A folder without shards.
    #[error("{}: holds no shard of `{study}`: run `spherecal {study} --shard 1/3 --out {}` and the others first", folder.display(), folder.display())]
    Empty {
        /// The folder.
        folder: PathBuf,
        /// The command.
        study: &'static str,
    },
    /// A shard that is not there, or not finished.
    #[error(
        "shard {shard} has {done} of {wanted} {items}: run it (again) with --shard {shard}; it continues where it stopped"
    )]
    Incomplete {
        /// The shard.
        shard: Shard,
        /// Items that are done.
        done: u64,
        /// Items that it has.
        wanted: u64,
        /// What the items are.
        items: &'static str,
    },
}

impl ShardError {
    /// Whether the user's input is at fault.
    pub fn is_input(&self) -> bool {
        matches!(
            self,
            Self::OtherStudy { .. } | Self::Empty { .. } | Self::Incomplete { .. } | Self::Busy { .. }
        )
    }

    fn study(error: impl std::error::Error + Send + Sync + 'static) -> Self {
        Self::Study(Box::new(error))
    }
}

/// One of the parts of a study.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct Shard {
    /// Number of shards.
    of: u64,
    /// Its number, from 1.
    number: u64,
}

impl Shard {
    /// Most shards that a study may have.
    pub const MOST: u64 = 100_000;

    /// Shard `number`, from 1, of `of`; `None` if there is no such shard.
    pub fn new(number: u64, of: u64) -> Option<Self> {
        ((1..=of).contains(&number) && of <= Self::MOST).then_some(Self { of, number })
    }

    /// Number, from 1, and number of shards.
    pub const fn numbers(self) -> (u64, u64) {
        (self.number, self.of)
    }

    /// Its part of `items` items. The parts of all shards are contiguous and differ by one item at
    /// most.
    pub fn range(self, items: u64) -> Range<u64> {
        let cut = |k: u64| (u128::from(items) * u128::from(k) / u128::from(self.of)) as u64;
        cut(self.number - 1)..cut(self.number)
    }
}

impl std::fmt::Display for Shard {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(f, "{}/{}", self.number, self.of)
    }
}

/// Why a text is no shard.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error(
    "give I/N, with I from 1 to N, and N at most {}: 2/3 is the second of three shards",
    Shard::MOST
)]
pub struct BadShard;

impl std::str::FromStr for Shard {
    type Err = BadShard;

    fn from_str(text: &str) -> Result<Self, BadShard> {
        let (number, of) = text.split_once('/').ok_or(BadShard)?;
        let (number, of) = (number.parse().map_err(|_| BadShard)?, of.parse().map_err(|_| BadShard)?);
        Self::new(number, of).ok_or(BadShard)
    }
}

/// What a shard did.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct ShardDone {
    /// Name of the study.
    pub study: &'static str,
    /// Number of the shard, from 1.
    pub shard: u64,
    /// Number of shards.
    pub of: u64,
    /// Items of this shard; all of them are done.
    pub items: u64,
    /// Those that an earlier call had done.
    pub done_before: u64,
    /// The file of the shard.
    pub file: PathBuf,
}

/// Works on all items on all cores of this machine; outcomes in the order of the items.
///
/// # Errors
/// The first item that fails.
pub(crate) fn whole<S: ShardedStudy>(study: &S, progress: bool) -> Result<Vec<S::Outcome>, S::Error> {
    let items = 0..study.items();
    let context = study.prepare(items.clone())?;
    let bar = bar(items.end, S::ITEMS, progress);
    let outcomes = items
        .into_par_iter()
        .map(|item| {
            let outcome = study.run(&context, item)?;
            bar.inc(1);
            Ok(outcome)
        })
        .collect();
    bar.finish_and_clear();
    outcomes
}

/// Works on the items of one shard that are not done yet, on all cores, and stores each outcome in
/// the shard's file in `folder` as soon as it is there.
///
/// # Errors
/// An item that fails, a file that cannot be written, or one that belongs to another study.
pub fn run_shard<S: ShardedStudy>(
    study: &S,
    shard: Shard,
    folder: &Path,
    progress: bool,
) -> Result<ShardDone, ShardError> {
    let items = shard.range(study.items());
    let (file, done) = ShardFile::open(study, shard, folder)?;
    let left: Vec<u64> = items.clone().filter(|item| !done.contains(item)).collect();
    let bar = bar(items.end - items.start, S::ITEMS, progress);
    bar.inc(done.len() as u64);
    if let (Some(&first), Some(&last)) = (left.first(), left.last()) {
        let context = study.prepare(first..last + 1).map_err(ShardError::study)?;
        left.par_iter().try_for_each(|&item| {
            let outcome = study.run(&context, item).map_err(ShardError::study)?;
            file.append::<S>(item, &outcome)?;
            bar.inc(1);
            Ok::<(), ShardError>(())
        })?;
    }
    bar.finish_and_clear();
    Ok(ShardDone {
        study: S::NAME,
        shard: shard.number,
        of: shard.of,
        items: items.end - items.start,
        done_before: done.len() as u64,
        file: file.path().to_owned(),
    })
}

/// Reads all shards of a study in `folder`: its options, and the outcomes in the order of the items.
///
/// # Errors
/// A shard that is missing, not finished, damaged or of another study.
pub(crate) fn merged<S: ShardedStudy>(folder: &Path) -> Result<(S, Vec<S::Outcome>), ShardError> {
    file::read_all(folder)
}

/// A bar on stderr over `length` items.
pub(crate) fn bar(length: u64, items: &str, shown: bool) -> indicatif::ProgressBar {
    if !shown {
        return indicatif::ProgressBar::hidden();
    }
    let template = format!("{{bar:40}} {{pos}}/{{len}} {items}, {{elapsed}} elapsed, {{eta}} left");
    let style =
        indicatif::ProgressStyle::with_template(&template).unwrap_or_else(|_| indicatif::ProgressStyle::default_bar());
    indicatif::ProgressBar::new(length).with_style(style)
}

#[cfg(test)]
mod tests;
