//! The queues between the control task and the host link.
//!
//! ```text
//!   HostLink ─▶ commands ──────────────────▶ ControlSide ─▶ Controller
//!   HostLink ◀─ outcomes, events, samples, statistics ◀─┘
//! ```
//!
//! The control task handles typed values. The link tasks encode and decode them
//! at lower priority. Each queue has one writer and one reader and no lock, so
//! neither side delays the other. A value that does not fit stays with its owner
//! or is counted.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use heapless::spsc::{Consumer, Producer, Queue};
use spherecal_shared::protocol::host::{Command, CycleCost, Sample, Statistics};

use crate::Report;
use crate::link::{CommandOutcome, CommandPort};

/// A whole sample of telemetry credit.
const MILLION: u64 = 1_000_000;

// A queue of n places holds n - 1 values.
/// Places for commands that wait for a tick.
const COMMANDS: usize = 5;
/// Places for outcomes of commands that wait for the link.
const OUTCOMES: usize = 9;
/// Places for events that wait for the link.
const REPORTS: usize = 9;
/// Places for telemetry samples that wait for the link.
const SAMPLES: usize = 33;

/// What the control task reports at the end of a tick: of the [`Statistics`] only what the
/// control path counts. Interrupts wait while it is copied, so it is small.
#[derive(Clone, Copy, Debug)]
struct TickReport {
    /// Device time that the control path was given.
    now: Instant,
    ticks: u64,
    missed: u32,
    late: u32,
    overflow: u32,
    simulated: bool,
    cost: CycleCost,
}

/// The queues between control task and host link.
#[derive(Debug, Default)]
pub struct Mailbox {
    commands: Queue<(u32, u64, Command), COMMANDS>,
    outcomes: Queue<CommandOutcome, OUTCOMES>,
    reports: Queue<Report, REPORTS>,
    samples: Queue<Sample, SAMPLES>,
}

/// What both sides of a [`Mailbox`] share besides the queues.
pub struct MailboxSignal<M: RawMutex> {
    heard: AtomicBool,
    dropped: AtomicU32,
    period_us: AtomicU32,
    samples_per_s: AtomicU32,
    ticked: Signal<M, TickReport>,
}

impl<M: RawMutex> Default for MailboxSignal<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: RawMutex> MailboxSignal<M> {
    /// The state before the first tick and the first byte of the host.
    pub const fn new() -> Self {
        Self {
            heard: AtomicBool::new(false),
            dropped: AtomicU32::new(0),
            period_us: AtomicU32::new(1000),
            samples_per_s: AtomicU32::new(u32::MAX),
            ticked: Signal::new(),
        }
    }

    /// Outcomes of commands that found no room.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl Mailbox {
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            commands: Queue::new(),
            outcomes: Queue::new(),
            reports: Queue::new(),
            samples: Queue::new(),
        }
    }

    /// The control task's side and the host link's side.
    pub fn split<'a, M: RawMutex>(&'a mut self, signal: &'a MailboxSignal<M>) -> (ControlSide<'a, M>, LinkSide<'a, M>) {
        let (command_in, command_out) = self.commands.split();
        let (outcome_in, outcome_out) = self.outcomes.split();
        let (report_in, report_out) = self.reports.split();
        let (sample_in, sample_out) = self.samples.split();
        let control = ControlSide {
            commands: command_out,
            outcomes: outcome_in,
            reports: report_in,
            samples: sample_in,
            credit: 0,
            signal,
        };
        let link = LinkSide {
            commands: command_in,
            outcomes: outcome_out,
            reports: report_out,
            samples: sample_out,
            signal,
            report: None,
        };
        (control, link)
    }
}

/// The control task's side of a [`Mailbox`]: typed values of the host, no bytes.
pub struct ControlSide<'a, M: RawMutex> {
    commands: Consumer<'a, (u32, u64, Command)>,
    outcomes: Producer<'a, CommandOutcome>,
    reports: Producer<'a, Report>,
    samples: Producer<'a, Sample>,
    /// Millionths of a sample that the host link has room for.
    credit: u64,
    signal: &'a MailboxSignal<M>,
}

impl<M: RawMutex> ControlSide<'_, M> {
    /// Whether anything has come from the host since the last call.
    pub fn was_heard(&mut self) -> bool {
        self.signal.heard.swap(false, Ordering::Relaxed)
    }

    /// Calls `take` with the next command and removes it. The arguments are the
    /// command's number, the device time at which it starts (µs, 0 for at once)
    /// and the command. Returns `false` when there was none. The command is
    /// passed by reference because the largest takes 2 kB.
    pub fn with_next_command(&mut self, take: &mut impl FnMut(u32, u64, &Command)) -> bool {
        let Some((sequence, start_us, command)) = self.commands.peek() else {
            return false;
        };
        take(*sequence, *start_us, command);
        self.commands.dequeue();
        true
    }

    /// Reports whether a command was accepted.
    pub fn report_outcome(&mut self, outcome: CommandOutcome) {
        if self.outcomes.enqueue(outcome).is_err() {
            // The host gets no answer and repeats the command.
            self.signal.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    /// Takes events from `next` while there is room.
    pub fn send_reports(&mut self, next: &mut impl FnMut() -> Option<Report>) {
        while self.reports.ready()
            && let Some(report) = next()
        {
            // There is room: only this side fills the queue.
            let _ = self.reports.enqueue(report);
        }
    }

    /// Takes telemetry samples from `next` while there is room.
    pub fn send_samples(&mut self, next: &mut impl FnMut() -> Option<Sample>) {
        let rate = u64::from(self.signal.samples_per_s.load(Ordering::Relaxed));
        let period_us = u64::from(self.signal.period_us.load(Ordering::Relaxed));
        let most = MILLION.max(rate.saturating_mul(period_us));
        self.credit = self.credit.saturating_add(rate.saturating_mul(period_us)).min(most);
        while self.samples.ready()
            && let Some(sample) = next()
        {
            if self.credit >= MILLION {
                self.credit -= MILLION;
                let _ = self.samples.enqueue(sample);
            }
        }
    }

    /// States the control period, in µs.
    pub fn set_period(&mut self, period_us: u32) {
        self.signal.period_us.store(period_us, Ordering::Relaxed);
    }

    /// Ends a tick: its events and samples have been sent. `now` is the device
    /// time that the control path was given.
    pub fn finish_tick(&mut self, now: Instant, statistics: Statistics) {
        self.signal.ticked.signal(TickReport {
            now,
            ticks: statistics.ticks,
            missed: statistics.missed,
            late: statistics.late,
            overflow: statistics.link.overflow,
            simulated: statistics.simulated,
            cost: statistics.cost,
        });
    }
}

/// The host link's side of a [`Mailbox`].
pub struct LinkSide<'a, M: RawMutex> {
    commands: Producer<'a, (u32, u64, Command)>,
    outcomes: Consumer<'a, CommandOutcome>,
    reports: Consumer<'a, Report>,
    samples: Consumer<'a, Sample>,
    signal: &'a MailboxSignal<M>,
    report: Option<TickReport>,
}

impl<M: RawMutex> LinkSide<'_, M> {
    /// Passes on at most `samples_per_s` telemetry samples per second, evenly spaced; the
    /// others are left out. Without this call all pass.
    pub fn limit_samples(&mut self, samples_per_s: u32) {
        self.signal.samples_per_s.store(samples_per_s, Ordering::Relaxed);
    }

    /// Waits for the end of a tick; returns the device time that the control
    /// path was given.
    pub async fn tick_finished(&mut self) -> Instant {
        let report = self.signal.ticked.wait().await;
        self.report = Some(report);
        report.now
    }
}

impl<M: RawMutex> CommandPort for LinkSide<'_, M> {
    fn host_heard(&mut self) {
        self.signal.heard.store(true, Ordering::Relaxed);
    }

    fn queue_command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool {
        self.commands.enqueue((sequence, start_us, command)).is_ok()
    }

    fn command_outcome(&mut self) -> Option<CommandOutcome> {
        self.outcomes.dequeue()
    }

    fn next_report(&mut self) -> Option<Report> {
        self.reports.dequeue()
    }

    fn samples_waiting(&self) -> usize {
        self.samples.len()
    }

    fn next_sample(&mut self) -> Option<Sample> {
        self.samples.dequeue()
    }

    fn period_us(&self) -> u32 {
        self.signal.period_us.load(Ordering::Relaxed)
    }

    fn statistics(&self) -> Statistics {
        let mut statistics = Statistics::default();
        if let Some(report) = &self.report {
            statistics.ticks = report.ticks;
            statistics.missed = report.missed;
            statistics.late = report.late;
            statistics.simulated = report.simulated;
            statistics.cost = report.cost;
            statistics.link.overflow = report.overflow;
        }
        statistics.link.overflow = statistics.link.overflow.saturating_add(self.signal.dropped());
        statistics
    }
}
