//! What the application needs of a board: a drive, a host and a clock.
//!
//! All calls except [`Clock::next_tick`] return at once. Bounded queues stand
//! behind them. A value that does not fit is dropped and counted by the owner
//! of the queue; nothing waits for room.

use embassy_time::{Duration, Instant};
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage};

/// The drive, as the control task sees it.
pub trait DrivePort {
    /// The next message of the drive; `None` when there is no other yet. A state
    /// may be left out when a newer one has come.
    fn next_message(&mut self) -> Option<DriveMessage>;

    /// Sends a torque command.
    fn send(&mut self, command: &DriveCommand);

    /// Whether the drive is gone for good (a simulator that has finished).
    fn has_ended(&self) -> bool {
        false
    }
}

/// What starts the control cycles.
pub trait Clock {
    /// Called once, when the control task starts.
    fn start(&mut self) {}

    /// Sets the control period: called after every tick. A clock that follows the
    /// drive ignores it.
    fn set_period(&mut self, _period: Duration) {}

    /// Waits for the next tick.
    fn next_tick(&mut self) -> impl Future<Output = Tick>;

    /// Device time that the control path is given for `tick`. `drive_us` is the
    /// drive's own time of its last state, in µs.
    fn device_time(&self, tick: &Tick, drive_us: u64) -> Instant;
}

/// The start of a control cycle.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Tick {
    /// When it started.
    pub at: Instant,
    /// Control periods before it that passed without a tick.
    pub missed: u32,
}

/// Measures the cost of a tick from inside the control task.
///
/// The default does nothing and compiles to nothing.
pub trait Probe {
    /// Called before the host's commands and the control law run.
    fn before_tick(&mut self) {}
    /// Called after they have run.
    fn after_tick(&mut self) {}
}

impl Probe for () {}
