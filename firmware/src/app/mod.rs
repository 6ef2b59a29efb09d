//! The application that a board runs around the control path.
//!
//! [`run`] is the control task. On every tick it takes the newest drive state
//! and the host's commands, runs the control path and passes torque and events
//! on. It sees the board through the traits in [`ports`]: a drive, a host, a
//! clock. A board runs [`run`] in an interrupt executor of high priority, and
//! the tasks of [`links`] and the log below it.
//!
//! ```text
//!   drive bytes ─▶ DriveReceiver ─▶ states ───────┐
//!   host bytes  ─▶ HostLink ─▶ commands ─────────▶├─ run (1 kHz) ─▶ torque ─▶ drive bytes
//!   clock (embassy Ticker, overruns counted) ────▶┘              ─▶ events ─▶ HostLink ─▶ host bytes
//! ```
//!
//! The control task neither frames nor decodes bytes. [`Mailbox`] holds the
//! queues of typed values between it and the host link.

#[macro_use]
mod log;
mod control;
pub mod datagram;
pub mod links;
mod mailbox;
pub mod ports;
pub mod self_test;
mod state_clock;
pub mod supervisor;
mod ticker;

#[cfg(test)]
mod tests;
#[cfg(test)]
mod uart_model;
#[cfg(test)]
mod wire_tests;

pub use control::{ControlState, Ended, run, run_cycle};
pub use mailbox::{ControlSide, LinkSide, Mailbox, MailboxSignal};
pub use state_clock::{StateClock, StateSchedule};
pub use ticker::{PERIOD, TickerClock};
