//! Commands that wait for their time.
//!
//! The host counts a command's start from the event that made it decide, with
//! time to spare for repeats; so the arm does the same at the same tick, however
//! long the frames took. One command waits at most: a newer one takes its place.

use heapless::Deque;
use spherecal_shared::protocol::host::{Command, Refusal, START_MOST_US};

use super::Controller;
use crate::link::CommandOutcome;

/// Verdicts that wait for the host link, at most.
const OUTCOMES: usize = 8;

/// A command and when it is to be carried out.
#[derive(Clone, Debug)]
struct Held {
    sequence: u32,
    start_us: u64,
    command: Command,
}

/// What waits: one command, and the verdicts on those before it.
#[derive(Clone, Debug, Default)]
pub(super) struct Schedule {
    held: Option<Held>,
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
    /// Takes command number `sequence`, to be carried out at the first tick that
    /// is told `start_us` (device time, in µs) or later; at once where it is 0.
    /// `false` when verdicts were not fetched and there is no room for another:
    /// nothing has changed then.
    pub fn queue_command(&mut self, sequence: u32, start_us: u64, command: &Command) -> bool {
        if self.schedule.outcomes.is_full() {
            return false;
        }
        self.schedule.held = None;
        if start_us == 0 {
            self.host_heard();
            let result = self.start(command);
            self.record_outcome(sequence, result);
        } else if start_us > self.now_us.saturating_add(START_MOST_US) {
            self.record_outcome(sequence, Err(Refusal::Start));
        } else {
            self.schedule.held = Some(Held {
                sequence,
                start_us,
                command: command.clone(),
            });
        }
        true
    }

    /// What became of the oldest command whose verdict was not asked for yet.
    pub fn command_outcome(&mut self) -> Option<CommandOutcome> {
        self.schedule.outcomes.pop_front()
    }

    /// Carries out the command that waits, if its time has come.
    pub(super) fn start_due_command(&mut self) {
        if self
            .schedule
            .held
            .as_ref()
            .is_none_or(|held| held.start_us > self.now_us)
        {
            return;
        }
        let Some(held) = self.schedule.held.take() else { return };
        let period_us = (self.period_s * 1e6) as u64;
        if self.now_us.saturating_sub(held.start_us) >= period_us.max(1) {
            self.schedule.late = self.schedule.late.saturating_add(1);
        }
        let result = self.start(&held.command);
        self.record_outcome(held.sequence, result);
    }

    fn record_outcome(&mut self, sequence: u32, result: Result<(), Refusal>) {
        // There is room: no command is taken without.
        let _ = self.schedule.outcomes.push_back(CommandOutcome { sequence, result });
    }
}
