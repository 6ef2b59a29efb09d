//! Commands with a start time.
//!
//! The host derives the start of a command from the event that led to it, with some
//! time for repeats. The arm then does the same at the same tick, however long the
//! frames took. At most one command waits; a newer one replaces it.

use heapless::Deque;
use spherecal_shared::protocol::host::{Command, Refusal, START_MOST_US};

use super::Controller;
use crate::link::CommandOutcome;

/// Most outcomes of commands that wait for the host link.
const OUTCOMES: usize = 8;

/// A command and the time at which it starts.
#[derive(Clone, Debug)]
struct WaitingCommand {
    sequence: u32,
    start_us: u64,
    command: Command,
}

/// The waiting command, and the outcomes of those before it.
#[derive(Clone, Debug, Default)]
pub(super) struct Schedule {
    waiting: Option<WaitingCommand>,
    outcomes: Deque<CommandOutcome, OUTCOMES>,
    late: u32,
}

impl Schedule {
    /// Commands that came after their start.
    pub(super) fn late(&self) -> u32 {
        self.late
    }
}

impl<const N: usize> Controller<N> {
    /// Takes command number `sequence`. It starts at the first tick whose device
    /// time is `start_us` (µs) or later; at once if `start_us` is 0. Returns `false`
    /// and changes nothing if there is no room for another outcome.
    pub(crate) fn queue_command(&mut self, sequence: u32, start_us: u64, command: &Command) -> bool {
        if self.schedule.outcomes.is_full() {
            return false;
        }
        self.schedule.waiting = None;
        if start_us == 0 {
            self.host_heard();
            let result = self.start(command);
            self.record_outcome(sequence, result);
        } else if start_us > self.now_us.saturating_add(START_MOST_US) {
            self.record_outcome(sequence, Err(Refusal::Start));
        } else {
            self.schedule.waiting = Some(WaitingCommand {
                sequence,
                start_us,
                command: command.clone(),
            });
        }
        true
    }

    /// The oldest outcome of a command that was not fetched yet.
    pub(crate) fn command_outcome(&mut self) -> Option<CommandOutcome> {
        self.schedule.outcomes.pop_front()
    }

    /// Starts the waiting command if its time has come.
    pub(super) fn start_due_command(&mut self) {
        if self
            .schedule
            .waiting
            .as_ref()
            .is_none_or(|waiting| waiting.start_us > self.now_us)
        {
            return;
        }
        let Some(waiting) = self.schedule.waiting.take() else {
            return;
        };
        let period_us = (self.period_s * 1e6) as u64;
        if self.now_us.saturating_sub(waiting.start_us) >= period_us.max(1) {
            self.schedule.late = self.schedule.late.saturating_add(1);
        }
        let result = self.start(&waiting.command);
        self.record_outcome(waiting.sequence, result);
    }

    fn record_outcome(&mut self, sequence: u32, result: Result<(), Refusal>) {
        // There is room: otherwise the command would not have been taken.
        let _ = self.schedule.outcomes.push_back(CommandOutcome { sequence, result });
    }
}
