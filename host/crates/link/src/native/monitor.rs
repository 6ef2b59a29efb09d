//! What the real-time thread measures, and how other threads read it without stopping it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError, TryLockError};
use std::time::Instant;

use serde::{Deserialize, Serialize};
use spherecal_cyclic::Machine;
use spherecal_shared::protocol::host::LoopTiming;

use super::{DriveEvent, Histogram};

/// Cycles between two copies for the readers.
const SHARE_EVERY: u32 = 64;
/// Events that wait for a reader; older ones are dropped.
const EVENTS: usize = 64;

/// What a drive counted since it was opened.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct DriveRecord {
    /// Cycles in which a torque was due.
    pub cycles: u64,
    /// Periods of the commanded motion that passed without an answer.
    pub missed: u64,
    /// The longest gap: missed periods in a row.
    pub longest_gap: u64,
    /// Cycles whose answer left later than 300 µs after the state came.
    pub late: u64,
    /// Commands of which a torque changed too fast and was clamped by the drive.
    pub rate_limited: u64,
    /// Commands of which a torque exceeded its limit and was clamped by the drive.
    pub torque_limited: u64,
    /// Motions that the robot ended: reflexes, stops, lost sessions.
    pub stops: u64,
    /// Error recoveries that were asked for.
    pub recoveries: u64,
    /// Connections that were made again.
    pub reconnects: u64,
    /// From a state's arrival to its answer, µs.
    pub turnaround: Histogram,
    /// How far the time between two states differs from the control period, µs.
    pub jitter: Histogram,
}

impl DriveRecord {
    /// Adds what a later session counted.
    pub fn add(&mut self, other: &Self) {
        self.cycles = self.cycles.saturating_add(other.cycles);
        self.missed = self.missed.saturating_add(other.missed);
        self.longest_gap = self.longest_gap.max(other.longest_gap);
        self.late = self.late.saturating_add(other.late);
        self.rate_limited = self.rate_limited.saturating_add(other.rate_limited);
        self.torque_limited = self.torque_limited.saturating_add(other.torque_limited);
        self.stops = self.stops.saturating_add(other.stops);
        self.recoveries = self.recoveries.saturating_add(other.recoveries);
        self.reconnects = self.reconnects.saturating_add(other.reconnects);
        self.turnaround.add(&other.turnaround);
        self.jitter.add(&other.jitter);
    }

    /// One sentence for people.
    pub fn words(&self) -> String {
        let share = |part: u64| 100.0 * part as f64 / self.cycles.max(1) as f64;
        format!(
            "{} cycles, {:.3} % answered later than 300 us, {} periods missed (at most {} in a row), {} stops of the \
             robot; from state to command {} us (median), {} us (99.9 %); jitter of the states {} us (99.9 %)",
            self.cycles,
            share(self.late),
            self.missed,
            self.longest_gap,
            self.stops,
            self.turnaround.percentile_us(0.5),
            self.turnaround.percentile_us(0.999),
            self.jitter.percentile_us(0.999)
        )
    }
}

impl From<&DriveRecord> for LoopTiming {
    /// What the controller tells its host: counts that do not fit are the largest that do.
    fn from(record: &DriveRecord) -> Self {
        let narrow = |count: u64| u32::try_from(count).unwrap_or(u32::MAX);
        Self {
            cycles: narrow(record.cycles),
            late: narrow(record.late),
            missed: narrow(record.missed),
            longest_gap: narrow(record.longest_gap),
            stops: narrow(record.stops),
            turnaround: record.turnaround.octaves(),
            jitter: record.jitter.octaves(),
        }
    }
}

impl From<&LoopTiming> for DriveRecord {
    /// What a host knows of a controller in another process. Recoveries, connections and clamped commands are not told,
    /// and count as 0.
    fn from(timing: &LoopTiming) -> Self {
        Self {
            cycles: timing.cycles.into(),
            late: timing.late.into(),
            missed: timing.missed.into(),
            longest_gap: timing.longest_gap.into(),
            stops: timing.stops.into(),
            turnaround: Histogram::from(&timing.turnaround),
            jitter: Histogram::from(&timing.jitter),
            ..Self::default()
        }
    }
}

/// Time after a state within which its answer must leave, in µs. Franka's figure, network included.
const ANSWER_US: u32 = 300;

#[derive(Debug, Default)]
struct SharedRecord {
    record: DriveRecord,
    events: VecDeque<DriveEvent>,
}

/// Reads what a drive measures, from any thread.
#[derive(Clone, Debug, Default)]
pub struct Monitor(Arc<Mutex<SharedRecord>>);

impl Monitor {
    /// The drive's counts, at most 64 cycles old.
    pub fn record(&self) -> DriveRecord {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).record
    }

    /// Adds an event of the thread that runs the drive, before its loop.
    pub(super) fn announce(&self, event: DriveEvent) {
        let mut shared = self.0.lock().unwrap_or_else(PoisonError::into_inner);
        shared.events.push_back(event);
    }

    /// The oldest event that was not read yet.
    pub fn next_event(&self) -> Option<DriveEvent> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).events.pop_front()
    }
}

/// The drive's side of a [`Monitor`]. Its methods never wait for a reader, and allocate nothing but for the first
/// events.
#[derive(Debug)]
pub(super) struct DriveRecorder {
    monitor: Monitor,
    pub(super) record: DriveRecord,
    /// Events that no reader could take yet.
    pending: VecDeque<DriveEvent>,
    since_shared: u32,
    arrived: Option<Instant>,
    period_us: u32,
    machine: Arc<dyn Machine>,
}

impl DriveRecorder {
    pub(super) fn new(period_us: u32, machine: Arc<dyn Machine>) -> Self {
        let monitor = Monitor::default();
        if let Ok(mut shared) = monitor.0.lock() {
            shared.events.reserve_exact(EVENTS);
        }
        Self {
            monitor,
            record: DriveRecord::default(),
            pending: VecDeque::with_capacity(EVENTS),
            since_shared: 0,
            arrived: None,
            period_us,
            machine,
        }
    }

    pub(super) fn monitor(&self) -> Monitor {
        self.monitor.clone()
    }

    /// A state came, `missed` periods after the one that was expected. `commanding`: torques are due.
    pub(super) fn state(&mut self, commanding: bool, missed: u32) {
        let now = self.machine.now();
        if let Some(before) = self.arrived.filter(|_| commanding) {
            let expected = u64::from(self.period_us) * (u64::from(missed) + 1);
            let took = u64::try_from(now.duration_since(before).as_micros()).unwrap_or(u64::MAX);
            let off = took.abs_diff(expected);
            self.record.jitter.record(u32::try_from(off).unwrap_or(u32::MAX));
            self.record.missed += u64::from(missed);
            self.record.longest_gap = self.record.longest_gap.max(u64::from(missed));
        }
        self.arrived = Some(now);
        self.since_shared += 1;
        if self.since_shared >= SHARE_EVERY || !self.pending.is_empty() {
            self.share();
        }
    }

    /// The newest state was answered just now.
    pub(super) fn answered(&mut self, rate_limited: bool, torque_limited: bool) {
        let Some(arrived) = self.arrived else { return };
        let us = u32::try_from(self.machine.now().saturating_duration_since(arrived).as_micros()).unwrap_or(u32::MAX);
        self.record.turnaround.record(us);
        self.record.cycles += 1;
        self.record.late += u64::from(us > ANSWER_US);
        self.record.rate_limited += u64::from(rate_limited);
        self.record.torque_limited += u64::from(torque_limited);
    }

    /// The next interval between states is no measure of jitter: the drive waited on purpose.
    pub(super) fn pause(&mut self) {
        self.arrived = None;
    }

    pub(super) fn event(&mut self, event: DriveEvent) {
        if self.pending.len() == EVENTS {
            self.pending.pop_front();
        }
        self.pending.push_back(event);
        self.share();
    }

    /// Copies the counts for the readers, unless one of them reads just now.
    fn share(&mut self) {
        let mut shared = match self.monitor.0.try_lock() {
            Ok(shared) => shared,
            Err(TryLockError::Poisoned(poisoned)) => poisoned.into_inner(),
            Err(TryLockError::WouldBlock) => return,
        };
        self.since_shared = 0;
        shared.record = self.record;
        while let Some(event) = self.pending.pop_front() {
            if shared.events.len() == EVENTS {
                shared.events.pop_front();
            }
            shared.events.push_back(event);
        }
    }
}

impl Drop for DriveRecorder {
    /// The last counts reach the readers.
    fn drop(&mut self) {
        let mut shared = self.monitor.0.lock().unwrap_or_else(PoisonError::into_inner);
        shared.record = self.record;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if an event is lost, repeated or out of order while a reader holds the lock now and then.
    #[test]
    fn events_arrive_once_and_in_order() {
        let mut recorder = DriveRecorder::new(1000, spherecal_cyclic::this_machine());
        let monitor = recorder.monitor();
        {
            let _reader = monitor.0.lock().expect("a lock");
            recorder.event(DriveEvent::Started);
            recorder.event(DriveEvent::Recovering);
        }
        assert_eq!(monitor.next_event(), None);
        recorder.state(false, 0);
        assert_eq!(monitor.next_event(), Some(DriveEvent::Started));
        assert_eq!(monitor.next_event(), Some(DriveEvent::Recovering));
        assert_eq!(monitor.next_event(), None);
    }

    // Fails if periods are counted as missed while no torque is due, or a missed period is not.
    #[test]
    fn only_due_periods_can_be_missed() {
        let mut recorder = DriveRecorder::new(1000, spherecal_cyclic::this_machine());
        recorder.state(false, 5);
        recorder.state(true, 2);
        recorder.answered(true, false);
        let record = recorder.record;
        assert_eq!((record.missed, record.longest_gap, record.cycles), (2, 2, 1));
        assert_eq!((record.rate_limited, record.torque_limited), (1, 0));
        drop(recorder);
    }

    // Fails if the sum of two sessions loses a count, its percentiles are not those of all times together, or JSON changes it.
    #[test]
    fn sessions_add_up() {
        let mut whole = Histogram::default();
        let (mut sum, mut second) = (DriveRecord::default(), DriveRecord::default());
        for us in 1..=1000 {
            whole.record(us);
            let part = if us % 3 == 0 { &mut sum } else { &mut second };
            part.turnaround.record(us);
            part.cycles += 1;
        }
        (sum.longest_gap, second.longest_gap, second.missed) = (4, 9, 11);
        sum.add(&second);
        assert_eq!((sum.cycles, sum.longest_gap, sum.missed), (1000, 9, 11));
        assert_eq!(sum.turnaround, whole);
        let text = serde_json::to_string(&sum).expect("JSON");
        assert_eq!(serde_json::from_str::<DriveRecord>(&text).expect("a record"), sum);
        let bins = serde_json::to_value(whole).expect("JSON")["bins"].clone();
        assert_eq!(bins[4], serde_json::json!({"from_us": 5, "to_us": 6, "count": 1}));
    }
}
