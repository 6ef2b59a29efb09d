//! Telemetry for people: an MCAP file that Foxglove and PlotJuggler open, and
//! the force trace of every contact.
//!
//! ```text
//!   Event ─▶ TelemetryRecorder ─┬─▶ Thinning ─▶ TelemetryWriter ─▶ telemetry-run-N.mcap ─▶ TelemetryReader
//!                               └─▶ ContactTracer ─▶ ContactTrace
//! ```
//!
//! The recorder is a [`CampaignObserver`](crate::CampaignObserver) of the campaign: events pass
//! through it, and nothing goes back to the controller. A file that cannot be
//! written never stops a measurement. Writer and reader share the types in [`messages`], [`scene`]
//! and [`log`]. [`files_of_run`] finds the files of a run.

mod contact;
mod files;
pub mod log;
pub mod messages;
mod reader;
mod recorder;
pub mod ros;
pub mod scene;
mod thinning;
mod utc;
mod writer;

pub use contact::ContactTracer;
pub use files::{RunKey, files_of_run};
pub use reader::{Period, TelemetryMessage, TelemetryMessages, TelemetryReader, Torn};
pub use recorder::TelemetryRecorder;
pub use scene::DrawnArm;
pub use spherecal_model::ContactTrace;
pub use utc::Moment;
pub use writer::{TelemetryError, TelemetryWriter};
