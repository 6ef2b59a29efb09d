//! Telemetry for people: an MCAP file that Foxglove and PlotJuggler open, and
//! the force trace of every contact.
//!
//! ```text
//!   Event ─▶ TelemetryRecorder ─┬─▶ messages ─▶ TelemetryWriter ─▶ telemetry.mcap ─▶ TelemetryReader
//!                               └─▶ ContactTracer ─▶ ContactTrace
//! ```
//!
//! The recorder is an [`Observer`](crate::Observer) of the campaign: events pass
//! through it, and nothing goes back to the controller. A file that cannot be
//! written never stops a measurement. Writer and reader share the types in [`messages`], [`scene`]
//! and [`log`].

mod contact;
pub mod log;
pub mod messages;
mod reader;
mod recorder;
pub mod scene;
mod utc;
mod writer;

pub use contact::{ContactTrace, ContactTracer};
pub use reader::{Period, TelemetryReader};
pub use recorder::TelemetryRecorder;
pub use scene::DrawnArm;
pub use utc::Instant;
pub use writer::{TelemetryError, TelemetryWriter};
