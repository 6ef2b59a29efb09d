//! States, beside the database, how many recordings were acknowledged while the log holds some of
//! them.
//!
//! ```text
//!   batch ─▶ commit ─▶ log emptied? ─ yes ─▶ no statement is needed: the file has everything
//!                           └─ no, another program reads ─▶ statement, on the disk ─▶ acknowledged
//! ```
//!
//! SQLite reads a damaged log up to the first bad frame, and a lost one as if it had been empty. Both
//! look like a database with fewer recordings. The statement tells them apart. Recordings are never
//! removed from a database, so a statement that is older than the database is no contradiction.

use std::collections::BTreeMap;
use std::io::ErrorKind;
use std::path::{Path, PathBuf};

use spherecal_model::write_file;

use super::{Damage, DatabaseKind, SqlStore, StoreError};

/// Number of recordings, by run.
pub(super) type Counts = BTreeMap<i64, i64>;

/// The file of the statement. A link to a database leads to the statement of the database, like to
/// its log.
pub(super) fn statement_of(database: &Path) -> PathBuf {
    let mut name = std::fs::canonicalize(database)
        .unwrap_or_else(|_| database.to_owned())
        .into_os_string();
    name.push("-acknowledged");
    name.into()
}

/// What is stated about the database at this path: nothing, where there is no statement.
/// Errors: the statement cannot be read, or is none.
pub(super) fn stated(database: &Path) -> Result<Counts, StoreError> {
    let path = statement_of(database);
    match std::fs::read(&path) {
        Ok(text) => serde_json::from_slice(&text).map_err(|source| StoreError::Decode {
            path,
            field: "recordings by run",
            source,
        }),
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(Counts::new()),
        Err(source) => Err(StoreError::Io { path, source }),
    }
}

/// How many recordings of which run are stated, but not there.
pub(super) fn missing(stated: &Counts, there: &Counts) -> Counts {
    let lost = |(run, stated): (&i64, &i64)| (*run, stated - there.get(run).unwrap_or(&0));
    stated.iter().map(lost).filter(|(_, lost)| *lost > 0).collect()
}

impl SqlStore {
    /// The recordings that the database has.
    pub(super) fn recording_counts(&mut self) -> Result<Counts, StoreError> {
        let counted: Vec<(i64, i64)> = self.block(async |connection| {
            sqlx::query_as("SELECT run, COUNT(*) FROM recordings GROUP BY run")
                .fetch_all(connection)
                .await
        })?;
        Ok(counted.into_iter().collect())
    }

    /// States what is acknowledged now: the log holds a part of it.
    /// Errors: the statement cannot be written. Then nothing may be acknowledged.
    pub(super) fn state_acknowledged(&mut self) -> Result<(), StoreError> {
        let mut counts = self.recording_counts()?;
        // What an earlier statement says and what is lost since remains to be seen.
        for (run, count) in stated(&self.path).unwrap_or_default() {
            let now = counts.entry(run).or_default();
            *now = count.max(*now);
        }
        let path = statement_of(&self.path);
        // A map of numbers always encodes.
        let text = serde_json::to_vec(&counts).unwrap_or_default();
        if let Err(source) = write_file(&path, text) {
            return Err(StoreError::Full {
                path,
                what: source.to_string(),
            });
        }
        super::file::sync_folder(&path);
        self.stated = true;
        Ok(())
    }

    /// Removes the statement: the log is empty. It stays where it says more than the database has.
    /// Errors: the database cannot be read.
    pub(super) fn withdraw_statement(&mut self) -> Result<(), StoreError> {
        let path = statement_of(&self.path);
        if path.symlink_metadata().is_err() {
            return Ok(());
        }
        let there = self.recording_counts()?;
        match stated(&self.path) {
            Ok(stated) if missing(&stated, &there).is_empty() => {
                if let Err(error) = std::fs::remove_file(&path) {
                    tracing::warn!(path = %path.display(), %error, "the statement was not removed; it does no harm");
                }
                self.stated = false;
            }
            _ => tracing::warn!(path = %path.display(), "more was acknowledged than the database has: check it"),
        }
        Ok(())
    }

    /// The runs that have fewer recordings than were acknowledged.
    ///
    /// `stated` is what was stated before the database was read: another program may be measuring.
    pub(super) fn lost_recordings(&mut self, stated: &Result<Counts, StoreError>) -> Result<Vec<Damage>, StoreError> {
        if self.kind != DatabaseKind::Sqlite {
            return Ok(Vec::new());
        }
        let there = self.recording_counts()?;
        Ok(match stated {
            Ok(stated) => missing(stated, &there)
                .into_iter()
                .map(|(run, lost)| Damage {
                    run,
                    what: format!(
                        "{} recordings were acknowledged and {} are there: the log that held the other {lost} is \
                         damaged or lost",
                        lost + there.get(&run).unwrap_or(&0),
                        there.get(&run).unwrap_or(&0)
                    ),
                })
                .collect(),
            Err(error) => vec![Damage {
                run: there.keys().next_back().copied().unwrap_or(0),
                what: format!(
                    "the number of its acknowledged recordings cannot be read ({}: {error})",
                    statement_of(&self.path).display()
                ),
            }],
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a recording that was acknowledged and is not there goes unseen, or if a database that
    // has more than was stated is refused.
    #[test]
    fn only_what_is_stated_and_not_there_is_missing() {
        let counts = |pairs: &[(i64, i64)]| pairs.iter().copied().collect::<Counts>();
        let stated = counts(&[(1, 12), (2, 3), (4, 1)]);
        assert_eq!(missing(&stated, &counts(&[(1, 12), (2, 3), (4, 1)])), counts(&[]));
        assert_eq!(
            missing(&stated, &counts(&[(1, 15), (2, 4), (3, 9), (4, 2)])),
            counts(&[])
        );
        assert_eq!(missing(&stated, &counts(&[(1, 9), (2, 3)])), counts(&[(1, 3), (4, 1)]));
    }
}
