//! The main job: calibrates one robot from sphere contacts and judges it by a laser tracker.
//!
//! ```text
//!   Config ─▶ prepare ─▶ measure ───────────────▶ evaluate ─▶ write
//!            plan        campaign, laser shots    identify,    summary.json,
//!                        (into the store)         validate     calibrated.*, …
//! ```
//!
//! Each arrow is a function of plain data. So the command line can run the steps one at a time, and
//! a service can run them elsewhere. [`evaluate`] sees only the data in the store: no plant, no
//! link. What is simulated is behind the trait [`Simulator`]: the program chooses the simulation.

mod accuracy;
mod certificate;
mod commission;
mod config;
pub mod connect;
mod early_end;
mod error;
mod evaluate;
mod journal;
mod link;
mod measure;
pub mod native;
pub mod new_cell;
mod prepare;
mod prepared;
mod run_report;
pub mod stability;
mod stored;
mod summary;
mod teach;
mod waypoints;
mod write;

pub use accuracy::{EarlyEnding, ask_accuracy};
pub use certificate::study_certificate;
pub use commission::{Commissioning, commission, commissionings};
pub use config::{
    CellSection, CertificateSection, Choice, Config, ConfigError, DEFAULT_PRESET, DriveSection, LaserSection,
    PlanSection, ToolSection,
};
pub use connect::connect_early;
pub use error::JobError;
pub use evaluate::{Measurements, evaluate};
pub use journal::{StoreJournal, run_telemetry, store_error};
pub use link::{Link, LinkRecord, UnknownLink};
pub use measure::{MeasuredRun, Site, check_tracker, create_run, measure, read};
pub use prepare::{at_home, check_reach, loaded_model, prepare, recalled};
pub use prepared::{ConnectedDevice, Connection, FaultyJournal, PreparedRun, Simulator};
pub use run_report::run_report;
pub use spherecal_identify::{Evaluation, Verdict};
pub use stored::{StoredReport, contact_traces, open_store, put_contact_traces, stored_report};
pub use summary::{LinkSummary, ModelSummary, PoseCounts, Summary, summarise};
pub use teach::{impedance, teach};
pub use waypoints::{TaughtWaypoint, TaughtWaypoints};
pub use write::write;
