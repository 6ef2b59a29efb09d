//! The controller as an application: what a board runs.
//!
//! A thin shell over the control path. [`run`] is the control task: it waits
//! for the beat of the control period, takes the newest drive state and the
//! host's bytes, ticks, and hands on torque and events. What it needs of a
//! board stands in three small traits ([`ports`]): a drive, a host link and a
//! clock. A board implements them over its UARTs, timers and network, gives
//! [`run`] to an interrupt executor above everything else, and lets links and
//! logging run below it.
//!
//! ```text
//!   drive bytes ─▶ DriveReceiver ─▶ states ───────┐
//!   host bytes  ─▶ HostLink ─▶ commands ─────────▶├─ run (1 kHz) ─▶ torque ─▶ drive bytes
//!   beat (embassy Ticker, overruns watched) ─────▶┘              ─▶ events ─▶ HostLink ─▶ host bytes
//! ```
//!
//! No byte is framed, checked or encoded inside the control task: [`Post`] holds
//! the queues of typed values between it and the host link.

#[macro_use]
mod log;
mod control;
mod drive;
pub mod links;
mod period;
pub mod ports;
mod post;

#[cfg(test)]
mod tests;

pub use control::{Ended, Workspace, run, turn};
pub use drive::{DriveReceiver, FromDrive};
pub use period::{PERIOD, PeriodWatch, TickerClock};
pub use post::{Bell, ControlEnd, LinkEnd, Post, Ticked};
