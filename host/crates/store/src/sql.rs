//! The SQL database as a [`CalibrationStore`].

use std::path::Path;

use spherecal_model::LaserShot;
use sqlx::AssertSqlSafe;

use super::columns::{put_digest, rows};
use super::events::KnownEvent;
use super::past::StoredPast;
use super::seal::{
    CONTACTS, COUPLINGS, FAULTS, GREETINGS, Key, LASER, PHASES, POSES, RECORDINGS, RESULTS, RUNS, SESSIONS, SPHERES,
    Sealed, forget_removed, seal,
};
use super::{
    CalibrationStore, DatabaseKind, NewRun, Placed, RunInfo, SessionEnd, SqlStore, StoreError, StoredRun, digest,
};

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
        self.snapshot(|store| {
            let rows = store.rows(
                "SELECT * FROM runs WHERE run = (SELECT MAX(run) FROM runs WHERE state <> 'commissioned') AND $1 = $1",
                0,
            )?;
            rows.first().map(|row| store.run_info(row)).transpose()
        })
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
        self.write(async |t| {
            let session: i64 = sqlx::query_scalar("SELECT COALESCE(MAX(session), 0) + 1 FROM sessions WHERE run = $1")
                .bind(run)
                .fetch_one(&mut *t)
                .await?;
            sqlx::query(
                "INSERT INTO sessions (run, session, started_utc, firmware, simulated_us, ticks, wall_s, link_json, \
                 telemetry_json) VALUES ($1, $2, $3, '', 0, 0, 0.0, '{}', '{}')",
            )
            .bind(run)
            .bind(session)
            .bind(started_utc)
            .execute(&mut *t)
            .await?;
            seal(t, &SESSIONS, run, &[Key::Whole(session)]).await?;
            Ok(session)
        })
    }

    fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError> {
        self.write(async |t| {
            sqlx::query(
                "UPDATE sessions SET simulated_us = $3, ticks = $4, wall_s = $5, link_json = $6, telemetry_json = $7, \
                 firmware = $8 WHERE run = $1 AND session = $2",
            )
            .bind(run)
            .bind(session)
            .bind(end.simulated_us as i64)
            .bind(end.ticks as i64)
            .bind(end.wall_s)
            .bind(&end.link_json)
            .bind(&end.telemetry_json)
            .bind(&end.firmware)
            .execute(&mut *t)
            .await?;
            seal(t, &SESSIONS, run, &[Key::Whole(session)]).await
        })
    }

    fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError> {
        // A damaged row must not get a digest that vouches for it.
        self.snapshot(|store| store.require_sound(run, &[RUNS]))?;
        self.write(async |t| {
            sqlx::query("UPDATE runs SET state = $2 WHERE run = $1")
                .bind(run)
                .bind(state)
                .execute(&mut *t)
                .await?;
            seal(t, &RUNS, run, &[]).await
        })
    }

    fn put_handshake(&mut self, run: i64, session: i64, handshake: i64, nonce: u32) -> Result<(), StoreError> {
        self.set_durable(true)?;
        self.write(async |t| {
            sqlx::query(
                "INSERT INTO greetings (run, session, greeting, nonce) VALUES ($1, $2, $3, $4) \
                 ON CONFLICT (run, session, greeting) DO UPDATE SET nonce = excluded.nonce",
            )
            .bind(run)
            .bind(session)
            .bind(handshake)
            .bind(i64::from(nonce))
            .execute(&mut *t)
            .await?;
            seal(t, &GREETINGS, run, &[Key::Whole(session), Key::Whole(handshake)]).await
        })
    }

    fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, KnownEvent::Stays)
    }

    fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, KnownEvent::IsReplaced)
    }

    fn forget_after(&mut self, run: i64, session: i64, last: i64) -> Result<(), StoreError> {
        SqlStore::forget_after(self, run, session, last)
    }

    fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), StoreError> {
        self.write(async |t| {
            sqlx::query("UPDATE poses SET rejected = $4 WHERE run = $1 AND sphere = $2 AND pose = $3")
                .bind(run)
                .bind(i64::from(sphere))
                .bind(i64::from(pose))
                .bind(reason)
                .execute(&mut *t)
                .await?;
            seal(t, &POSES, run, &[Key::Whole(sphere.into()), Key::Whole(pose.into())]).await
        })
    }

    fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError> {
        let digest = digest::of_laser(shots);
        self.write(async |t| {
            sqlx::query("DELETE FROM laser_shots WHERE run = $1")
                .bind(run)
                .execute(&mut *t)
                .await?;
            for (chunk, at) in shots.chunks(500).zip((0i64..).step_by(500)) {
                let statement = rows(
                    "INSERT INTO laser_shots (run, purpose, position, q_json, x_m, y_m, z_m)",
                    chunk.len(),
                    7,
                );
                let mut insert = sqlx::query(AssertSqlSafe(statement));
                for (shot, position) in chunk.iter().zip(at..) {
                    // A vector of floats always encodes.
                    let q = serde_json::to_string(&shot.q).unwrap_or_default();
                    insert = insert.bind(run).bind(&shot.purpose).bind(position).bind(q);
                    for value in shot.point_m {
                        insert = insert.bind(value);
                    }
                }
                insert.execute(&mut *t).await?;
            }
            put_digest(&mut *t, run, "laser", digest).await?;
            seal(t, &LASER, run, &[]).await?;
            forget_removed(t, &LASER, run).await
        })
    }

    fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError> {
        self.write(async |t| {
            sqlx::query(
                "INSERT INTO results (run, name, json) VALUES ($1, $2, $3) \
                 ON CONFLICT (run, name) DO UPDATE SET json = excluded.json",
            )
            .bind(run)
            .bind(name)
            .bind(json)
            .execute(&mut *t)
            .await?;
            seal(t, &RESULTS, run, &[Key::Text(name)]).await
        })
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
        self.snapshot(|store| {
            store.require_result(run, name)?;
            store.block(async |connection| {
                sqlx::query_scalar("SELECT json FROM results WHERE run = $1 AND name = $2")
                    .bind(run)
                    .bind(name)
                    .fetch_optional(connection)
                    .await
            })
        })
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
