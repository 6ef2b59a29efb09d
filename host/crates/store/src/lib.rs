//! The store: writes every recording, contact and fault as it arrives.
//!
//! Vocabulary: a *run* is one calibration. A *session* is one program that worked on it; a resumed
//! run has several. An *event* is what the controller numbers.
//!
//! ```text
//!   HostEndpoint ─ batch of events ─▶ Journal::append ─ commit, fsync ─▶ acknowledged
//!   identify, validate, report ◀─────── SqlCalibrationStore::read_run ◀─────┘
//! ```
//!
//! SQLite runs in write-ahead mode with a synchronous commit, so acknowledged data survive a kill
//! and a power cut. A recording is keyed by run, sphere and pose. Every other event is keyed by its
//! host link session and its number there. So a repeated event is not stored again. The schema
//! (`migrations/`) and the statements use only what SQLite and PostgreSQL share. A store is a file,
//! a PostgreSQL database, or the service of another machine ([`StoreLocation`]). Each of them is a
//! [`CalibrationStore`]; the first two are here ([`SqlStore`]). Older schemas are migrated when
//! they are opened; newer ones are refused.
//!
//! While another program reads the file, the log keeps what was acknowledged; how much it is then
//! stands beside the file (`acknowledged.rs`).
//!
//! A file is checked before anything is written to it. A damaged file is left unchanged;
//! [`recover`] copies its readable data into a new one.

mod acknowledged;
mod calibration_store;
mod columns;
mod digest;
mod error;
mod events;
mod file;
mod fleet;
pub mod history;
mod location;
mod lock;
mod log;
mod open;
mod past;
mod read;
mod recover;
mod runs;
mod seal;
mod spares;
mod sql;
pub mod time;
mod write;

use std::path::PathBuf;

use spherecal_shared::robot::{Robot, Tool};
use sqlx::AnyConnection;
use tokio::runtime::Runtime;

pub use calibration_store::{CalibrationStore, StoredRun};
pub use error::{Damage, StoreError};
pub use events::Placed;
pub use file::SCHEMA_VERSION;
pub use location::{Peer, StoreLocation, UnknownScheme};
pub use lock::Claim;
pub use recover::{Recovered, recover};
pub use runs::RunInfo;
pub use write::SessionEnd;

use spherecal_model::Sphere;

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum DatabaseKind {
    Sqlite,
    #[cfg_attr(not(feature = "postgres"), allow(dead_code, reason = "constructed with the feature"))]
    Postgres,
}

/// The database of calibrations, behind blocking calls.
pub struct SqlStore {
    runtime: Runtime,
    /// Always there until the store is dropped.
    connection: Option<AnyConnection>,
    kind: DatabaseKind,
    /// The file, or the URL without its password.
    path: PathBuf,
    /// Whether commits wait for the disk.
    durable: bool,
    /// Which file it is, to notice that it was replaced.
    identity: Option<(u64, u64)>,
    /// See [`CalibrationStore::chosen_run`].
    chosen: Option<i64>,
    /// Whether a [`snapshot`](Self::snapshot) is being read.
    reading: bool,
    /// Whether a statement of what was [`acknowledged`] lies beside the file.
    stated: bool,
}

/// What is known of a run before its first event.
#[derive(Clone, Debug, PartialEq)]
pub struct NewRun {
    /// When it was begun, UTC, RFC 3339.
    pub created_utc: String,
    /// Seed of the run.
    pub seed: u64,
    /// Link, as given on the command line.
    pub link: String,
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// The whole configuration, as TOML.
    pub config_toml: String,
    /// The whole plan, as JSON.
    pub plan_json: String,
    /// Name and version of the program.
    pub program: String,
    /// The plate's certificate.
    pub spheres: Vec<Sphere>,
    /// Planned poses, in the order of the visits.
    pub poses: Vec<StoredPose>,
    /// Name of the arm: its serial number, or another name that is unique in the fleet.
    pub arm: String,
}

/// One planned pose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct StoredPose {
    /// Id of the sphere.
    pub sphere: u32,
    /// Id of the pose.
    pub pose: u32,
    /// Orientation of FT in F0, unit quaternion w, x, y, z.
    pub orientation: [f64; 4],
    /// Elbow angle, in rad.
    pub elbow_rad: Option<f64>,
}

#[cfg(test)]
thread_local! {
    /// Pieces of database work of this thread so far.
    static STATEMENTS: std::cell::Cell<usize> = const { std::cell::Cell::new(0) };
}

#[cfg(test)]
mod circle_tests;
#[cfg(test)]
mod damage_tests;
#[cfg(all(test, feature = "postgres"))]
mod fleet_tests;
#[cfg(test)]
mod flip_tests;
#[cfg(test)]
mod log_tests;
#[cfg(test)]
mod past_tests;
#[cfg(test)]
mod tests;
