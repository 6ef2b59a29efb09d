//! Control cycles that start when the drive's state comes, with a timer as fallback.
//!
//! The drive's clock is the one that counts: a controller on a ticker of its own beside
//! it takes some states twice and misses others, because the two drift apart. So a state
//! starts its cycle. Where none comes for half a period longer than it should, the timer
//! starts the cycle without it. The control path then bridges, and asks for the brakes
//! after too many such cycles.

use embassy_sync::blocking_mutex::raw::RawMutex;
use embassy_time::{Duration, Instant, with_deadline};

use super::links::Links;
use super::ports::{Clock, Tick};
use super::ticker::PERIOD;

/// When the next cycle starts. All times are in µs.
#[derive(Clone, Copy, Debug)]
pub struct StateSchedule {
    period_us: u64,
    /// When the next state should come.
    due_us: u64,
}

impl StateSchedule {
    /// A schedule whose first state is due one period after `now_us`. A period of 0
    /// counts as 1 µs.
    pub const fn new(period_us: u64, now_us: u64) -> Self {
        let period_us = if period_us == 0 { 1 } else { period_us };
        Self {
            period_us,
            due_us: now_us.saturating_add(period_us),
        }
    }

    /// When the cycle starts without a state, if a wait for one begins at `now_us`. A
    /// wait lasts half a period or longer, so a cycle that takes too long still leaves
    /// time for the tasks of lower priority: they bring the states.
    pub fn fallback_us(&self, now_us: u64) -> u64 {
        self.due_us.max(now_us).saturating_add(self.period_us / 2)
    }

    /// A cycle starts at `now_us` with a new state. Returns the periods that passed
    /// without a cycle.
    pub fn with_state(&mut self, now_us: u64) -> u32 {
        let missed = self.whole_periods(now_us.saturating_sub(self.due_us));
        self.due_us = now_us.saturating_add(self.period_us);
        missed
    }

    /// A cycle starts at `now_us` without a state. Returns the periods that passed
    /// without a cycle.
    pub fn without_state(&mut self, now_us: u64) -> u32 {
        let late_us = now_us.saturating_sub(self.due_us).saturating_sub(self.period_us / 2);
        let missed = self.whole_periods(late_us);
        let periods = u64::from(missed).saturating_add(1);
        self.due_us = self.due_us.saturating_add(periods.saturating_mul(self.period_us));
        missed
    }

    fn whole_periods(&self, time_us: u64) -> u32 {
        u32::try_from(time_us / self.period_us).unwrap_or(u32::MAX)
    }
}

/// A [`Clock`] on the states that [`Links`] receive. The control path gets the
/// controller's time.
pub struct StateClock<'a, M: RawMutex> {
    links: &'a Links<M>,
    period: Duration,
    schedule: StateSchedule,
}

impl<'a, M: RawMutex> StateClock<'a, M> {
    /// A clock that waits for the states of `links`.
    pub fn new(links: &'a Links<M>) -> Self {
        Self {
            links,
            period: PERIOD,
            schedule: StateSchedule::new(PERIOD.as_micros(), Instant::now().as_micros()),
        }
    }
}

impl<M: RawMutex> Clock for StateClock<'_, M> {
    fn start(&mut self) {
        self.schedule = StateSchedule::new(self.period.as_micros(), Instant::now().as_micros());
    }

    fn set_period(&mut self, period: Duration) {
        if period != self.period {
            self.period = period;
            self.start();
        }
    }

    async fn next_tick(&mut self) -> Tick {
        let fallback_us = self.schedule.fallback_us(Instant::now().as_micros());
        let arrived = with_deadline(Instant::from_micros(fallback_us), self.links.message_arrived()).await;
        let at = Instant::now();
        let missed = if arrived.is_ok() {
            self.schedule.with_state(at.as_micros())
        } else {
            self.schedule.without_state(at.as_micros())
        };
        Tick { at, missed }
    }

    fn device_time(&self, tick: &Tick, _drive_us: u64) -> Instant {
        tick.at
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;
    use spherecal_shared::timing::PeriodWatch;
    use std::vec::Vec;

    use super::*;

    /// When the states of a drive come whose clock is `ppm` fast, each late by up to
    /// `jitter_us`.
    fn arrivals(count: u64, ppm: f64, jitter_us: f64) -> Vec<u64> {
        let mut seed = 7u64;
        let mut draw = || {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            (seed >> 11) as f64 / (1u64 << 53) as f64
        };
        let period_us = 1000.0 / (1.0 + 1e-6 * ppm);
        (1..=count)
            .map(|k| (k as f64 * period_us + jitter_us * draw()) as u64)
            .collect()
    }

    /// Cycles with a new state, cycles without one, states that a newer one replaced, and
    /// periods missed.
    #[derive(Debug, Default, PartialEq)]
    struct Count {
        fresh: usize,
        without: usize,
        replaced: usize,
        missed: u32,
    }

    /// Runs cycles of `busy_us` on the states until the last one is taken.
    fn run(arrivals: &[u64], busy_us: u64) -> Count {
        let mut schedule = StateSchedule::new(1000, 0);
        let (mut now, mut taken, mut count) = (0, 0, Count::default());
        while taken < arrivals.len() {
            let fallback = schedule.fallback_us(now);
            let at = arrivals[taken].max(now);
            if at <= fallback {
                let newest = arrivals.partition_point(|a| *a <= at);
                count.missed += schedule.with_state(at);
                count.fresh += 1;
                count.replaced += newest - taken - 1;
                taken = newest;
                now = at;
            } else {
                count.missed += schedule.without_state(fallback);
                count.without += 1;
                now = fallback;
            }
            now += busy_us;
        }
        count
    }

    // Fails if one cycle of an hour has no state of its own although the drive's clock
    // drifts and its states jitter, or if a ticker beside the drive, for comparison, does
    // as well: then the states are too regular to show anything.
    #[test]
    fn every_state_has_its_cycle() {
        for ppm in [-50.0, 50.0] {
            let states = arrivals(3_600_000, ppm, 300.0);
            let expected = Count {
                fresh: states.len(),
                ..Count::default()
            };
            assert_eq!(run(&states, 130), expected, "{ppm} ppm");
            // The newest state at each beat of a ticker.
            let mut watch = PeriodWatch::new(1000, 0);
            let (mut last, mut without) = (0, 0u32);
            for _ in 0..states.len() {
                let beat = watch.due_us();
                watch.record(beat);
                let newest = states.partition_point(|a| *a <= beat);
                without += u32::from(newest == last);
                last = newest;
            }
            assert!(
                f64::from(without) > 0.02 * states.len() as f64,
                "{without} with a ticker"
            );
        }
    }

    // Fails if cycles stop while the drive is silent, if they come faster or slower than
    // the period, or if the first state after the gap does not start its cycle.
    #[test]
    fn a_silent_drive_is_bridged_by_the_timer() {
        let mut states: Vec<u64> = (1..=100).map(|k| 1000 * k).collect();
        states.retain(|at| !(30_000..50_000).contains(at));
        let count = run(&states, 130);
        assert_eq!((count.fresh, count.without), (80, 20));
        assert_eq!((count.replaced, count.missed), (0, 0));
    }

    // Fails if cycles that take too long are not counted as missed periods, or if the
    // wait between them is less than half a period although no state is there.
    #[test]
    fn a_long_cycle_is_counted_and_leaves_time() {
        let mut schedule = StateSchedule::new(1000, 0);
        assert_eq!(schedule.with_state(1000), 0);
        // The cycle ends at 4.2 ms; states were due at 2, 3 and 4 ms.
        assert_eq!(schedule.fallback_us(4200), 4700);
        assert_eq!(schedule.with_state(4300), 2);
        assert_eq!(schedule.fallback_us(4400), 5800);
        let mut schedule = StateSchedule::new(1000, 0);
        assert_eq!(schedule.without_state(4700), 3);
        assert_eq!(schedule.fallback_us(4800), 5500);
        assert_eq!(StateSchedule::new(0, 5).fallback_us(5), 6);
    }

    proptest! {
        // Fails if a cycle comes earlier than a state or half a period after the last
        // one, or if the times of the schedule wrap.
        #[test]
        fn the_fallback_is_never_early(start in 0u64..u64::MAX, steps in proptest::collection::vec((0u64..5000, any::<bool>()), 1..50)) {
            let mut schedule = StateSchedule::new(1000, start);
            let mut now = start;
            for (step, state) in steps {
                let fallback = schedule.fallback_us(now);
                prop_assert!(fallback == u64::MAX || fallback >= now + 500);
                now = if state { now.saturating_add(step).min(fallback) } else { fallback };
                if state { schedule.with_state(now) } else { schedule.without_state(now) };
            }
        }
    }
}
