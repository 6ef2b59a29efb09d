//! The SQL database as a [`CalibrationStore`].

use std::path::Path;

use spherecal_model::LaserShot;

use super::past::StoredPast;
use super::seal::{
    CONTACTS, COUPLINGS, FAULTS, GREETINGS, LASER, PHASES, POSES, RECORDINGS, SESSIONS, SPHERES, Sealed,
};
use super::{CalibrationStore, DatabaseKind, NewRun, Placed, RunInfo, SessionEnd, SqlStore, StoreError, StoredRun};

/// What was measured in a run.
const MEASURED: [Sealed; 10] = [
    SESSIONS, GREETINGS, SPHERES, POSES, RECORDINGS, CONTACTS, COUPLINGS, PHASES, FAULTS, LASER,
];

impl CalibrationStore for SqlStore {
    fn path(&self) -> &Path {
        &self.path
    }

    fn is_file(&self) -> bool {
        self.kind == DatabaseKind::Sqlite
    }

    fn chosen_run(&self) -> Option<i64> {
        self.chosen
    }

    fn choose_run(&mut self, run: i64) {
        self.chosen = Some(run);
    }

    fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError> {
        let run = SqlStore::create_run(self, new)?;
        self.chosen = Some(run);
        Ok(run)
    }

    fn newest_run(&mut self) -> Result<Option<RunInfo>, StoreError> {
        self.snapshot(SqlStore::newest_run)
    }

    fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError> {
        self.snapshot(|store| SqlStore::runs_of(store, arm))
    }

    fn find_run(&mut self, run: i64) -> Result<Option<RunInfo>, StoreError> {
        self.snapshot(|store| store.info_of(run))
    }

    fn past(&mut self, arm: &str) -> Result<Vec<StoredPast>, StoreError> {
        self.snapshot(|store| store.past_at_once(arm))
    }

    fn read_run(&mut self, run: i64) -> Result<StoredRun, StoreError> {
        self.snapshot(|store| store.everything_of(run))
    }

    fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, StoreError> {
        self.chosen = Some(run);
        SqlStore::begin_session(self, run, started_utc)
    }

    fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError> {
        SqlStore::end_session(self, run, session, end)
    }

    fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError> {
        SqlStore::set_state(self, run, state)
    }

    fn put_handshake(&mut self, run: i64, session: i64, handshake: i64, nonce: u32) -> Result<(), StoreError> {
        SqlStore::put_handshake(self, run, session, handshake, nonce)
    }

    fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        SqlStore::append(self, run, events)
    }

    fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        SqlStore::rewrite(self, run, events)
    }

    fn forget_after(&mut self, run: i64, session: i64, last: i64) -> Result<(), StoreError> {
        SqlStore::forget_after(self, run, session, last)
    }

    fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), StoreError> {
        SqlStore::reject_pose(self, run, sphere, pose, reason)
    }

    fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError> {
        SqlStore::put_laser(self, run, shots)
    }

    fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError> {
        SqlStore::put_result(self, run, name, json)
    }

    fn verify(&mut self) -> Result<(), StoreError> {
        match self.damage()?.into_iter().next() {
            None => Ok(()),
            Some(damage) => Err(StoreError::Damaged {
                path: self.path.clone(),
                what: format!("run {}: {}", damage.run, damage.what),
            }),
        }
    }

    fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, StoreError> {
        self.snapshot(|store| SqlStore::result(store, run, name))
    }
}

impl SqlStore {
    /// Reads one state of the database: another program may be writing at the same time, and rows and
    /// their digests belong together.
    pub(super) fn snapshot<T>(
        &mut self,
        read: impl FnOnce(&mut Self) -> Result<T, StoreError>,
    ) -> Result<T, StoreError> {
        if self.reading {
            return read(self);
        }
        self.execute(match self.kind {
            DatabaseKind::Sqlite => "BEGIN",
            DatabaseKind::Postgres => "BEGIN ISOLATION LEVEL REPEATABLE READ, READ ONLY",
        })?;
        self.reading = true;
        let found = read(self);
        self.reading = false;
        let ended = self.execute("ROLLBACK");
        let found = found?;
        ended?;
        Ok(found)
    }

    fn execute(&mut self, statement: &'static str) -> Result<(), StoreError> {
        self.block(async |connection| sqlx::query(statement).execute(connection).await.map(|_| ()))
    }

    fn everything_of(&mut self, run: i64) -> Result<StoredRun, StoreError> {
        self.require_sound(run, &MEASURED)?;
        Ok(StoredRun {
            sessions: self.sessions(run)?,
            spheres: self.spheres(run)?,
            recordings: self.recordings(run)?,
            rejected: self.rejected(run)?,
            contacts: self.contacts(run)?,
            couplings: self.couplings(run)?,
            phases: self.phases(run)?,
            faults: self.faults(run)?,
            laser: self.laser(run)?,
            handshakes: self.handshakes(run)?,
        })
    }
}
