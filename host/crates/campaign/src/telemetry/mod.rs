//! The control loop's samples for people: an MCAP file that Foxglove and
//! PlotJuggler open, and the force trace of every contact.
//!
//! Stands beside the campaign as one more [`Observer`](crate::Observer):
//! what comes from the controller passes by and is written down; nothing goes
//! back. A file that cannot be written never stops a measurement.

mod recorder;
mod writer;

pub use recorder::{TelemetryRecorder, Trace};
pub use writer::{TelemetryError, TelemetrySample, TelemetryWriter};
