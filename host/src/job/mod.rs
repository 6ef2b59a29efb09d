//! The main job: one robot, calibrated from sphere contacts and judged by a
//! laser tracker.
//!
//! ```text
//!   Config ─▶ prepare ─▶ measure ───────────────▶ evaluate ─▶ write
//!            plan, tour  campaign, laser shots    identify,    summary.json,
//!                        (into the store)         validate     calibrated.*, …
//! ```
//!
//! Each arrow is a function of plain data, so that the command line can run
//! them one at a time ([`crate::cli`]) and a service can run them elsewhere.
//! [`evaluate`] sees the store's data only: no plant, no link.

mod bound;
mod config;
mod document;
mod error;
mod evaluate;
mod hold;
mod journal;
mod laser;
mod link;
mod measure;
mod prepare;
mod soak;
mod stored;
mod summary;
mod teach;
mod write;

pub use config::{CampaignSection, Choice, Config, ConfigError, LaserSection, PlanSection};
pub use error::JobError;
pub use evaluate::{Evaluation, LaserReference, Measurements, evaluate};
pub use hold::hold;
pub(crate) use journal::StoreJournal;
pub use laser::{Tracker, measure_laser, simulated_tracker};
pub use link::{Link, device};
pub use measure::{LinkRecord, Measured, Site, measure, now_utc, read};
pub(crate) use measure::{create_run, utc};
pub use prepare::{Prepared, prepare, simulated_drive, tour};
pub use soak::{Hour, Soak, soak};
pub use stored::{StoredReport, contact_traces, put_contact_traces, stored_report};
pub use summary::{LinkSummary, ModelSummary, PoseCounts, Summary, Verdict, summarise};
pub use teach::{TaughtWaypoint, Waypoints, teach};
pub use write::{Files, write};

#[cfg(test)]
mod tests;
