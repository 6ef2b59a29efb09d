//! Copies the readable data of a damaged database into a new file.
//!
//! The damaged file is copied and only the copy is opened. Rows are fetched one by one by their
//! number, so a damaged page costs only the rows on it. A lost first page is replaced by that of a
//! fresh database, which has the same tables in the same places. The copied data are compared with
//! their digests, and a recording that differs is left out.

use std::collections::BTreeMap;
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Serialize;
use sqlx::sqlite::{SqliteConnectOptions, SqliteRow};
use sqlx::{
    AnyConnection, AssertSqlSafe, ConnectOptions as _, Connection as _, Row as _, SqliteConnection, TypeInfo as _,
    ValueRef as _,
};

use super::digest::{self, recording_subject};
use super::{SqlStore, StoreError};

/// Tables, those that others refer to first.
const TABLES: [&str; 14] = [
    "runs",
    "sessions",
    "greetings",
    "spheres",
    "poses",
    "recordings",
    "recording_joints",
    "contacts",
    "couplings",
    "phases",
    "faults",
    "laser_shots",
    "results",
    "digests",
];

/// The search for rows of a table ends after so many numbers in a row without a row.
const GAP: i64 = 20_000;

/// What was saved of one table.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Saved {
    /// Rows that are in the new file.
    pub read: u64,
    /// Rows that exist but cannot be read, or that contradict others.
    pub lost: u64,
}

/// What was saved of a database.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct Recovered {
    /// By table.
    pub tables: BTreeMap<&'static str, Saved>,
    /// Recordings that were left out because they differ from what was written, or lack joints:
    /// run, sphere, pose.
    pub recordings_left_out: Vec<(i64, i64, i64)>,
    /// Whether the first page, and with it the list of tables, had to be replaced.
    pub first_page_replaced: bool,
}

/// Copies the readable data of the database at `damaged` into a new one at `new`.
///
/// A run with lost data counts as unfinished in the new file, so that `--resume` records what is
/// missing.
///
/// # Errors
/// When `new` exists, `damaged` does not, a file cannot be written, or no part of `damaged` looks
/// like a database of this program.
pub fn recover(damaged: &Path, new: &Path) -> Result<Recovered, StoreError> {
    if !damaged.is_file() {
        return Err(StoreError::Missing {
            path: damaged.to_owned(),
        });
    }
    if new.exists() {
        return Err(StoreError::Exists { path: new.to_owned() });
    }
    let workshop = Workshop::new(damaged, new)?;
    let mut recovered = Recovered::default();
    let draft = workshop.folder.join("new.db");
    let mut target = SqlStore::create_or_open(&draft)?;
    let first_page = std::fs::read(&draft).map_err(|source| workshop.io(source))?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| workshop.io(source))?;
    let mut source = runtime.block_on(open_copy(&workshop.copy));
    if source.is_err() {
        workshop.replace_first_page(&first_page)?;
        recovered.first_page_replaced = true;
        source = runtime.block_on(open_copy(&workshop.copy));
    }
    let mut source = source.map_err(|source| StoreError::Damaged {
        path: damaged.to_owned(),
        what: source.to_string(),
    })?;
    for table in TABLES {
        let saved = target.block(async |connection| copy_table(table, &mut source, connection).await)?;
        recovered.tables.insert(table, saved);
    }
    // An error while closing does not matter to a copy.
    let _ = runtime.block_on(source.close());
    recovered.recordings_left_out = leave_out(&mut target)?;
    reopen_runs(&mut target)?;
    drop(target);
    std::fs::rename(&draft, new).map_err(|source| workshop.io(source))?;
    Ok(recovered)
}

/// A folder beside the new file for the copy and the draft. It is removed when this is dropped.
struct Workshop {
    folder: PathBuf,
    copy: PathBuf,
}

impl Workshop {
    fn new(damaged: &Path, new: &Path) -> Result<Self, StoreError> {
        let mut name = OsString::from(new.as_os_str());
        name.push(format!(".recovering-{}", std::process::id()));
        let folder = PathBuf::from(name);
        let this = Self {
            copy: folder.join("copy.db"),
            folder,
        };
        std::fs::create_dir_all(&this.folder).map_err(|source| this.io(source))?;
        for (end, needed) in [("", true), ("-wal", false)] {
            let with = |path: &Path| {
                let mut name = path.as_os_str().to_owned();
                name.push(end);
                PathBuf::from(name)
            };
            let from = with(damaged);
            if needed || from.is_file() {
                std::fs::copy(&from, with(&this.copy)).map_err(|source| StoreError::Io { path: from, source })?;
            }
        }
        Ok(this)
    }

    fn io(&self, source: std::io::Error) -> StoreError {
        StoreError::Io {
            path: self.folder.clone(),
            source,
        }
    }

    /// Gives the copy the first page of `fresh`, and removes its log, which would bring the damaged
    /// page back.
    fn replace_first_page(&self, fresh: &[u8]) -> Result<(), StoreError> {
        let page = fresh
            .get(16..18)
            .and_then(|b| b.try_into().ok())
            .map_or(4096, |b| usize::from(u16::from_be_bytes(b)));
        let mut bytes = std::fs::read(&self.copy).map_err(|source| self.io(source))?;
        let pages = u32::try_from(bytes.len() / page.max(512)).unwrap_or(u32::MAX);
        if let (Some(old), Some(new)) = (bytes.get_mut(..page), fresh.get(..page)) {
            old.copy_from_slice(new);
            // Its own number of pages, no free pages, and no write-ahead mode.
            for (at, value) in [(28, pages), (32, 0), (36, 0)] {
                if let Some(slot) = old.get_mut(at..at + 4) {
                    slot.copy_from_slice(&value.to_be_bytes());
                }
            }
            if let Some(slot) = old.get_mut(18..20) {
                slot.copy_from_slice(&[1, 1]);
            }
        }
        std::fs::write(&self.copy, &bytes).map_err(|source| self.io(source))?;
        let mut log = self.copy.as_os_str().to_owned();
        log.push("-wal");
        match std::fs::remove_file(PathBuf::from(log)) {
            Err(error) if error.kind() != std::io::ErrorKind::NotFound => Err(self.io(error)),
            _ => Ok(()),
        }
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.folder) {
            tracing::warn!(folder = %self.folder.display(), %error, "the folder of the recovery is left");
        }
    }
}

/// Opens a copy that may be shorter than its header says, and checks whether its list of tables is
/// readable.
async fn open_copy(copy: &Path) -> Result<SqliteConnection, sqlx::Error> {
    let mut connection = SqliteConnectOptions::new()
        .filename(copy)
        .pragma("writable_schema", "ON")
        .connect()
        .await?;
    let known: i64 = sqlx::query_scalar(
        "SELECT COUNT(*) FROM sqlite_master WHERE type = 'table' AND name IN ('runs', 'recordings', 'poses')",
    )
    .fetch_one(&mut connection)
    .await?;
    if known == 3 {
        Ok(connection)
    } else {
        Err(sqlx::Error::RowNotFound)
    }
}

/// Copies the rows of one table that can be read and that are consistent.
async fn copy_table(
    table: &str,
    source: &mut SqliteConnection,
    target: &mut AnyConnection,
) -> Result<Saved, sqlx::Error> {
    let columns: Vec<String> = sqlx::query_scalar(AssertSqlSafe(format!(
        "SELECT name FROM pragma_table_info('{table}') ORDER BY cid"
    )))
    .fetch_all(&mut *target)
    .await?;
    let list = columns.join(", ");
    let marks: Vec<String> = (1..=columns.len()).map(|k| format!("${k}")).collect();
    let insert = format!("INSERT INTO {table} ({list}) VALUES ({})", marks.join(", "));
    // An expression has no declared type; a declared type that is not text would hang the driver.
    let values: Vec<String> = columns.iter().map(|name| format!("+{name} AS {name}")).collect();
    let select = format!("SELECT {} FROM {table} WHERE rowid = $1", values.join(", "));
    let highest: Option<i64> = sqlx::query_scalar(AssertSqlSafe(format!("SELECT MAX(rowid) FROM {table}")))
        .fetch_one(&mut *source)
        .await
        .ok()
        .flatten();
    let mut saved = Saved::default();
    let (mut rowid, mut missing) = (0, 0);
    let mut transaction = target.begin().await?;
    while highest.map_or(missing < GAP, |highest| rowid < highest) && rowid < i64::MAX {
        rowid += 1;
        match sqlx::query(AssertSqlSafe(select.clone()))
            .bind(rowid)
            .fetch_optional(&mut *source)
            .await
        {
            Ok(None) => missing += 1,
            // The table, or a column that an older schema lacks, is missing: nothing of it can be
            // read.
            Err(_) if rowid == 1 && !has_table(table, source).await => break,
            Err(_) => {
                missing += 1;
                saved.lost += 1;
            }
            Ok(Some(row)) => {
                missing = 0;
                if insert_row(&insert, &row, columns.len(), &mut transaction).await {
                    saved.read += 1;
                } else {
                    saved.lost += 1;
                }
            }
        }
        // A damaged highest number must not lead to a search up to it.
        if missing > 100 * GAP {
            break;
        }
    }
    if highest.is_none() {
        // Behind the last row nothing was lost.
        saved.lost = saved.lost.saturating_sub(missing.unsigned_abs());
    }
    transaction.commit().await?;
    Ok(saved)
}

async fn has_table(table: &str, source: &mut SqliteConnection) -> bool {
    let found: Result<i64, _> = sqlx::query_scalar("SELECT COUNT(*) FROM sqlite_master WHERE name = $1")
        .bind(table)
        .fetch_one(source)
        .await;
    found.is_ok_and(|count| count > 0)
}

/// Writes one row unchanged. Returns `false` if the new file refuses it (a duplicate key, a lost
/// run, a missing number).
async fn insert_row(insert: &str, row: &SqliteRow, columns: usize, target: &mut AnyConnection) -> bool {
    let mut query = sqlx::query(AssertSqlSafe(insert.to_owned()));
    for column in 0..columns {
        let Ok(value) = row.try_get_raw(column) else {
            return false;
        };
        let name = value.type_info().name().to_owned();
        let null = value.is_null();
        query = match name.as_str() {
            _ if null => query.bind(None::<i64>),
            "INTEGER" => match row.try_get_unchecked::<i64, _>(column) {
                Ok(value) => query.bind(value),
                Err(_) => return false,
            },
            "REAL" => match row.try_get_unchecked::<f64, _>(column) {
                Ok(value) => query.bind(value),
                Err(_) => return false,
            },
            "TEXT" => match row.try_get_unchecked::<String, _>(column) {
                Ok(value) => query.bind(value),
                Err(_) => return false,
            },
            // No column of ours holds anything else.
            _ => return false,
        };
    }
    query.execute(target).await.is_ok()
}

/// Removes recordings that differ from what was written, or that lack joints.
fn leave_out(target: &mut SqlStore) -> Result<Vec<(i64, i64, i64)>, StoreError> {
    let runs: Vec<i64> = target.block(async |connection| {
        sqlx::query_scalar("SELECT run FROM runs ORDER BY run")
            .fetch_all(connection)
            .await
    })?;
    let mut left_out = Vec::new();
    for run in runs {
        let digests = target.digests(run)?;
        // The largest number of joints of any recording of the run. A recording with fewer has lost
        // some.
        let recordings = target.unchecked_recordings(run)?;
        let joints = recordings.iter().map(|r| r.q.len()).max().unwrap_or(0);
        for r in &recordings {
            let subject = recording_subject(r.sphere, r.pose);
            let whole = match digests.get(&subject) {
                Some(digest) => *digest == digest::of_recording(r),
                None => r.q.len() == joints && joints > 0,
            };
            if !whole {
                left_out.push((run, i64::from(r.sphere), i64::from(r.pose)));
            }
        }
    }
    for (run, sphere, pose) in &left_out {
        let subject = format!("recording {sphere} {pose}");
        target.block(async |connection| {
            let mut t = connection.begin().await?;
            for statement in [
                "DELETE FROM recording_joints WHERE run = $1 AND sphere = $2 AND pose = $3",
                "DELETE FROM recordings WHERE run = $1 AND sphere = $2 AND pose = $3",
            ] {
                sqlx::query(statement)
                    .bind(run)
                    .bind(sphere)
                    .bind(pose)
                    .execute(&mut *t)
                    .await?;
            }
            sqlx::query("DELETE FROM digests WHERE run = $1 AND subject = $2")
                .bind(run)
                .bind(&subject)
                .execute(&mut *t)
                .await?;
            t.commit().await
        })?;
    }
    Ok(left_out)
}

/// Marks runs that lack recordings as running.
fn reopen_runs(target: &mut SqlStore) -> Result<(), StoreError> {
    target.block(async |connection| {
        sqlx::query(
            "UPDATE runs SET state = 'running' WHERE \
             (SELECT COUNT(*) FROM recordings r WHERE r.run = runs.run) < \
             (SELECT COUNT(*) FROM poses p WHERE p.run = runs.run AND p.rejected IS NULL)",
        )
        .execute(connection)
        .await
        .map(|_| ())
    })
}
