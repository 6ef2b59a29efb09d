//! What the application needs of a board.
//!
//! All calls but [`Clock::next`] return at once: queues of bounded length stand
//! behind them, and what does not fit is dropped and counted by whoever owns
//! the queue, never waited for.

use embassy_time::Instant;
use spherecal_shared::protocol::drive::DriveCommand;

use super::FromDrive;

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

/// The host's end: bytes.
pub trait HostPort {
    /// Moves bytes that have come into `buffer`; returns how many.
    fn receive(&mut self, buffer: &mut [u8]) -> usize;

    /// Bytes that [`send`](Self::send) would take now.
    fn room(&self) -> usize;

    /// Sends `bytes`, which are no more than [`room`](Self::room).
    fn send(&mut self, bytes: &[u8]);
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

/// Looks into the control task: what its parts cost, and when it ran.
///
/// The default does nothing and compiles to nothing.
pub trait Probe {
    /// The control law is about to run.
    fn before_tick(&mut self) {}
    /// The control law has run; the host link is next.
    fn between(&mut self) {}
    /// Both have run.
    fn after(&mut self) {}
}

impl Probe for () {}
