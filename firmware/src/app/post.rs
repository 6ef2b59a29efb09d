//! The queues between the control task and the host link below it.
//!
//! ```text
//!   HostLink ─▶ commands ─────────────▶ ControlEnd ─▶ Controller::command, tick
//!   HostLink ◀─ verdicts, events, samples, counters ◀─┘
//! ```
//!
//! The control task deals in typed values; their bytes (framing, CRC, postcard)
//! are made and read by the links' tasks, at lower priority. Queues have one
//! writer and one reader and no lock, so that neither end holds up the other;
//! what does not fit stays with its owner or is counted.

use core::sync::atomic::{AtomicBool, AtomicU32, Ordering};

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_sync::signal::Signal;
use embassy_time::Instant;
use heapless::spsc::{Consumer, Producer, Queue};
use spherecal_shared::protocol::host::{Command, Event, Sample, Statistics};

use super::ports::HostPort;
use crate::link::{Desk, Verdict};

/// Commands that may wait for a tick, and one free place.
const COMMANDS: usize = 5;
/// Verdicts that may wait for the link, and one free place.
const VERDICTS: usize = 9;
/// Events that may wait for the link, and one free place.
const EVENTS: usize = 9;
/// Samples that may wait for the link, and one free place.
const SAMPLES: usize = 33;

/// What the control path says at the end of every tick.
#[derive(Clone, Copy, Debug)]
pub struct Ticked {
    /// Time that the control path was told.
    pub now: Instant,
    /// Counters of the control path.
    pub statistics: Statistics,
}

/// The queues.
#[derive(Debug, Default)]
pub struct Post {
    commands: Queue<(u32, u64, Command), COMMANDS>,
    verdicts: Queue<Verdict, VERDICTS>,
    events: Queue<Event, EVENTS>,
    samples: Queue<Sample, SAMPLES>,
}

/// What both ends share besides the queues.
pub struct Bell<M: RawMutex> {
    heard: AtomicBool,
    dropped: AtomicU32,
    ticked: Signal<M, Ticked>,
}

impl<M: RawMutex> Default for Bell<M> {
    fn default() -> Self {
        Self::new()
    }
}

impl<M: RawMutex> Bell<M> {
    /// Nothing was heard and nothing has ticked.
    pub const fn new() -> Self {
        Self {
            heard: AtomicBool::new(false),
            dropped: AtomicU32::new(0),
            ticked: Signal::new(),
        }
    }

    /// Verdicts that found no room.
    pub fn dropped(&self) -> u32 {
        self.dropped.load(Ordering::Relaxed)
    }
}

impl Post {
    /// Empty queues.
    pub const fn new() -> Self {
        Self {
            commands: Queue::new(),
            verdicts: Queue::new(),
            events: Queue::new(),
            samples: Queue::new(),
        }
    }

    /// The control task's end and the host link's.
    pub fn split<'a, M: RawMutex>(&'a mut self, bell: &'a Bell<M>) -> (ControlEnd<'a, M>, LinkEnd<'a, M>) {
        let (order, commands) = self.commands.split();
        let (verdicts, verdict) = self.verdicts.split();
        let (events, event) = self.events.split();
        let (samples, sample) = self.samples.split();
        let control = ControlEnd {
            commands,
            verdicts,
            events,
            samples,
            bell,
        };
        let link = LinkEnd {
            commands: order,
            verdicts: verdict,
            events: event,
            samples: sample,
            bell,
            ticked: None,
        };
        (control, link)
    }
}

/// The control task's end.
pub struct ControlEnd<'a, M: RawMutex> {
    commands: Consumer<'a, (u32, u64, Command)>,
    verdicts: Producer<'a, Verdict>,
    events: Producer<'a, Event>,
    samples: Producer<'a, Sample>,
    bell: &'a Bell<M>,
}

impl<M: RawMutex> HostPort for ControlEnd<'_, M> {
    fn heard(&mut self) -> bool {
        self.bell.heard.swap(false, Ordering::Relaxed)
    }

    fn command(&mut self, take: &mut impl FnMut(u32, u64, &Command)) -> bool {
        let Some((sequence, start_us, command)) = self.commands.peek() else {
            return false;
        };
        take(*sequence, *start_us, command);
        self.commands.dequeue();
        true
    }

    fn verdict(&mut self, verdict: Verdict) {
        if self.verdicts.enqueue(verdict).is_err() {
            // Without an answer the host asks again.
            self.bell.dropped.fetch_add(1, Ordering::Relaxed);
        }
    }

    fn events(&mut self, next: &mut impl FnMut() -> Option<Event>) {
        while self.events.ready()
            && let Some(event) = next()
        {
            // There is room: only this end fills the queue.
            let _ = self.events.enqueue(event);
        }
    }

    fn samples(&mut self, next: &mut impl FnMut() -> Option<Sample>) {
        while self.samples.ready()
            && let Some(sample) = next()
        {
            let _ = self.samples.enqueue(sample);
        }
    }

    fn ticked(&mut self, now: Instant, statistics: Statistics) {
        self.bell.ticked.signal(Ticked { now, statistics });
    }
}

/// The host link's end.
pub struct LinkEnd<'a, M: RawMutex> {
    commands: Producer<'a, (u32, u64, Command)>,
    verdicts: Consumer<'a, Verdict>,
    events: Consumer<'a, Event>,
    samples: Consumer<'a, Sample>,
    bell: &'a Bell<M>,
    ticked: Option<Ticked>,
}

impl<M: RawMutex> LinkEnd<'_, M> {
    /// Waits for the end of a tick; returns the time that it was told.
    pub async fn ticked(&mut self) -> Instant {
        let ticked = self.bell.ticked.wait().await;
        self.ticked = Some(ticked);
        ticked.now
    }
}

impl<M: RawMutex> Desk for LinkEnd<'_, M> {
    fn heard(&mut self) {
        self.bell.heard.store(true, Ordering::Relaxed);
    }

    fn command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool {
        self.commands.enqueue((sequence, start_us, command)).is_ok()
    }

    fn verdict(&mut self) -> Option<Verdict> {
        self.verdicts.dequeue()
    }

    fn event(&mut self) -> Option<Event> {
        self.events.dequeue()
    }

    fn samples_waiting(&self) -> usize {
        self.samples.len()
    }

    fn sample(&mut self) -> Option<Sample> {
        self.samples.dequeue()
    }

    fn statistics(&self) -> Statistics {
        let mut statistics = self.ticked.map(|ticked| ticked.statistics).unwrap_or_default();
        statistics.link.overflow = statistics.link.overflow.saturating_add(self.bell.dropped());
        statistics
    }
}
