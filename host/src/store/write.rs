//! Writing: runs, sessions, events, laser shots, results.

use serde::Serialize;
use spherecal_shared::protocol::host::{Contact, Coupled, Event, FaultReport, PhaseChange, Recording};
use sqlx::{AnyConnection, AssertSqlSafe, Connection as _};

use super::digest::{self, recording_subject};
use super::{Kind, LaserShot, NewRun, Store, StoreError};
use crate::link::Arrival;

/// What is known of a session at its end (or so far).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SessionEnd {
    /// Version and build of the firmware.
    pub firmware: String,
    /// Device time worked, in µs.
    pub simulated_us: u64,
    /// Control periods.
    pub ticks: u64,
    /// Time on the wall, in s.
    pub wall_s: f64,
    /// Link statistics, as JSON.
    pub link_json: String,
    /// Telemetry summary, as JSON.
    pub telemetry_json: String,
}

/// An event and where it belongs: the session of the run in which it happened,
/// and a number that it has to itself there.
#[derive(Clone, Copy, Debug)]
pub struct Placed<'a> {
    /// Session of the run.
    pub session: i64,
    /// Number within it.
    pub event: i64,
    /// What happened.
    pub arrival: &'a Arrival,
}

/// What is done with an event that is stored already.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Known {
    /// It stays as it is.
    Stays,
    /// It is written anew.
    IsReplaced,
}

/// Name of a unit variant as serde writes it (`joint_position`).
fn name_of(value: impl Serialize) -> String {
    match serde_json::to_value(value) {
        Ok(serde_json::Value::String(name)) => name,
        _ => String::from("?"),
    }
}

impl Store {
    /// Notes a new run, its plate and its poses; returns its number.
    ///
    /// # Errors
    /// When the database fails.
    pub fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError> {
        let run = match &mut self.remote {
            Some(remote) => remote.create_run(new)?,
            None => self.insert_run(new)?,
        };
        self.own = Some(run);
        Ok(run)
    }

    fn insert_run(&mut self, new: &NewRun) -> Result<i64, StoreError> {
        let kind = self.kind;
        let path = self.path.clone();
        let encode = |field, result: Result<String, serde_json::Error>| {
            result.map_err(|source| StoreError::Decode {
                path: path.clone(),
                field,
                source,
            })
        };
        let robot = encode("robot_json", serde_json::to_string(&new.robot))?;
        let tool = encode("tool_json", serde_json::to_string(&new.tool))?;
        let texts = [
            new.link.as_str(),
            robot.as_str(),
            tool.as_str(),
            new.config_toml.as_str(),
            new.plan_json.as_str(),
        ];
        let mut certificate = new.spheres.clone();
        certificate.sort_by_key(|sphere| sphere.id);
        let digest = digest::of_run(new.seed, texts, &certificate);
        self.block(async |connection| {
            // Several robots may begin at once: the number is taken under a lock.
            let mut t = match kind {
                Kind::Sqlite => connection.begin_with("BEGIN IMMEDIATE").await?,
                Kind::Postgres => connection.begin().await?,
            };
            if kind == Kind::Postgres {
                sqlx::query("LOCK TABLE runs IN SHARE ROW EXCLUSIVE MODE")
                    .execute(&mut *t)
                    .await?;
            }
            let run: i64 = sqlx::query_scalar("SELECT COALESCE(MAX(run), 0) + 1 FROM runs")
                .fetch_one(&mut *t)
                .await?;
            sqlx::query(
                "INSERT INTO runs (run, created_utc, seed, link, robot, robot_json, tool_json, config_toml, \
                 plan_json, program, arm, state) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, 'running')",
            )
            .bind(run)
            .bind(&new.created_utc)
            .bind(new.seed as i64)
            .bind(&new.link)
            .bind(new.robot.name.as_str())
            .bind(&robot)
            .bind(&tool)
            .bind(&new.config_toml)
            .bind(&new.plan_json)
            .bind(&new.program)
            .bind(&new.arm)
            .execute(&mut *t)
            .await?;
            for sphere in &new.spheres {
                let [x, y, z] = sphere.position_m;
                sqlx::query(
                    "INSERT INTO spheres (run, sphere, x_m, y_m, z_m, sigma_m) VALUES ($1, $2, $3, $4, $5, $6)",
                )
                .bind(run)
                .bind(i64::from(sphere.id))
                .bind(x)
                .bind(y)
                .bind(z)
                .bind(sphere.sigma_m)
                .execute(&mut *t)
                .await?;
            }
            for (chunk, at) in new.poses.chunks(500).zip((0i64..).step_by(500)) {
                let statement = rows(
                    "INSERT INTO poses (run, sphere, pose, position, qw, qx, qy, qz, elbow_rad)",
                    chunk.len(),
                    9,
                );
                let mut insert = sqlx::query(AssertSqlSafe(statement));
                for (pose, position) in chunk.iter().zip(at..) {
                    insert = insert
                        .bind(run)
                        .bind(i64::from(pose.sphere))
                        .bind(i64::from(pose.pose))
                        .bind(position);
                    for value in pose.orientation {
                        insert = insert.bind(value);
                    }
                    insert = insert.bind(pose.elbow_rad);
                }
                insert.execute(&mut *t).await?;
            }
            put_digest(&mut t, run, "run", digest).await?;
            t.commit().await?;
            Ok(run)
        })
    }

    /// Begins a session of a run; returns its number.
    ///
    /// # Errors
    /// When the database fails.
    pub fn begin_session(&mut self, run: i64, started_utc: &str) -> Result<i64, StoreError> {
        self.own = Some(run);
        if let Some(remote) = &mut self.remote {
            return Ok(remote.begin_session(run, started_utc)?);
        }
        self.block(async |connection| {
            let mut t = connection.begin().await?;
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
            t.commit().await?;
            Ok(session)
        })
    }

    /// Notes how a session went.
    ///
    /// # Errors
    /// When the database fails.
    pub fn end_session(&mut self, run: i64, session: i64, end: &SessionEnd) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.end_session(run, session, end)?);
        }
        self.block(async |connection| {
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
            .execute(connection)
            .await
            .map(|_| ())
        })
    }

    /// Sets the state of a run: `running`, `measured`, `complete`.
    ///
    /// # Errors
    /// When the database fails.
    pub fn set_state(&mut self, run: i64, state: &str) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.set_state(run, state)?);
        }
        self.block(async |connection| {
            sqlx::query("UPDATE runs SET state = $2 WHERE run = $1")
                .bind(run)
                .bind(state)
                .execute(connection)
                .await
                .map(|_| ())
        })
    }

    /// Writes a batch of events in one transaction. A recording that is already
    /// there is not written again.
    ///
    /// What was measured (recordings, contacts, couplings, faults) is on the
    /// disk when it returns. Phase changes alone survive a kill, and are carried
    /// to the disk by the next such commit: they do not wait for it.
    ///
    /// # Errors
    /// When the database fails; then nothing of the batch is stored.
    pub fn append(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, Known::Stays)
    }

    /// As [`append`](Self::append), but what was stored under the numbers of
    /// these events is written anew, recordings excepted: for a run that is
    /// repeated from its start.
    ///
    /// # Errors
    /// When the database fails; then nothing of the batch is stored.
    pub fn rewrite(&mut self, run: i64, events: &[Placed<'_>]) -> Result<(), StoreError> {
        self.write_events(run, events, Known::IsReplaced)
    }

    fn write_events(&mut self, run: i64, events: &[Placed<'_>], known: Known) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.append(run, events, known == Known::IsReplaced)?);
        }
        let measured = events.iter().any(|placed| {
            matches!(
                placed.arrival.body,
                Event::Recording(_) | Event::Contact(_) | Event::Coupled(_) | Event::Fault(_)
            )
        });
        self.set_durable(measured)?;
        self.block(async |connection| {
            let mut t = connection.begin().await?;
            for placed in events {
                let session = placed.session;
                let key = (run, session, placed.event);
                if known == Known::IsReplaced {
                    for statement in FORGET {
                        sqlx::query(statement)
                            .bind(run)
                            .bind(session)
                            .bind(placed.event)
                            .execute(&mut *t)
                            .await?;
                    }
                }
                match &placed.arrival.body {
                    Event::Phase(phase) => insert_phase(&mut t, key, phase).await?,
                    Event::Contact(contact) => insert_contact(&mut t, key, contact).await?,
                    Event::Coupled(coupled) => insert_coupled(&mut t, key, coupled).await?,
                    Event::Recording(recording) => insert_recording(&mut t, run, session, recording).await?,
                    Event::Fault(fault) => insert_fault(&mut t, key, fault).await?,
                    Event::Banner(_)
                    | Event::Held { .. }
                    | Event::Reply { .. }
                    | Event::Passed { .. }
                    | Event::Telemetry(_)
                    | Event::Statistics(_) => {}
                }
            }
            t.commit().await
        })
    }

    /// Removes the events of a run, recordings excepted, that do not belong to
    /// `session` or came after event `last` of it.
    ///
    /// # Errors
    /// When the database fails.
    pub fn forget_after(&mut self, run: i64, session: i64, last: i64) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.forget_after(run, session, last)?);
        }
        self.block(async |connection| {
            let mut t = connection.begin().await?;
            for statement in FORGET_AFTER {
                sqlx::query(statement)
                    .bind(run)
                    .bind(session)
                    .bind(last)
                    .execute(&mut *t)
                    .await?;
            }
            t.commit().await
        })
    }

    /// Notes under which number (`nonce`) a session greets the controller, as
    /// its greeting number `greeting`.
    ///
    /// # Errors
    /// When the database fails.
    pub fn put_greeting(&mut self, run: i64, session: i64, greeting: i64, nonce: u32) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.put_greeting(run, session, greeting, nonce)?);
        }
        self.set_durable(true)?;
        self.block(async |connection| {
            sqlx::query(
                "INSERT INTO greetings (run, session, greeting, nonce) VALUES ($1, $2, $3, $4) \
                 ON CONFLICT (run, session, greeting) DO UPDATE SET nonce = excluded.nonce",
            )
            .bind(run)
            .bind(session)
            .bind(greeting)
            .bind(i64::from(nonce))
            .execute(connection)
            .await
            .map(|_| ())
        })
    }

    /// Whether the next commits wait for the disk.
    fn set_durable(&mut self, durable: bool) -> Result<(), StoreError> {
        if self.durable != durable {
            let statement = match (self.kind, durable) {
                (Kind::Sqlite, true) => "PRAGMA synchronous = FULL",
                (Kind::Sqlite, false) => "PRAGMA synchronous = NORMAL",
                (Kind::Postgres, true) => "SET synchronous_commit TO on",
                (Kind::Postgres, false) => "SET synchronous_commit TO off",
            };
            self.block(async |connection| sqlx::query(statement).execute(connection).await.map(|_| ()))?;
            self.durable = durable;
        }
        Ok(())
    }

    /// Marks a pose as given up, with the reason.
    ///
    /// # Errors
    /// When the database fails.
    pub fn reject_pose(&mut self, run: i64, sphere: u32, pose: u32, reason: &str) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.reject_pose(run, sphere, pose, reason)?);
        }
        self.block(async |connection| {
            sqlx::query("UPDATE poses SET rejected = $4 WHERE run = $1 AND sphere = $2 AND pose = $3")
                .bind(run)
                .bind(i64::from(sphere))
                .bind(i64::from(pose))
                .bind(reason)
                .execute(connection)
                .await
                .map(|_| ())
        })
    }

    /// Writes laser shots; those of the same purposes that were there are replaced.
    ///
    /// # Errors
    /// When the database fails.
    pub fn put_laser(&mut self, run: i64, shots: &[LaserShot]) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.put_laser(run, shots)?);
        }
        let digest = digest::of_laser(shots);
        self.block(async |connection| {
            let mut t = connection.begin().await?;
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
            put_digest(&mut t, run, "laser", digest).await?;
            t.commit().await
        })
    }

    /// Writes a named result, as JSON; one of the same name is replaced.
    ///
    /// # Errors
    /// When the database fails.
    pub fn put_result(&mut self, run: i64, name: &str, json: &str) -> Result<(), StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.put_result(run, name, json)?);
        }
        self.block(async |connection| {
            sqlx::query(
                "INSERT INTO results (run, name, json) VALUES ($1, $2, $3) \
                 ON CONFLICT (run, name) DO UPDATE SET json = excluded.json",
            )
            .bind(run)
            .bind(name)
            .bind(json)
            .execute(connection)
            .await
            .map(|_| ())
        })
    }

    /// Runs one piece of database work to its end.
    pub(super) fn block<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut AnyConnection) -> Result<T, sqlx::Error>,
    ) -> Result<T, StoreError> {
        let kind = self.kind;
        let failed = |source| match kind {
            Kind::Sqlite => StoreError::of(&self.path, source),
            Kind::Postgres => StoreError::Server {
                url: self.path.display().to_string(),
                source,
            },
        };
        let connection = self
            .connection
            .as_mut()
            .ok_or_else(|| failed(sqlx::Error::WorkerCrashed))?;
        self.runtime.block_on(work(connection)).map_err(failed)
    }
}

type Key = (i64, i64, i64);

/// What is known of one event, recordings excepted.
const FORGET: [&str; 4] = [
    "DELETE FROM phases WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM contacts WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM couplings WHERE run = $1 AND session = $2 AND event = $3",
    "DELETE FROM faults WHERE run = $1 AND session = $2 AND event = $3",
];

/// What does not belong to a session up to an event.
const FORGET_AFTER: [&str; 4] = [
    "DELETE FROM phases WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM contacts WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM couplings WHERE run = $1 AND (session <> $2 OR event > $3)",
    "DELETE FROM faults WHERE run = $1 AND (session <> $2 OR event > $3)",
];

async fn put_digest(t: &mut AnyConnection, run: i64, subject: &str, digest: i64) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO digests (run, subject, digest) VALUES ($1, $2, $3) \
         ON CONFLICT (run, subject) DO UPDATE SET digest = excluded.digest",
    )
    .bind(run)
    .bind(subject)
    .bind(digest)
    .execute(t)
    .await
    .map(|_| ())
}

async fn insert_phase(t: &mut AnyConnection, key: Key, phase: &PhaseChange) -> Result<(), sqlx::Error> {
    sqlx::query(
        "INSERT INTO phases (run, session, event, phase, previous, time_us, tick) VALUES ($1, $2, $3, $4, $5, $6, $7) \
         ON CONFLICT DO NOTHING",
    )
    .bind(key.0)
    .bind(key.1)
    .bind(key.2)
    .bind(name_of(phase.phase))
    .bind(name_of(phase.from))
    .bind(phase.time_us as i64)
    .bind(phase.tick as i64)
    .execute(t)
    .await
    .map(|_| ())
}

async fn insert_contact(t: &mut AnyConnection, key: Key, contact: &Contact) -> Result<(), sqlx::Error> {
    let ([tx, ty, tz], [px, py, pz]) = (contact.tare_n, contact.tcp_m);
    sqlx::query(
        "INSERT INTO contacts (run, session, event, sphere, time_us, force_n, peak_n, tare_x_n, tare_y_n, tare_z_n, \
         tcp_x_m, tcp_y_m, tcp_z_m, travel_m, latency_ticks, early_crossings) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10, $11, $12, $13, $14, $15, $16) ON CONFLICT DO NOTHING",
    )
    .bind(key.0)
    .bind(key.1)
    .bind(key.2)
    .bind(i64::from(contact.sphere))
    .bind(contact.time_us as i64)
    .bind(real(contact.force_n))
    .bind(real(contact.peak_n))
    .bind(real(tx))
    .bind(real(ty))
    .bind(real(tz))
    .bind(real(px))
    .bind(real(py))
    .bind(real(pz))
    .bind(real(contact.travel_m))
    .bind(i64::from(contact.latency_ticks))
    .bind(i64::from(contact.early_crossings))
    .execute(t)
    .await
    .map(|_| ())
}

async fn insert_coupled(t: &mut AnyConnection, key: Key, coupled: &Coupled) -> Result<(), sqlx::Error> {
    let [x, y, z] = coupled.centre_m;
    sqlx::query(
        "INSERT INTO couplings (run, session, event, sphere, time_us, centre_x_m, centre_y_m, centre_z_m, shift_m, \
         test_m) VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT DO NOTHING",
    )
    .bind(key.0)
    .bind(key.1)
    .bind(key.2)
    .bind(i64::from(coupled.sphere))
    .bind(coupled.time_us as i64)
    .bind(real(x))
    .bind(real(y))
    .bind(real(z))
    .bind(real(coupled.shift_m))
    .bind(real(coupled.test_m))
    .execute(t)
    .await
    .map(|_| ())
}

async fn insert_fault(t: &mut AnyConnection, key: Key, fault: &FaultReport) -> Result<(), sqlx::Error> {
    // Value and bound as text: a fault may report a NaN, which columns of numbers cannot hold.
    sqlx::query(
        "INSERT INTO faults (run, session, event, fault, phase, time_us, tick, joint, value, bound) \
         VALUES ($1, $2, $3, $4, $5, $6, $7, $8, $9, $10) ON CONFLICT DO NOTHING",
    )
    .bind(key.0)
    .bind(key.1)
    .bind(key.2)
    .bind(name_of(fault.fault))
    .bind(name_of(fault.phase))
    .bind(fault.time_us as i64)
    .bind(fault.tick as i64)
    .bind(i64::from(fault.joint))
    .bind(format!("{:?}", fault.value))
    .bind(format!("{:?}", fault.limit))
    .execute(t)
    .await
    .map(|_| ())
}

async fn insert_recording(t: &mut AnyConnection, run: i64, session: i64, r: &Recording) -> Result<(), sqlx::Error> {
    let [fx, fy, fz] = r.force_n;
    let inserted = sqlx::query(
        "INSERT INTO recordings (run, sphere, pose, position, session, start_us, end_us, samples, gaps, tcp_spread_m, \
         force_x_n, force_y_n, force_z_n) \
         VALUES ($1, $2, $3, (SELECT COUNT(*) FROM recordings WHERE run = $1), $4, $5, $6, $7, $8, $9, $10, $11, $12) \
         ON CONFLICT DO NOTHING",
    )
    .bind(run)
    .bind(i64::from(r.sphere))
    .bind(i64::from(r.pose))
    .bind(session)
    .bind(r.start_us as i64)
    .bind(r.end_us as i64)
    .bind(i64::from(r.count))
    .bind(i64::from(r.gaps))
    .bind(real(r.tcp_spread_m))
    .bind(real(fx))
    .bind(real(fy))
    .bind(real(fz))
    .execute(&mut *t)
    .await?;
    if inserted.rows_affected() == 0 {
        return Ok(());
    }
    let subject = recording_subject(r.sphere, r.pose);
    put_digest(t, run, &subject, digest::of_recording(r)).await?;
    if r.q.is_empty() || r.tau.is_empty() {
        return Ok(());
    }
    let statement = rows(
        "INSERT INTO recording_joints (run, sphere, pose, joint, q_mean_rad, q_std_rad, q_min_rad, q_max_rad, \
         tau_mean_nm, tau_std_nm, tau_min_nm, tau_max_nm)",
        r.q.len().min(r.tau.len()),
        12,
    );
    let mut insert = sqlx::query(AssertSqlSafe(statement));
    for ((q, tau), joint) in r.q.iter().zip(&r.tau).zip(1i64..) {
        insert = insert
            .bind(run)
            .bind(i64::from(r.sphere))
            .bind(i64::from(r.pose))
            .bind(joint);
        for signal in [q, tau] {
            insert = insert
                .bind(real(signal.mean))
                .bind(real(signal.std))
                .bind(real(signal.min))
                .bind(real(signal.max));
        }
    }
    insert.execute(t).await.map(|_| ())
}

/// A number as it is stored: SQLite keeps no sign of a zero, so no store does,
/// and a run has the same bits in all of them.
fn real(value: f64) -> f64 {
    value + 0.0
}

/// An insertion of so many rows; numbered places are what both databases know.
fn rows(insert: &str, rows: usize, columns: usize) -> String {
    let mut statement = format!("{insert} VALUES ");
    for row in 0..rows {
        statement.push_str(if row == 0 { "(" } else { ", (" });
        for column in 1..=columns {
            let comma = if column == 1 { "" } else { ", " };
            statement.push_str(&format!("{comma}${}", row * columns + column));
        }
        statement.push(')');
    }
    statement
}
