//! The control path, as the host link sees it.

use spherecal_shared::protocol::host::{Command, Refusal, Sample, Statistics};

use crate::Report;

/// The outcome of a command: accepted, or refused and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandOutcome {
    /// Number of the command.
    pub sequence: u32,
    /// Whether the command was accepted.
    pub result: Result<(), Refusal>,
}

/// The control path, as the host link sees it.
pub trait CommandPort {
    /// Records that something has come from the host.
    fn host_heard(&mut self);

    /// Takes a command that starts at `start_us` (device time, in µs). `false` if
    /// there is no room: the host sends it again.
    fn queue_command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool;

    /// The oldest outcome of a command that was not fetched yet.
    fn command_outcome(&mut self) -> Option<CommandOutcome>;

    /// The next event for the host.
    fn next_report(&mut self) -> Option<Report>;

    /// Number of telemetry samples that wait.
    fn samples_waiting(&self) -> usize;

    /// The next telemetry sample.
    fn next_sample(&mut self) -> Option<Sample>;

    /// The control period, in µs.
    fn period_us(&self) -> u32;

    /// Counters of the control path; the link adds its own.
    fn statistics(&self) -> Statistics;
}
