//! What the application needs of a board: a drive, a host and a clock.
//!
//! All calls except [`Clock::next_tick`] return at once. Bounded queues stand
//! behind them. A value that does not fit is dropped and counted by the owner
//! of the queue; nothing waits for room.

use embassy_time::{Duration, Instant};
use spherecal_shared::protocol::drive::{DriveCommand, DriveMessage};
use spherecal_shared::protocol::host::{Command, Sample, Statistics};

use crate::Report;
use crate::link::CommandOutcome;

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

/// The host, as the control task sees it: typed values, no bytes.
pub trait HostPort {
    /// Whether anything has come from the host since the last call.
    fn was_heard(&mut self) -> bool;

    /// Calls `take` with the next command and removes it. The arguments are the
    /// command's number, the device time at which it starts (µs, 0 for at once)
    /// and the command. Returns `false` when there was none. The command is
    /// passed by reference because the largest takes 2 kB.
    fn with_next_command(&mut self, take: &mut impl FnMut(u32, u64, &Command)) -> bool;

    /// Reports whether a command was accepted.
    fn report_outcome(&mut self, outcome: CommandOutcome);

    /// Takes events from `next` while there is room.
    fn send_reports(&mut self, next: &mut impl FnMut() -> Option<Report>);

    /// Takes telemetry samples from `next` while there is room.
    fn send_samples(&mut self, next: &mut impl FnMut() -> Option<Sample>);

    /// States the control period, in µs.
    fn set_period(&mut self, period_us: u32);

    /// Ends a tick: its events and samples have been sent. `now` is the device
    /// time that the control path was given.
    fn finish_tick(&mut self, now: Instant, statistics: Statistics);
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
