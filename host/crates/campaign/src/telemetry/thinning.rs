//! Which samples a file keeps.
//!
//! The controller sends every control period while the tool is near a sphere. A file has all of them around each contact
//! and each fault, and beyond that as many as in free motions. What is near an event is known only after it, so
//! everything waits for a while.

use std::collections::VecDeque;

use spherecal_shared::protocol::host::{Event, Sample};

use super::utc::Moment;

/// Time before and after a contact or a fault over which every sample is kept, in ns: 15 time constants of the filter of
/// the force estimate (60 rad/s). The impact is shorter.
const NEAR_NS: u64 = 250_000_000;
/// Time for which an entry waits, in ns. An event is told later than the samples beside it.
const WAIT_NS: u64 = 2 * NEAR_NS;

/// What a telemetry file is made of.
#[derive(Clone, Debug)]
pub(super) enum Entry {
    /// A sample of the control loop.
    Sample(Sample),
    /// An event of the controller.
    Event(Box<Event>),
    /// A remark of the host.
    Note(String),
}

/// Entries on their way into a file, in the order of their times.
#[derive(Debug)]
pub(super) struct Thinning {
    /// Ticks between two samples that are near nothing.
    every_ticks: u64,
    waiting: VecDeque<(Moment, Entry)>,
    /// Times of contacts and faults, UTC in ns.
    marks: VecDeque<u64>,
    /// Tick of the last sample that was kept.
    kept: Option<u64>,
}

impl Thinning {
    /// Keeps a sample in `every_ticks` where nothing happens; all of them for 0 and 1.
    pub(super) const fn new(every_ticks: u32) -> Self {
        Self {
            every_ticks: every_ticks as u64,
            waiting: VecDeque::new(),
            marks: VecDeque::new(),
            kept: None,
        }
    }

    /// Adds an entry; its time is not earlier than that of the one before.
    pub(super) fn push(&mut self, at: Moment, entry: Entry) {
        if let Entry::Event(event) = &entry {
            match **event {
                Event::Contact(ref contact) => self.marks.push_back(at.utc_ns_of(contact.time_us)),
                Event::Fault(ref fault) => self.marks.push_back(at.utc_ns_of(fault.time_us)),
                _ => {}
            }
        }
        self.waiting.push_back((at, entry));
    }

    /// The next entry of the file that has waited long enough.
    pub(super) fn next(&mut self) -> Option<(Moment, Entry)> {
        let newest_ns = self.waiting.back()?.0.utc_ns;
        self.next_before(newest_ns.saturating_sub(WAIT_NS))
    }

    /// The next entry of the file, at its end.
    pub(super) fn rest(&mut self) -> Option<(Moment, Entry)> {
        self.next_before(u64::MAX)
    }

    fn next_before(&mut self, end_ns: u64) -> Option<(Moment, Entry)> {
        loop {
            let (at, entry) = self.waiting.pop_front_if(|(at, _)| at.utc_ns < end_ns)?;
            if !matches!(&entry, Entry::Sample(sample) if !self.keeps(at, sample)) {
                return Some((at, entry));
            }
        }
    }

    fn keeps(&mut self, at: Moment, sample: &Sample) -> bool {
        let past = |mark: &mut u64| mark.saturating_add(NEAR_NS) < at.utc_ns;
        while self.marks.pop_front_if(past).is_some() {}
        let near = self.marks.iter().any(|mark| mark.abs_diff(at.utc_ns) <= NEAR_NS);
        let next = self.waiting.iter().find_map(|(_, entry)| match entry {
            Entry::Sample(next) => Some(next.tick),
            _ => None,
        });
        // The next one would come too late. A controller that starts anew counts from 0: the difference is large.
        let due = |last: u64| {
            sample.tick.wrapping_sub(last) >= self.every_ticks
                || next.is_some_and(|next| next.wrapping_sub(last) > self.every_ticks)
        };
        let keeps = near || self.kept.is_none_or(due);
        if keeps {
            self.kept = Some(sample.tick);
        }
        keeps
    }
}

#[cfg(test)]
mod tests {
    use spherecal_shared::protocol::host::{Fault, FaultReport, Phase};

    use super::*;

    /// The ticks of the samples in a file, one tick each ms. A fault at 3,000 ms is told at `told_ms`; the controller
    /// starts anew at 6,000 ms.
    fn kept(every_ticks: u32, told_ms: u64) -> Vec<u64> {
        let mut thinning = Thinning::new(every_ticks);
        let (mut ticks, mut order) = (Vec::new(), Vec::new());
        let mut note = |(at, entry): (Moment, Entry)| {
            order.push(at.utc_ns);
            if let Entry::Sample(_) = entry {
                ticks.push(at.utc_ns / 1_000_000);
            }
        };
        for ms in 0..8_000_u64 {
            let tick = if ms < 6_000 { ms } else { ms - 6_000 };
            let at = Moment {
                utc_ns: ms * 1_000_000,
                device_us: tick * 1000,
            };
            if ms == told_ms {
                let fault = FaultReport {
                    fault: Fault::Force,
                    phase: Phase::Moving,
                    time_us: 3_000_000,
                    tick: 3_000,
                    joint: 0,
                    value: 50.0,
                    limit: 40.0,
                };
                thinning.push(at, Entry::Event(Box::new(Event::Fault(fault))));
            }
            let sample = Sample {
                tick,
                ..Sample::default()
            };
            thinning.push(at, Entry::Sample(sample));
            while let Some(entry) = thinning.next() {
                note(entry);
            }
        }
        while let Some(entry) = thinning.rest() {
            note(entry);
        }
        assert!(order.is_sorted(), "times go back");
        ticks
    }

    // Fails if a sample near a fault is lost, if one in 20 elsewhere is not kept, if a controller that starts anew gives
    // no more samples, or if the file has another order than the entries.
    #[test]
    fn all_samples_are_kept_near_a_fault_and_one_in_twenty_elsewhere() {
        for told_ms in [3_000, 3_040] {
            let ticks = kept(20, told_ms);
            let near: Vec<u64> = ticks
                .iter()
                .copied()
                .filter(|ms| (2_750..=3_250).contains(ms))
                .collect();
            assert_eq!(near, (2_750..=3_250).collect::<Vec<_>>());
            let gaps: Vec<u64> = ticks.windows(2).map(|pair| pair[1] - pair[0]).collect();
            assert!(gaps.iter().all(|gap| *gap <= 20), "{gaps:?}");
            // One more is the last sample before the controller starts anew.
            assert_eq!(ticks.len(), 138 + 501 + 237 + 1);
            assert!(ticks.contains(&6_000) && ticks.last() == Some(&7_980));
        }
    }

    // Fails if a file that is to have all samples lacks one.
    #[test]
    fn all_samples_are_kept_where_it_is_asked() {
        for every in [0, 1] {
            assert_eq!(kept(every, 3_000), (0..8_000).collect::<Vec<_>>());
        }
    }
}
