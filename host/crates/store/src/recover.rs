//! Copies the readable data of a damaged database into a new file.
//!
//! The damaged file is copied and only the copy is opened. Rows are read forwards, backwards and by
//! their number, so a damaged page costs only the rows on it. A list of tables that differs from that
//! of a fresh database is replaced by it where more rows can then be read: databases of this program
//! have the same tables in the same places. Each row is compared with its digest, and a row that differs is left
//! out. Damaged settings, certificates and poses are restored from their second copy.
//!
//! Of a damaged log, SQLite reads what is before the damage. A second copy has all sound frames of the log, and the
//! rows of both are taken. A file of a newer schema is refused: it has columns of which this program knows nothing.

use std::collections::{BTreeMap, BTreeSet};
use std::ffi::OsString;
use std::path::{Path, PathBuf};

use serde::Serialize;
use spherecal_shared::protocol::host::Recording;
use sqlx::{AnyConnection, Connection as _};

use self::rows::{StoredRow, columns_of, insert_rows, read_rows, run_of};
use self::schema::{NoSource, sources_of};
use self::seals::Seals;
use super::columns::put_digest;
use super::digest::{self, recording_subject};
use super::log::{Log, log_of};
use super::seal::{RUNS, SealedValue, seal};
use super::{RunInfo, SCHEMA_VERSION, SqlStore, StoreError, acknowledged};

mod rows;
mod schema;
mod seals;

/// Tables, those that others refer to first. Handshakes refer to sessions, which other tables may
/// restore.
const TABLES: [&str; 13] = [
    "runs",
    "spheres",
    "poses",
    "recordings",
    "recording_joints",
    "contacts",
    "couplings",
    "phases",
    "faults",
    "sessions",
    "greetings",
    "laser_shots",
    "results",
];

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
    /// Runs whose settings were restored from their second copy.
    pub settings_restored: Vec<i64>,
    /// Runs whose settings differ from what was written, and have no second copy: they are kept as
    /// they were read.
    pub settings_doubtful: Vec<i64>,
    /// Runs whose settings and their second copy cannot be read. Without them nothing of a run can be used: these
    /// runs are not in the new file.
    pub settings_lost: Vec<i64>,
    /// How many recordings were acknowledged and are not in the new file, by run. Known only where
    /// the log could not be emptied after the last batch.
    pub acknowledged_missing: BTreeMap<i64, i64>,
    /// Whether the list of tables had to be replaced by that of a fresh database.
    pub schema_replaced: bool,
    /// Frames of the log behind a damaged one that were read all the same.
    pub log_frames_salvaged: usize,
}

/// Copies the readable data of the database at `damaged` into a new one at `new`.
///
/// Every row that is as it was written is kept, whatever else is damaged. A run with lost data
/// counts as unfinished in the new file, so that `--resume` records what is missing. Everything in
/// the new file is sealed anew.
///
/// # Errors
/// When `new` exists, `damaged` does not, has a newer schema, a file cannot be written, or no part of
/// `damaged` looks like a database of this program.
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
    let fresh = std::fs::read(&draft).map_err(|source| workshop.io(source))?;
    let runtime = tokio::runtime::Builder::new_current_thread()
        .enable_all()
        .build()
        .map_err(|source| workshop.io(source))?;
    let columns = target.block(async |connection| {
        let mut columns = Vec::new();
        for table in TABLES.into_iter().chain(["digests"]) {
            columns.push((table, columns_of(table, connection).await?));
        }
        Ok(columns)
    })?;
    let sources = runtime.block_on(sources_of(&workshop, &fresh, &columns));
    let mut sources = sources.map_err(|error| match error {
        NoSource::Io(error) => error,
        NoSource::Newer(found) => StoreError::Version {
            path: damaged.to_owned(),
            found,
            expected: SCHEMA_VERSION,
        },
        NoSource::Unreadable(source) => StoreError::Damaged {
            path: damaged.to_owned(),
            what: source.to_string(),
        },
    })?;
    recovered.schema_replaced = sources.iter().any(|source| source.replaced);
    recovered.log_frames_salvaged = workshop.salvaged;
    let seals = runtime.block_on(Seals::read(&mut sources));
    let mut incomplete = BTreeSet::new();
    let mut open = Vec::new();
    for table in TABLES {
        let of_table = columns.iter().find(|(name, _)| *name == table);
        let of_table = of_table.map(|(_, columns)| columns.as_slice()).unwrap_or_default();
        let (rows, lost) = runtime.block_on(read_rows(table, of_table, &mut sources));
        let mut saved = Saved { read: 0, lost };
        let (good, mut bad): (Vec<_>, Vec<_>) = rows.into_iter().partition(|row| seals.vouch_for(table, row));
        let mut kept = good;
        match table {
            "runs" => kept = seals.settings(kept, &bad, &mut recovered),
            "spheres" => kept = seals.certificate(kept, &bad),
            "poses" => {
                kept = seals.poses(kept);
                saved.lost += seals::without(&bad, &kept);
            }
            _ => {
                if table == "recordings" {
                    open = seals.open(&bad);
                    bad.retain(|row| !open.contains(row));
                    kept.extend(open.iter().cloned());
                }
                saved.lost += bad.len() as u64;
                // Results are computed again; everything else has to be measured again.
                if table != "results" {
                    incomplete.extend(bad.iter().filter_map(run_of));
                }
            }
        }
        target.block(async |connection| insert_rows(table, &kept, connection, &mut saved).await)?;
        if table == "sessions" {
            target.block(async |connection| restore_sessions(connection).await)?;
        }
        recovered.tables.insert(table, saved);
    }
    for source in sources {
        // An error while closing does not matter to a copy.
        let _ = runtime.block_on(source.connection.close());
    }
    recovered.recordings_left_out = leave_out(&mut target, &seals, &open)?;
    // What cannot be read states nothing.
    let stated = acknowledged::stated(damaged).unwrap_or_default();
    recovered.acknowledged_missing = acknowledged::missing(&stated, &target.recording_counts()?);
    target.block(async |connection| complete_runs(&recovered.settings_restored, connection).await)?;
    seal_anew(&mut target)?;
    incomplete.extend(seals.runs_that_lack(&mut target)?);
    reopen_runs(&mut target, &incomplete)?;
    drop(target);
    std::fs::rename(&draft, new).map_err(|source| workshop.io(source))?;
    Ok(recovered)
}

/// A folder beside the new file for the copies and the draft. It is removed when this is dropped.
struct Workshop {
    folder: PathBuf,
    /// The file with its log.
    copy: PathBuf,
    /// The file with all sound frames of its damaged log.
    with_sound_frames: Option<PathBuf>,
    /// How many sound frames are behind the damaged one.
    salvaged: usize,
}

impl Workshop {
    fn new(damaged: &Path, new: &Path) -> Result<Self, StoreError> {
        let mut name = OsString::from(new.as_os_str());
        name.push(format!(".recovering-{}", std::process::id()));
        let folder = PathBuf::from(name);
        let mut this = Self {
            copy: folder.join("copy.db"),
            folder,
            with_sound_frames: None,
            salvaged: 0,
        };
        std::fs::create_dir_all(&this.folder).map_err(|source| this.io(source))?;
        let (log, of_file) = (log_of(damaged), StoreError::io(damaged));
        std::fs::copy(damaged, &this.copy).map_err(of_file)?;
        if log.is_file() {
            let of_log = StoreError::io(&log);
            std::fs::copy(&log, log_of(&this.copy)).map_err(of_log)?;
            if let Some(frames) = Log::read(&log).map_err(of_log)?
                && frames.salvageable() > 0
            {
                let mut bytes = std::fs::read(damaged).map_err(of_file)?;
                frames.apply(&mut bytes);
                let path = this.folder.join("frames.db");
                std::fs::write(&path, bytes).map_err(|source| this.io(source))?;
                this.salvaged = frames.salvageable();
                this.with_sound_frames = Some(path);
            }
        }
        Ok(this)
    }

    /// The copies, the one with the newest rows first.
    fn copies(&self) -> impl Iterator<Item = &Path> {
        self.with_sound_frames.iter().chain([&self.copy]).map(PathBuf::as_path)
    }

    fn io(&self, source: std::io::Error) -> StoreError {
        StoreError::io(&self.folder)(source)
    }
}

impl Drop for Workshop {
    fn drop(&mut self) {
        if let Err(error) = std::fs::remove_dir_all(&self.folder) {
            tracing::warn!(folder = %self.folder.display(), %error, "the folder of the recovery is left");
        }
    }
}

/// Removes recordings that differ from what was written, or that lack joints. Those of the rows in `open` stay only if the
/// digest of the whole recording vouches for them.
fn leave_out(target: &mut SqlStore, seals: &Seals, open: &[StoredRow]) -> Result<Vec<(i64, i64, i64)>, StoreError> {
    let mut left_out = Vec::new();
    for run in target.run_numbers()? {
        // The largest number of joints of any recording of the run. A recording with fewer has lost
        // some.
        let recordings = target.unchecked_recordings(run)?;
        let joints = recordings.iter().map(|r| r.q.len()).max().unwrap_or(0);
        for r in &recordings {
            let whole = match seals.known(run, &recording_subject(r.sphere, r.pose), digest::of_recording(r)) {
                Some(same) => same,
                None => r.q.len() == joints && joints > 0 && !open.iter().any(|row| is_of(row, run, r)),
            };
            if !whole {
                left_out.push((run, i64::from(r.sphere), i64::from(r.pose)));
            }
        }
    }
    for (run, sphere, pose) in &left_out {
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
            t.commit().await
        })?;
    }
    Ok(left_out)
}

/// Whether a row of `recordings` is that of a recording.
fn is_of(row: &StoredRow, run: i64, recording: &Recording) -> bool {
    let whole = |k: usize| match row.get(k) {
        Some(SealedValue::Whole(value)) => Some(*value),
        _ => None,
    };
    let key = [run, recording.sphere.into(), recording.pose.into()];
    key.into_iter().enumerate().all(|(k, value)| whole(k) == Some(value))
}

/// Marks runs whose state is lost by the results that they have: `complete` where the summary is there that is
/// written of a measured run, `commissioned` where a first run on a robot is.
async fn complete_runs(runs: &[i64], connection: &mut AnyConnection) -> Result<(), sqlx::Error> {
    for run in runs {
        for (state, result) in [("complete", "summary"), (RunInfo::COMMISSIONED, "commissioning")] {
            sqlx::query(
                "UPDATE runs SET state = $2 WHERE run = $1 AND EXISTS \
                 (SELECT 1 FROM results WHERE results.run = $1 AND name = $3)",
            )
            .bind(*run)
            .bind(state)
            .bind(result)
            .execute(&mut *connection)
            .await?;
        }
    }
    Ok(())
}

/// Marks calibrations that lack something that is measured as running.
fn reopen_runs(target: &mut SqlStore, incomplete: &BTreeSet<i64>) -> Result<(), StoreError> {
    target.write(async |t| {
        let lacking: Vec<i64> = sqlx::query_scalar(
            "SELECT run FROM runs WHERE EXISTS (SELECT 1 FROM poses p WHERE p.run = runs.run AND p.rejected IS NULL \
             AND NOT EXISTS (SELECT 1 FROM recordings r WHERE r.run = p.run AND r.sphere = p.sphere AND r.pose = p.pose))",
        )
        .fetch_all(&mut *t)
        .await?;
        for run in incomplete.iter().chain(&lacking) {
            sqlx::query("UPDATE runs SET state = 'running' WHERE run = $1 AND state <> $2")
                .bind(*run)
                .bind(RunInfo::COMMISSIONED)
                .execute(&mut *t)
                .await?;
            seal(t, &RUNS, *run, &[]).await?;
        }
        Ok(())
    })
}

/// Adds an empty session where recordings or events name one that is lost.
async fn restore_sessions(connection: &mut AnyConnection) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO sessions (run, session, started_utc, firmware, simulated_us, ticks, wall_s, link_json, \
         telemetry_json) SELECT run, session, '', '', 0, 0, 0.0, '{}', '{}' FROM \
         (SELECT run, session FROM recordings UNION SELECT run, session FROM contacts \
         UNION SELECT run, session FROM couplings UNION SELECT run, session FROM phases \
         UNION SELECT run, session FROM faults) named WHERE $1 = 1 AND NOT EXISTS \
         (SELECT 1 FROM sessions s WHERE s.run = named.run AND s.session = named.session)",
    )
    .bind(1i64)
    .execute(connection)
    .await
    .map(|_| ())
}

/// Writes the digests of everything that is in the new file.
fn seal_anew(target: &mut SqlStore) -> Result<(), StoreError> {
    for run in target.run_numbers()? {
        let digest = target.settings_digest(run)?;
        let laser = target.unchecked_laser(run)?;
        target.block(async |connection| {
            if let Some(digest) = digest {
                put_digest(connection, run, "run", digest).await?;
            }
            put_digest(connection, run, "laser", digest::of_laser(&laser)).await
        })?;
    }
    target.seal_everything()
}
