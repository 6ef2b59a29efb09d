//! Seals rows: a digest for every row, over all its columns.
//!
//! ```text
//!   write ─▶ row ─▶ seal ─▶ digests        check ─▶ row ─▶ digest ─▶ the same as stored?
//! ```
//!
//! A row whose digest differs, a row without a digest and a digest without a row are damage. The
//! digest is written in the row's own transaction.

use std::collections::BTreeMap;

use sqlx::any::{AnyRow, AnyTypeInfoKind};
use sqlx::{AnyConnection, AssertSqlSafe, Row as _, ValueRef as _};

use super::columns::rows;
use super::digest::{Digest, recording_subject};
use super::{Damage, SqlStore, StoreError, acknowledged};

/// A table whose rows are sealed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Sealed {
    pub(super) name: &'static str,
    /// What identifies a row within its run.
    pub(super) key: &'static [&'static str],
}

const fn sealed(name: &'static str, key: &'static [&'static str]) -> Sealed {
    Sealed { name, key }
}

pub(super) const RUNS: Sealed = sealed("runs", &[]);
pub(super) const SPARES: Sealed = sealed("spares", &["name"]);
pub(super) const SESSIONS: Sealed = sealed("sessions", &["session"]);
pub(super) const GREETINGS: Sealed = sealed("greetings", &["session", "greeting"]);
pub(super) const SPHERES: Sealed = sealed("spheres", &["sphere"]);
pub(super) const POSES: Sealed = sealed("poses", &["sphere", "pose"]);
pub(super) const RECORDINGS: Sealed = sealed("recordings", &["sphere", "pose"]);
pub(super) const CONTACTS: Sealed = sealed("contacts", &["session", "event"]);
pub(super) const COUPLINGS: Sealed = sealed("couplings", &["session", "event"]);
pub(super) const PHASES: Sealed = sealed("phases", &["session", "event"]);
pub(super) const FAULTS: Sealed = sealed("faults", &["session", "event"]);
pub(super) const LASER: Sealed = sealed("laser_shots", &["purpose", "position"]);
pub(super) const RESULTS: Sealed = sealed("results", &["name"]);

/// Every sealed table.
pub(super) const SEALED: [Sealed; 13] = [
    RUNS, SPARES, SESSIONS, GREETINGS, SPHERES, POSES, RECORDINGS, CONTACTS, COUPLINGS, PHASES, FAULTS, LASER, RESULTS,
];

#[derive(Clone, Debug, PartialEq)]
pub(super) enum SealedValue {
    Nothing,
    Whole(i64),
    Real(f64),
    Text(String),
}

impl std::fmt::Display for SealedValue {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Nothing => f.write_str("-"),
            Self::Whole(value) => value.fmt(f),
            Self::Real(value) => value.fmt(f),
            Self::Text(value) => f.write_str(value),
        }
    }
}

/// Digest of a row: the table's name and all values, in the order of the columns.
pub(super) fn of_row(table: &str, values: &[SealedValue]) -> i64 {
    let mut digest = Digest::new().text(table);
    for value in values {
        digest = match value {
            SealedValue::Nothing => digest.whole(0),
            SealedValue::Whole(value) => digest.whole(1).whole(*value as u64),
            SealedValue::Real(value) => digest.whole(2).numbers([value]),
            SealedValue::Text(value) => digest.whole(3).text(value),
        };
    }
    digest.end()
}

/// All values of a row, in the order of the columns.
fn values(row: &AnyRow) -> Result<Vec<SealedValue>, sqlx::Error> {
    (0..row.columns().len())
        .map(|column| {
            let raw = row.try_get_raw(column)?;
            if raw.is_null() {
                return Ok(SealedValue::Nothing);
            }
            Ok(match raw.type_info().kind() {
                AnyTypeInfoKind::Real | AnyTypeInfoKind::Double => SealedValue::Real(row.try_get_unchecked(column)?),
                AnyTypeInfoKind::Text => SealedValue::Text(row.try_get_unchecked(column)?),
                _ => SealedValue::Whole(row.try_get_unchecked(column)?),
            })
        })
        .collect()
}

/// Name and digest of a row.
fn seal_of(table: &Sealed, row: &AnyRow) -> Result<(String, i64), sqlx::Error> {
    let values = values(row)?;
    let mut subject = table.name.to_owned();
    for key in table.key {
        let at = row.columns().iter().position(|c| sqlx::Column::name(c) == *key);
        let value = at.and_then(|at| values.get(at)).unwrap_or(&SealedValue::Nothing);
        subject.push_str(&format!(" {value}"));
    }
    Ok((subject, of_row(table.name, &values)))
}

/// What selects rows within a run.
#[derive(Clone, Copy, Debug)]
pub(super) enum Key<'a> {
    Whole(i64),
    Text(&'a str),
}

/// The rows of a run in a table whose first key columns have these values.
async fn select(t: &mut AnyConnection, table: &Sealed, run: i64, keys: &[Key<'_>]) -> Result<Vec<AnyRow>, sqlx::Error> {
    let mut statement = format!("SELECT * FROM {} WHERE run = $1", table.name);
    for (column, number) in table.key.iter().zip(2..).take(keys.len()) {
        statement.push_str(&format!(" AND {column} = ${number}"));
    }
    let mut query = sqlx::query(AssertSqlSafe(statement)).bind(run);
    for key in keys {
        query = match *key {
            Key::Whole(value) => query.bind(value),
            Key::Text(value) => query.bind(value.to_owned()),
        };
    }
    query.fetch_all(t).await
}

/// Writes the digests of the rows of a run whose first key columns have these values.
pub(super) async fn seal(t: &mut AnyConnection, table: &Sealed, run: i64, keys: &[Key<'_>]) -> Result<(), sqlx::Error> {
    put_seals(t, table, run, keys, "UPDATE SET digest = excluded.digest").await
}

/// Writes the digests of the rows of a run that have none yet.
pub(super) async fn seal_unsealed(t: &mut AnyConnection, table: &Sealed, run: i64) -> Result<(), sqlx::Error> {
    put_seals(t, table, run, &[], "NOTHING").await
}

async fn put_seals(
    t: &mut AnyConnection,
    table: &Sealed,
    run: i64,
    keys: &[Key<'_>],
    known: &str,
) -> Result<(), sqlx::Error> {
    let found = select(t, table, run, keys).await?;
    let seals = found
        .iter()
        .map(|row| seal_of(table, row))
        .collect::<Result<Vec<_>, _>>()?;
    for chunk in seals.chunks(200) {
        let statement = rows("INSERT INTO digests (run, subject, digest)", chunk.len(), 3)
            + &format!(" ON CONFLICT (run, subject) DO {known}");
        let mut insert = sqlx::query(AssertSqlSafe(statement));
        for (subject, digest) in chunk {
            insert = insert.bind(run).bind(subject.clone()).bind(*digest);
        }
        insert.execute(&mut *t).await?;
    }
    Ok(())
}

/// Removes the digests of a table's rows that are no longer there.
pub(super) async fn forget_removed(t: &mut AnyConnection, table: &Sealed, run: i64) -> Result<(), sqlx::Error> {
    let mut there = Vec::new();
    for row in select(t, table, run, &[]).await? {
        there.push(seal_of(table, &row)?.0);
    }
    let stored: Vec<String> = sqlx::query_scalar("SELECT subject FROM digests WHERE run = $1 AND subject LIKE $2")
        .bind(run)
        .bind(format!("{} %", table.name))
        .fetch_all(&mut *t)
        .await?;
    there.sort_unstable();
    for subject in stored.iter().filter(|subject| there.binary_search(subject).is_err()) {
        sqlx::query("DELETE FROM digests WHERE run = $1 AND subject = $2")
            .bind(run)
            .bind(subject.clone())
            .execute(&mut *t)
            .await?;
    }
    Ok(())
}

impl SqlStore {
    pub(super) fn run_numbers(&mut self) -> Result<Vec<i64>, StoreError> {
        self.block(async |connection| {
            sqlx::query_scalar("SELECT run FROM runs ORDER BY run")
                .fetch_all(connection)
                .await
        })
    }

    /// The rows of a run in some tables that are not as they were written.
    pub(super) fn damaged_rows(&mut self, run: i64, tables: &[Sealed]) -> Result<Vec<Damage>, StoreError> {
        let digests = self.digests(run)?;
        let mut damage = Vec::new();
        for table in tables {
            let read = self.block(async |t| select(t, table, run, &[]).await);
            let seals: Result<Vec<_>, _> = read.and_then(|rows| {
                rows.iter()
                    .map(|row| seal_of(table, row).map_err(|e| self.failed(e)))
                    .collect()
            });
            let seals: BTreeMap<String, i64> = match seals {
                Ok(seals) => seals.into_iter().collect(),
                Err(error @ (StoreError::Locked { .. } | StoreError::Full { .. } | StoreError::Server { .. })) => {
                    return Err(error);
                }
                Err(error) => {
                    let what = format!("the table {} cannot be read: {}", table.name, error.cause());
                    damage.push(Damage { run, what });
                    continue;
                }
            };
            let mut found = |subject: &str, what: &str| {
                let what = format!("the row \"{subject}\" {what}");
                damage.push(Damage { run, what });
            };
            for (subject, digest) in &seals {
                match digests.get(subject) {
                    Some(stored) if stored == digest => {}
                    Some(_) => found(subject, "differs from what was written"),
                    None => found(subject, "has no digest"),
                }
            }
            for subject in digests.keys() {
                let of_table = subject.strip_prefix(table.name);
                let own = of_table.is_some_and(|rest| {
                    rest.is_empty() == table.key.is_empty() && (rest.is_empty() || rest.starts_with(' '))
                });
                if own && !seals.contains_key(subject) {
                    found(subject, "is missing");
                }
            }
        }
        Ok(damage)
    }

    /// Fails at the first row of a run, in some tables, that is not as it was written.
    pub(super) fn require_sound(&mut self, run: i64, tables: &[Sealed]) -> Result<(), StoreError> {
        match self.damaged_rows(run, tables)?.into_iter().next() {
            None => Ok(()),
            Some(damage) => Err(StoreError::Damaged {
                path: self.path.clone(),
                what: format!("run {}: {}", damage.run, damage.what),
            }),
        }
    }

    /// Fails if a named result is not as it was written.
    pub(super) fn require_result(&mut self, run: i64, name: &str) -> Result<(), StoreError> {
        let found = self.block(async |t| {
            let rows = select(t, &RESULTS, run, &[Key::Text(name)]).await?;
            rows.first().map(|row| seal_of(&RESULTS, row)).transpose()
        })?;
        let stored = self.digests(run)?.get(&format!("{} {name}", RESULTS.name)).copied();
        if found.map(|(_, digest)| digest) == stored {
            return Ok(());
        }
        Err(StoreError::Damaged {
            path: self.path.clone(),
            what: format!("run {run}: the result \"{name}\" differs from what was written"),
        })
    }

    /// Reads every row of every run and compares it with its digest, and the number of recordings
    /// with what was acknowledged. Returns what is not as it was written.
    ///
    /// # Errors
    /// When the database cannot be read at all.
    pub fn damage(&mut self) -> Result<Vec<Damage>, StoreError> {
        let stated = acknowledged::stated(&self.path);
        self.snapshot(|store| {
            let mut damage = store.lost_recordings(&stated)?;
            damage.append(&mut store.damage_of_runs()?);
            Ok(damage)
        })
    }

    fn damage_of_runs(&mut self) -> Result<Vec<Damage>, StoreError> {
        let mut runs = self.run_numbers()?;
        let digested: Vec<i64> = self.block(async |connection| {
            sqlx::query_scalar("SELECT DISTINCT run FROM digests")
                .fetch_all(connection)
                .await
        })?;
        runs.extend(digested);
        runs.sort_unstable();
        runs.dedup();
        let mut damage = Vec::new();
        for run in runs {
            let mut found = self.damaged_rows(run, &SEALED)?;
            if found.is_empty() {
                // Joints of recordings, settings and laser shots have digests of their own.
                for error in [
                    self.recordings(run).err(),
                    self.laser(run).err(),
                    self.info_of(run).err(),
                    self.stray_digests(run).err(),
                ] {
                    found.extend(error.map(|error| Damage {
                        run,
                        what: error.cause(),
                    }));
                }
            }
            damage.append(&mut found);
        }
        Ok(damage)
    }

    /// Fails if a run has a digest of nothing that is stored.
    fn stray_digests(&mut self, run: i64) -> Result<(), StoreError> {
        let recorded = self.unchecked_recordings(run)?;
        let recorded: Vec<String> = recorded.iter().map(|r| recording_subject(r.sphere, r.pose)).collect();
        let subjects = self.digests(run)?;
        let missing = recorded.iter().find(|subject| !subjects.contains_key(*subject));
        let stray = subjects.keys().find(|subject| {
            let table = subject.split(' ').next().unwrap_or_default();
            match table {
                "run" | "laser" => subject.contains(' '),
                "recording" => !recorded.contains(subject),
                _ => SEALED.iter().all(|sealed| sealed.name != table),
            }
        });
        let what = match (missing, stray) {
            (None, None) => return Ok(()),
            (Some(subject), _) => format!("{subject} has no digest"),
            (None, Some(subject)) => format!("there is a digest of \"{subject}\", which is not stored"),
        };
        Err(StoreError::Damaged {
            path: self.path.clone(),
            what,
        })
    }
}
