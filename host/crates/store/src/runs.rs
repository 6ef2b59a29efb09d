//! Reads the list of runs, and the sessions of each run.

use std::collections::BTreeMap;

use sqlx::any::AnyRow;

use super::seal::RUNS;
use super::{NewRun, SessionEnd, SqlStore, StoreError, digest};

/// A run, without its data.
#[derive(Clone, Debug, PartialEq)]
pub struct RunInfo {
    /// Number.
    pub run: i64,
    /// `running`, `measured` or `complete`; [`Self::COMMISSIONED`].
    pub state: String,
    /// What was known before its first event. The plate and the poses are read with its data.
    pub about: NewRun,
}

impl RunInfo {
    /// State of a run that is no calibration: the first run on a robot, step by step.
    pub const COMMISSIONED: &'static str = "commissioned";

    /// Every state that a run can have.
    pub const STATES: [&'static str; 4] = ["running", "measured", "complete", Self::COMMISSIONED];

    /// Whether the run is a calibration.
    pub fn is_calibration(&self) -> bool {
        self.state != Self::COMMISSIONED
    }
}

impl SqlStore {
    /// The runs of one arm, or of all if `arm` is empty; oldest first.
    pub(super) fn runs_of(&mut self, arm: &str) -> Result<Vec<RunInfo>, StoreError> {
        let rows = self.block(async |connection| {
            sqlx::query("SELECT * FROM runs WHERE $1 = '' OR arm = $1 ORDER BY run")
                .bind(arm)
                .fetch_all(connection)
                .await
        })?;
        rows.iter().map(|row| self.run_info(row)).collect()
    }

    pub(super) fn info_of(&mut self, run: i64) -> Result<Option<RunInfo>, StoreError> {
        let rows = self.rows("SELECT * FROM runs WHERE run = $1", run)?;
        rows.first().map(|row| self.run_info(row)).transpose()
    }

    /// The digest of a run's settings as they are stored; `None` if there is no such run.
    pub(super) fn settings_digest(&mut self, run: i64) -> Result<Option<i64>, StoreError> {
        let rows = self.rows("SELECT * FROM runs WHERE run = $1", run)?;
        rows.first().map(|row| self.digest_of_settings(row)).transpose()
    }

    fn digest_of_settings(&mut self, row: &AnyRow) -> Result<i64, StoreError> {
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
        Ok(digest::of_run(seed, texts, &spheres))
    }

    pub(super) fn run_info(&mut self, row: &AnyRow) -> Result<RunInfo, StoreError> {
        let run: i64 = self.get(row, "run")?;
        let seed = self.get::<i64>(row, "seed")? as u64;
        let digest = self.digest_of_settings(row)?;
        self.compare(run, "run", digest, "the run's settings")?;
        self.require_sound(run, &[RUNS])?;
        Ok(RunInfo {
            run,
            state: self.get(row, "state")?,
            about: NewRun {
                created_utc: self.get(row, "created_utc")?,
                seed,
                link: self.get(row, "link")?,
                robot: self.json(row, "robot_json")?,
                tool: self.json(row, "tool_json")?,
                config_toml: self.get(row, "config_toml")?,
                plan_json: self.get(row, "plan_json")?,
                program: self.get(row, "program")?,
                spheres: Vec::new(),
                poses: Vec::new(),
                arm: self.get(row, "arm")?,
            },
        })
    }

    /// The nonces under which the sessions of a run started a handshake with the controller, with
    /// session and handshake number.
    pub(super) fn handshakes(&mut self, run: i64) -> Result<BTreeMap<u32, (i64, i64)>, StoreError> {
        let rows = self.rows("SELECT * FROM greetings WHERE run = $1", run)?;
        rows.iter()
            .map(|row| {
                let place = (self.get(row, "session")?, self.get(row, "greeting")?);
                Ok((self.count(row, "nonce")?, place))
            })
            .collect()
    }

    /// Sessions of a run, oldest first.
    pub(super) fn sessions(&mut self, run: i64) -> Result<Vec<SessionEnd>, StoreError> {
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
}
