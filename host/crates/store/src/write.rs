//! Writes runs, and runs each piece of database work to its end.

use sqlx::{AnyConnection, AssertSqlSafe, Connection as _, Row as _};

use super::columns::{put_digest, rows};
use super::file::PATIENCE;
use super::lock::identity;
use super::spares::seal_settings;
use super::{DatabaseKind, NewRun, SqlStore, StoreError, digest};

/// What is known of a session at its end, or so far.
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

impl SqlStore {
    /// Stores a new run with its plate and its poses. Returns its number.
    pub(super) fn create_run(&mut self, new: &NewRun) -> Result<i64, StoreError> {
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
        let run = self.block(async |connection| {
            // Several robots may begin at once, so the number is assigned under a lock.
            let mut t = match kind {
                DatabaseKind::Sqlite => connection.begin_with("BEGIN IMMEDIATE").await?,
                DatabaseKind::Postgres => connection.begin().await?,
            };
            if kind == DatabaseKind::Postgres {
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
            seal_settings(&mut t, run, &certificate).await?;
            t.commit().await?;
            Ok(run)
        })?;
        self.settle()?;
        Ok(run)
    }

    /// Whether the next commits wait for the disk.
    pub(super) fn set_durable(&mut self, durable: bool) -> Result<(), StoreError> {
        if self.durable != durable {
            let statement = match (self.kind, durable) {
                (DatabaseKind::Sqlite, true) => "PRAGMA synchronous = FULL",
                (DatabaseKind::Sqlite, false) => "PRAGMA synchronous = NORMAL",
                (DatabaseKind::Postgres, true) => "SET synchronous_commit TO on",
                (DatabaseKind::Postgres, false) => "SET synchronous_commit TO off",
            };
            self.block(async |connection| sqlx::query(statement).execute(connection).await.map(|_| ()))?;
            self.durable = durable;
        }
        Ok(())
    }

    /// Runs one piece of database work to its end.
    pub(super) fn block<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut AnyConnection) -> Result<T, sqlx::Error>,
    ) -> Result<T, StoreError> {
        #[cfg(test)]
        super::STATEMENTS.set(super::STATEMENTS.get() + 1);
        let done = match self.connection.as_mut() {
            Some(connection) => self.runtime.block_on(work(connection)),
            None => Err(sqlx::Error::WorkerCrashed),
        };
        done.map_err(|source| self.failed(source))
    }

    pub(super) fn failed(&self, source: sqlx::Error) -> StoreError {
        match self.kind {
            DatabaseKind::Sqlite => StoreError::of(&self.path, source),
            DatabaseKind::Postgres => StoreError::Server {
                url: self.path.display().to_string(),
                source,
            },
        }
    }

    /// Writes in one transaction, and brings it into the file itself.
    pub(super) fn write<T>(
        &mut self,
        work: impl AsyncFnOnce(&mut AnyConnection) -> Result<T, sqlx::Error>,
    ) -> Result<T, StoreError> {
        let written = self.block(async |connection| {
            let mut t = connection.begin().await?;
            let written = work(&mut t).await?;
            t.commit().await?;
            Ok(written)
        })?;
        self.settle()?;
        Ok(written)
    }

    /// Brings what was committed from the write-ahead log into the file and empties the log. So the
    /// log holds nothing that was acknowledged, and its loss costs nothing. Then checks that the file
    /// is still there.
    ///
    /// While another program reads, the log keeps the commit, which is on the disk there; a later
    /// call empties it. How much was acknowledged is stated beside the file meanwhile.
    pub(super) fn settle(&mut self) -> Result<(), StoreError> {
        if self.kind != DatabaseKind::Sqlite {
            return Ok(());
        }
        let emptied = self.block(async |connection| {
            // A reader is not waited for long: the arm waits for the acknowledgement.
            sqlx::query("PRAGMA busy_timeout = 50")
                .fetch_all(&mut *connection)
                .await?;
            // The first column tells whether a reader prevented it.
            let busy = sqlx::query("PRAGMA wal_checkpoint(TRUNCATE)")
                .fetch_one(&mut *connection)
                .await
                .and_then(|row| row.try_get_unchecked::<i64, _>(0));
            let patience = format!("PRAGMA busy_timeout = {}", PATIENCE.as_millis());
            sqlx::query(AssertSqlSafe(patience)).fetch_all(connection).await?;
            Ok(busy? == 0)
        });
        let emptied = emptied.unwrap_or_else(|error| {
            tracing::warn!(%error, "the write-ahead log was not emptied; nothing is lost");
            false
        });
        if emptied {
            self.withdraw_statement()?;
        } else {
            self.state_acknowledged()?;
        }
        if self.identity.is_some() && identity(&self.path) != self.identity {
            return Err(StoreError::Gone {
                path: self.path.clone(),
            });
        }
        Ok(())
    }
}
