//! What the application needs of a board.
//!
//! All calls but [`Clock::next`] return at once: queues of bounded length stand
//! behind them, and what does not fit is dropped and counted by whoever owns
//! the queue, never waited for.

use embassy_time::Instant;
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::host::{Command, Event, Sample, Statistics};

use super::FromDrive;
use crate::link::Verdict;

/// The drive's end.
pub trait DrivePort {
    /// The next message of the drive; `None` when no more have come. States
    /// that were overtaken by newer ones may be left out.
    fn receive(&mut self) -> Option<FromDrive>;

    /// Sends a torque command.
    fn send(&mut self, command: &DriveCommand);

    /// Whether the drive has gone for good (a simulator that has finished).
    fn ended(&self) -> bool {
        false
    }
}

/// The host's end, behind the host link: typed values, no bytes.
pub trait HostPort {
    /// Whether the host was heard since this was asked last.
    fn heard(&mut self) -> bool;

    /// Shows `take` the next command and forgets it: its number, the device time
    /// at which it is to start (µs, 0 for at once), and what to do. `false` when
    /// there was none. By reference: the largest command takes 2 kB.
    fn command(&mut self, take: &mut impl FnMut(u32, u64, &Command)) -> bool;

    /// Says what became of a command.
    fn verdict(&mut self, verdict: Verdict);

    /// Takes events from `next` as long as there is room.
    fn events(&mut self, next: &mut impl FnMut() -> Option<Event>);

    /// Takes samples from `next` as long as there is room.
    fn samples(&mut self, next: &mut impl FnMut() -> Option<Sample>);

    /// The tick that was told `now` is over, and all that it had to say is said.
    fn ticked(&mut self, now: Instant, statistics: Statistics);
}

/// The beat of the control period.
pub trait Clock {
    /// Waits for the next beat.
    fn next(&mut self) -> impl Future<Output = Beat>;

    /// Time that the control path is told for a tick, where `drive_us` is the
    /// drive's own time of the last state, in µs.
    fn time(&self, beat: &Beat, drive_us: u64) -> Instant;
}

/// One beat.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Beat {
    /// When it began.
    pub at: Instant,
    /// Control periods that went by without a tick before it.
    pub missed: u32,
}

/// Looks into the control task: what a tick costs.
///
/// The default does nothing and compiles to nothing.
pub trait Probe {
    /// The host's commands and the control law are about to run.
    fn before_tick(&mut self) {}
    /// They have run.
    fn after_tick(&mut self) {}
}

impl Probe for () {}
