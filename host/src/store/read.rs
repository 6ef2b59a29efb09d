//! Reading: what a run has, in the order in which it came.

use std::collections::{BTreeMap, BTreeSet};

use serde::de::DeserializeOwned;
use spherecal_shared::protocol::host::{
    Contact, Coupled, Fault, FaultReport, Phase, PhaseChange, Recording, SignalStatistics,
};
use spherecal_shared::robot::{Robot, Tool};
use sqlx::Row as _;
use sqlx::any::AnyRow;

use super::digest::{self, recording_subject};
use super::{Kind, LaserShot, SessionEnd, Store, StoreError};
use crate::identify::Sphere;

/// A run, without its data.
#[derive(Clone, Debug, PartialEq)]
pub struct RunInfo {
    /// Number.
    pub run: i64,
    /// When it was begun, UTC, RFC 3339.
    pub created_utc: String,
    /// Seed.
    pub seed: u64,
    /// Link, as on the command line.
    pub link: String,
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// The configuration, as TOML.
    pub config_toml: String,
    /// The plan, as JSON.
    pub plan_json: String,
    /// Program that began it.
    pub program: String,
    /// `running`, `measured` or `complete`.
    pub state: String,
    /// Which arm it was: its serial number, or whatever names it in the fleet.
    pub arm: String,
}

/// What a run has already, for one that goes on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Resumable {
    /// Recorded: sphere and pose.
    pub recorded: BTreeSet<(u32, u32)>,
    /// Given up: sphere, pose.
    pub rejected: BTreeSet<(u32, u32)>,
}

impl Store {
    /// The run that this program has begun or chosen; else the newest.
    ///
    /// # Errors
    /// When the database fails or the run does not decode.
    pub fn last_run(&mut self) -> Result<Option<RunInfo>, StoreError> {
        if let Some(own) = self.own {
            return Ok(self.runs()?.into_iter().find(|info| info.run == own));
        }
        if let Some(remote) = &mut self.remote {
            return Ok(remote.last_run()?);
        }
        let rows = self.rows(
            "SELECT * FROM runs WHERE run = (SELECT MAX(run) FROM runs) AND $1 = $1",
            0,
        )?;
        rows.first().map(|row| self.run_info(row)).transpose()
    }

    /// The newest run of one arm, or of all if `arm` is empty. In a store that
    /// several robots share the arm must be named.
    ///
    /// # Errors
    /// As [`Store::last_run`]; no such run, or no arm named where it must be.
    pub fn require_run_of(&mut self, arm: &str) -> Result<RunInfo, StoreError> {
        let shared = self.remote.is_some() || self.kind == Kind::Postgres;
        if arm.is_empty() && shared {
            return Err(StoreError::Absent {
                path: self.path.clone(),
                what: "may hold the runs of several robots".to_owned(),
                remedy: "say with --arm whose last run is meant",
            });
        }
        if arm.is_empty() {
            return self.require_last_run();
        }
        let found = self.runs_of(arm)?.pop().ok_or_else(|| StoreError::Absent {
            path: self.path.clone(),
            what: format!("holds no run of arm {arm}"),
            remedy: "`spherecal history` lists what there is",
        })?;
        self.own = Some(found.run);
        Ok(found)
    }

    /// The newest run.
    ///
    /// # Errors
    /// As [`Store::last_run`], and when there is none.
    pub fn require_last_run(&mut self) -> Result<RunInfo, StoreError> {
        self.last_run()?.ok_or_else(|| StoreError::Absent {
            path: self.path.clone(),
            what: "holds no run".to_owned(),
            remedy: "begin one with `spherecal run`",
        })
    }

    /// All runs, oldest first.
    ///
    /// # Errors
    /// When the database fails or a run does not decode.
    pub fn runs(&mut self) -> Result<Vec<RunInfo>, StoreError> {
        self.runs_of("")
    }

    /// The runs of one arm, or of all if `arm` is empty; oldest first.
    ///
    /// # Errors
    /// When the database fails or a run does not decode.
    pub fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.runs_of(arm)?);
        }
        let rows = self.block(async |connection| {
            sqlx::query("SELECT * FROM runs WHERE $1 = '' OR arm = $1 ORDER BY run")
                .bind(arm)
                .fetch_all(connection)
                .await
        })?;
        rows.iter().map(|row| self.run_info(row)).collect()
    }

    fn run_info(&mut self, row: &AnyRow) -> Result<RunInfo, StoreError> {
        let run: i64 = self.get(row, "run")?;
        let spheres = self.spheres(run)?;
        let text = |column| self.get::<&str>(row, column);
        let texts = [
            text("link")?,
            text("robot_json")?,
            text("tool_json")?,
            text("config_toml")?,
            text("plan_json")?,
        ];
        let seed = self.get::<i64>(row, "seed")? as u64;
        let digest = digest::of_run(seed, texts, &spheres);
        self.compare(run, "run", digest, "the run's settings")?;
        Ok(RunInfo {
            run,
            created_utc: self.get(row, "created_utc")?,
            seed,
            link: self.get(row, "link")?,
            robot: self.json(row, "robot_json")?,
            tool: self.json(row, "tool_json")?,
            config_toml: self.get(row, "config_toml")?,
            plan_json: self.get(row, "plan_json")?,
            program: self.get(row, "program")?,
            state: self.get(row, "state")?,
            arm: self.get(row, "arm")?,
        })
    }

    /// Under which numbers (nonces) the sessions of a run have greeted the
    /// controller: session and greeting of each.
    ///
    /// # Errors
    /// When the database fails.
    pub fn greetings(&mut self, run: i64) -> Result<BTreeMap<u32, (i64, i64)>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.greetings);
        }
        let rows = self.rows("SELECT * FROM greetings WHERE run = $1", run)?;
        rows.iter()
            .map(|row| {
                let place = (self.get(row, "session")?, self.get(row, "greeting")?);
                Ok((self.count(row, "nonce")?, place))
            })
            .collect()
    }

    /// Whether `digest` is the stored one; older runs have none.
    fn compare(&mut self, run: i64, subject: &str, digest: i64, what: &str) -> Result<(), StoreError> {
        let stored: Option<i64> = self.block(async |connection| {
            sqlx::query_scalar("SELECT digest FROM digests WHERE run = $1 AND subject = $2")
                .bind(run)
                .bind(subject)
                .fetch_optional(connection)
                .await
        })?;
        match stored {
            Some(stored) if stored != digest => Err(StoreError::Damaged {
                path: self.path.clone(),
                what: format!("{what} of run {run} are not what was written"),
            }),
            _ => Ok(()),
        }
    }

    /// Sessions of a run, oldest first.
    ///
    /// # Errors
    /// When the database fails.
    pub fn sessions(&mut self, run: i64) -> Result<Vec<SessionEnd>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.sessions);
        }
        let rows = self.rows("SELECT * FROM sessions WHERE run = $1 ORDER BY session", run)?;
        rows.iter()
            .map(|row| {
                Ok(SessionEnd {
                    firmware: self.get(row, "firmware")?,
                    simulated_us: self.get::<i64>(row, "simulated_us")? as u64,
                    ticks: self.get::<i64>(row, "ticks")? as u64,
                    wall_s: self.get(row, "wall_s")?,
                    link_json: self.get(row, "link_json")?,
                    telemetry_json: self.get(row, "telemetry_json")?,
                })
            })
            .collect()
    }

    /// The plate's certificate.
    ///
    /// # Errors
    /// When the database fails.
    pub fn spheres(&mut self, run: i64) -> Result<Vec<Sphere>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.spheres);
        }
        let rows = self.rows("SELECT * FROM spheres WHERE run = $1 ORDER BY sphere", run)?;
        rows.iter()
            .map(|row| {
                Ok(Sphere {
                    id: self.count(row, "sphere")?,
                    position_m: self.triple(row, ["x_m", "y_m", "z_m"])?,
                    sigma_m: self.get(row, "sigma_m")?,
                })
            })
            .collect()
    }

    /// What is recorded and what was given up.
    ///
    /// # Errors
    /// When the database fails.
    pub fn resumable(&mut self, run: i64) -> Result<Resumable, StoreError> {
        if let Some(remote) = &mut self.remote {
            let read = remote.read(run)?;
            return Ok(Resumable {
                recorded: read.recordings.iter().map(|r| (r.sphere, r.pose)).collect(),
                rejected: read.rejected.into_iter().collect(),
            });
        }
        let recorded = self.rows("SELECT sphere, pose FROM recordings WHERE run = $1", run)?;
        let rejected = self.rows(
            "SELECT sphere, pose FROM poses WHERE run = $1 AND rejected IS NOT NULL",
            run,
        )?;
        let pairs = |rows: &[AnyRow]| {
            rows.iter()
                .map(|row| Ok((self.count(row, "sphere")?, self.count(row, "pose")?)))
                .collect::<Result<BTreeSet<_>, StoreError>>()
        };
        Ok(Resumable {
            recorded: pairs(&recorded)?,
            rejected: pairs(&rejected)?,
        })
    }

    /// Recordings, in the order in which they came.
    ///
    /// # Errors
    /// When the database fails, or one is not what was written.
    pub fn recordings(&mut self, run: i64) -> Result<Vec<Recording>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.recordings);
        }
        let recordings = self.unchecked_recordings(run)?;
        let digests = self.digests(run)?;
        for recording in &recordings {
            let subject = recording_subject(recording.sphere, recording.pose);
            let digest = digest::of_recording(recording);
            if digests.get(&subject).is_some_and(|stored| *stored != digest) {
                return Err(StoreError::Damaged {
                    path: self.path.clone(),
                    what: format!(
                        "the recording of sphere {}, pose {} in run {run} is not what was written",
                        recording.sphere, recording.pose
                    ),
                });
            }
        }
        Ok(recordings)
    }

    /// The digests of a run, by subject.
    pub(super) fn digests(&mut self, run: i64) -> Result<BTreeMap<String, i64>, StoreError> {
        let rows = self.rows("SELECT subject, digest FROM digests WHERE run = $1", run)?;
        rows.iter()
            .map(|row| Ok((self.get(row, "subject")?, self.get(row, "digest")?)))
            .collect()
    }

    /// Recordings as they stand in the file, whether or not that was written.
    pub(super) fn unchecked_recordings(&mut self, run: i64) -> Result<Vec<Recording>, StoreError> {
        let joints = self.rows(
            "SELECT j.* FROM recording_joints j JOIN recordings r \
             ON r.run = j.run AND r.sphere = j.sphere AND r.pose = j.pose \
             WHERE j.run = $1 ORDER BY r.position, j.joint",
            run,
        )?;
        let rows = self.rows("SELECT * FROM recordings WHERE run = $1 ORDER BY position", run)?;
        let mut joints = joints.iter().peekable();
        let mut recordings = Vec::with_capacity(rows.len());
        for row in &rows {
            let mut recording = Recording {
                sphere: self.count(row, "sphere")?,
                pose: self.count(row, "pose")?,
                start_us: self.get::<i64>(row, "start_us")? as u64,
                end_us: self.get::<i64>(row, "end_us")? as u64,
                count: self.count(row, "samples")?,
                gaps: self.count(row, "gaps")?,
                q: heapless::Vec::new(),
                tau: heapless::Vec::new(),
                tcp_spread_m: self.get(row, "tcp_spread_m")?,
                force_n: self.triple(row, ["force_x_n", "force_y_n", "force_z_n"])?,
            };
            while let Some(joint) = joints.peek() {
                if (self.count(joint, "sphere")?, self.count(joint, "pose")?) != (recording.sphere, recording.pose) {
                    break;
                }
                // More joints than the protocol carries cannot have been written.
                let _ = recording.q.push(SignalStatistics {
                    mean: self.get(joint, "q_mean_rad")?,
                    std: self.get(joint, "q_std_rad")?,
                    min: self.get(joint, "q_min_rad")?,
                    max: self.get(joint, "q_max_rad")?,
                });
                let _ = recording.tau.push(SignalStatistics {
                    mean: self.get(joint, "tau_mean_nm")?,
                    std: self.get(joint, "tau_std_nm")?,
                    min: self.get(joint, "tau_min_nm")?,
                    max: self.get(joint, "tau_max_nm")?,
                });
                joints.next();
            }
            recordings.push(recording);
        }
        Ok(recordings)
    }

    /// Contacts, in the order in which they came.
    ///
    /// # Errors
    /// When the database fails.
    pub fn contacts(&mut self, run: i64) -> Result<Vec<Contact>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.contacts);
        }
        let rows = self.rows("SELECT * FROM contacts WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(Contact {
                    sphere: self.count(row, "sphere")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    force_n: self.get(row, "force_n")?,
                    peak_n: self.get(row, "peak_n")?,
                    tare_n: self.triple(row, ["tare_x_n", "tare_y_n", "tare_z_n"])?,
                    tcp_m: self.triple(row, ["tcp_x_m", "tcp_y_m", "tcp_z_m"])?,
                    travel_m: self.get(row, "travel_m")?,
                    latency_ticks: self.count(row, "latency_ticks")?,
                    early_crossings: self.count(row, "early_crossings")?,
                })
            })
            .collect()
    }

    /// Couplings, in the order in which they came.
    ///
    /// # Errors
    /// When the database fails.
    pub fn couplings(&mut self, run: i64) -> Result<Vec<Coupled>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.couplings);
        }
        let rows = self.rows("SELECT * FROM couplings WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(Coupled {
                    sphere: self.count(row, "sphere")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    centre_m: self.triple(row, ["centre_x_m", "centre_y_m", "centre_z_m"])?,
                    shift_m: self.get(row, "shift_m")?,
                    test_m: self.get(row, "test_m")?,
                })
            })
            .collect()
    }

    /// Phase changes, in the order in which they came.
    ///
    /// # Errors
    /// When the database fails or a phase is unknown.
    pub fn phases(&mut self, run: i64) -> Result<Vec<PhaseChange>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.phases);
        }
        let rows = self.rows("SELECT * FROM phases WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                Ok(PhaseChange {
                    phase: self.named::<Phase>(row, "phase")?,
                    from: self.named::<Phase>(row, "previous")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    tick: self.get::<i64>(row, "tick")? as u64,
                })
            })
            .collect()
    }

    /// Faults, in the order in which they came.
    ///
    /// # Errors
    /// When the database fails or a fault is unknown.
    pub fn faults(&mut self, run: i64) -> Result<Vec<FaultReport>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.faults);
        }
        let rows = self.rows("SELECT * FROM faults WHERE run = $1 ORDER BY session, event", run)?;
        rows.iter()
            .map(|row| {
                let number = |field: &'static str| {
                    let text: String = self.get(row, field)?;
                    Ok::<f64, StoreError>(text.parse().unwrap_or(f64::NAN))
                };
                Ok(FaultReport {
                    fault: self.named::<Fault>(row, "fault")?,
                    phase: self.named::<Phase>(row, "phase")?,
                    time_us: self.get::<i64>(row, "time_us")? as u64,
                    tick: self.get::<i64>(row, "tick")? as u64,
                    joint: u8::try_from(self.count(row, "joint")?).unwrap_or(u8::MAX),
                    value: number("value")?,
                    limit: number("bound")?,
                })
            })
            .collect()
    }

    /// Laser shots, in the order in which they were written.
    ///
    /// # Errors
    /// When the database fails or joints do not decode.
    pub fn laser(&mut self, run: i64) -> Result<Vec<LaserShot>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.read(run)?.laser);
        }
        let rows = self.rows("SELECT * FROM laser_shots WHERE run = $1 ORDER BY position", run)?;
        let shots = rows
            .iter()
            .map(|row| {
                Ok(LaserShot {
                    purpose: self.get(row, "purpose")?,
                    q: self.json(row, "q_json")?,
                    point_m: self.triple(row, ["x_m", "y_m", "z_m"])?,
                })
            })
            .collect::<Result<Vec<_>, StoreError>>()?;
        self.compare(run, "laser", digest::of_laser(&shots), "the laser measurements")?;
        Ok(shots)
    }

    /// A named result, as JSON.
    ///
    /// # Errors
    /// When the database fails.
    pub fn result(&mut self, run: i64, name: &str) -> Result<Option<String>, StoreError> {
        if let Some(remote) = &mut self.remote {
            return Ok(remote.result(run, name)?);
        }
        self.block(async |connection| {
            sqlx::query_scalar("SELECT json FROM results WHERE run = $1 AND name = $2")
                .bind(run)
                .bind(name)
                .fetch_optional(connection)
                .await
        })
    }

    fn rows(&mut self, statement: &'static str, run: i64) -> Result<Vec<AnyRow>, StoreError> {
        self.block(async |connection| sqlx::query(statement).bind(run).fetch_all(connection).await)
    }

    fn get<'r, T>(&self, row: &'r AnyRow, column: &'static str) -> Result<T, StoreError>
    where
        T: sqlx::Decode<'r, sqlx::Any> + sqlx::Type<sqlx::Any>,
    {
        row.try_get(column).map_err(|source| StoreError::of(&self.path, source))
    }

    fn count(&self, row: &AnyRow, column: &'static str) -> Result<u32, StoreError> {
        let value = self.get::<i64>(row, column)?;
        u32::try_from(value).map_err(|_| StoreError::Damaged {
            path: self.path.clone(),
            what: format!("{column} is {value}"),
        })
    }

    fn triple(&self, row: &AnyRow, columns: [&'static str; 3]) -> Result<[f64; 3], StoreError> {
        let [x, y, z] = columns;
        Ok([self.get(row, x)?, self.get(row, y)?, self.get(row, z)?])
    }

    fn json<T: DeserializeOwned>(&self, row: &AnyRow, column: &'static str) -> Result<T, StoreError> {
        let text: String = self.get(row, column)?;
        serde_json::from_str(&text).map_err(|source| self.undecodable(column, source))
    }

    fn named<T: DeserializeOwned>(&self, row: &AnyRow, column: &'static str) -> Result<T, StoreError> {
        let text: String = self.get(row, column)?;
        serde_json::from_value(serde_json::Value::String(text)).map_err(|source| self.undecodable(column, source))
    }

    fn undecodable(&self, field: &'static str, source: serde_json::Error) -> StoreError {
        StoreError::Decode {
            path: self.path.clone(),
            field,
            source,
        }
    }
}
