//! Ticks, periods and times.
//!
//! A *tick* is one control cycle; drive states and telemetry samples carry its
//! number. [`PeriodWatch`] detects control cycles that start late or not at
//! all; boards and the host's TCP drive use it. [`SampleClock`] gives the device
//! time of a tick number; the host uses it for telemetry, which carries tick
//! numbers only.
//!
//! All times are device times in µs since the controller's start.

use crate::protocol::host::Event;

/// Detects control periods that passed without a tick.
///
/// A tick is due one period after the one before. A tick that comes less than
/// one period late is only late, and the next one is due as if it had been in
/// time. A tick that comes later counts the periods that passed, and the
/// schedule starts afresh from it: an embassy ticker would otherwise run the
/// missed ticks at once, and the arm would be commanded several times from one
/// state.
#[derive(Clone, Copy, Debug)]
pub struct PeriodWatch {
    period_us: u64,
    due_us: u64,
    missed: u32,
}

impl PeriodWatch {
    /// A watch with the first tick due one period after `start_us`. A period of
    /// 0 counts as 1 µs.
    pub const fn new(period_us: u64, start_us: u64) -> Self {
        let period_us = if period_us == 0 { 1 } else { period_us };
        Self {
            period_us,
            due_us: start_us.saturating_add(period_us),
            missed: 0,
        }
    }

    /// Records a tick at `now_us`; returns the number of periods that passed
    /// without a tick before it.
    pub fn record(&mut self, now_us: u64) -> u32 {
        let late_us = now_us.saturating_sub(self.due_us);
        let missed = u32::try_from(late_us / self.period_us).unwrap_or(u32::MAX);
        let from_us = if missed > 0 { now_us } else { self.due_us };
        self.due_us = from_us.saturating_add(self.period_us);
        self.missed = self.missed.saturating_add(missed);
        missed
    }

    /// Time from which the schedule must start afresh, if a control cycle that
    /// ends at `now_us` has run past the time of the next tick; `None` if not.
    ///
    /// The next tick then comes one period after `now_us`. Tasks of lower
    /// priority get that period. Without it a control task that is always late
    /// would never let them run, and no overrun would be reported.
    pub fn restart_from(&self, now_us: u64) -> Option<u64> {
        (now_us >= self.due_us).then_some(now_us)
    }

    /// Time at which the next tick is due, in µs.
    pub const fn due_us(&self) -> u64 {
        self.due_us
    }

    /// Periods missed since the start.
    pub const fn missed(&self) -> u32 {
        self.missed
    }
}

/// Device time of every tick, from the control period and one tick whose time
/// is known.
///
/// A [`Sample`](crate::protocol::host::Sample) carries its tick number only.
/// Phase changes carry both, the controller's banner carries the period:
/// [`observe`](Self::observe) takes them from the events. The clock tells no
/// time before the banner, because drives have different periods. Before the
/// first phase change tick 0 has time 0.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct SampleClock {
    /// Control period, in µs; 0 until it is known.
    period_us: u32,
    tick: u64,
    time_us: u64,
}

impl SampleClock {
    /// A clock that does not know its period yet.
    pub const fn new() -> Self {
        Self {
            period_us: 0,
            tick: 0,
            time_us: 0,
        }
    }

    /// Control period, in s; `None` before the banner.
    pub fn period_s(&self) -> Option<f64> {
        (self.period_us > 0).then(|| f64::from(self.period_us) * 1e-6)
    }

    /// Takes the period from a banner and the time from a phase change; other
    /// events change nothing.
    pub fn observe(&mut self, event: &Event) {
        match event {
            Event::Banner(banner) => self.period_us = banner.period_us,
            Event::Phase(change) => (self.tick, self.time_us) = (change.tick, change.time_us),
            _ => {}
        }
    }

    /// Device time of `tick`, in µs; 0 for a tick before the controller's start,
    /// `None` before the banner.
    pub fn time_us(&self, tick: u64) -> Option<u64> {
        if self.period_us == 0 {
            return None;
        }
        let distance = i128::from(tick) - i128::from(self.tick);
        let time_us = i128::from(self.time_us) + distance * i128::from(self.period_us);
        Some(u64::try_from(time_us.max(0)).unwrap_or(u64::MAX))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::protocol::host::{Phase, PhaseChange};
    use proptest::prelude::*;

    const PERIOD_US: u64 = 1000;

    // Fails if a tick that is only late counts as missed, or if lateness adds up.
    #[test]
    fn a_late_tick_is_not_a_missed_one() {
        let mut watch = PeriodWatch::new(PERIOD_US, 0);
        for (now, due) in [(1000, 2000), (2999, 3000), (3000, 4000)] {
            assert_eq!(watch.record(now), 0);
            assert_eq!(watch.due_us(), due);
        }
        assert_eq!(watch.missed(), 0);
    }

    // Fails if a stall is followed by a burst of ticks, or is miscounted.
    #[test]
    fn missed_periods_are_counted_and_not_made_up_for() {
        let mut watch = PeriodWatch::new(PERIOD_US, 0);
        watch.record(1000);
        assert_eq!(watch.record(7000), 5);
        assert_eq!(watch.due_us(), 8000);
        assert_eq!(watch.record(8000), 0);
        assert_eq!(watch.missed(), 5);
    }

    // Fails if a cycle that runs past the next tick is followed by that tick at
    // once, or if the skipped tick is not counted.
    #[test]
    fn a_cycle_that_is_too_long_leaves_a_period_to_lower_priorities() {
        let mut watch = PeriodWatch::new(PERIOD_US, 0);
        watch.record(1000);
        assert_eq!(watch.restart_from(1999), None);
        assert_eq!(watch.restart_from(2500), Some(2500));
        assert_eq!(watch.record(3500), 1);
        assert_eq!(watch.due_us(), 4500);
    }

    // Fails if a clock that went backwards counts as a stall.
    #[test]
    fn a_tick_before_its_time_is_harmless() {
        let mut watch = PeriodWatch::new(PERIOD_US, 10_000);
        assert_eq!(watch.record(0), 0);
        assert_eq!(watch.due_us(), 12_000);
    }

    // Fails if a period of 0, which a damaged handshake may state, divides by it.
    #[test]
    fn a_period_of_zero_is_survived() {
        let mut watch = PeriodWatch::new(0, 0);
        assert_eq!(watch.record(5), 4);
    }

    fn banner(period_us: u32) -> Event {
        Event::Banner(crate::protocol::host::Banner {
            protocol: 1,
            schema: 0,
            version: heapless::String::new(),
            build: heapless::String::new(),
            joints: 7,
            period_us,
            first_event: 1,
        })
    }

    fn moving(tick: u64, time_us: u64) -> Event {
        Event::Phase(PhaseChange {
            phase: Phase::Moving,
            from: Phase::Idle,
            time_us,
            tick,
        })
    }

    proptest! {
        // Fails if a time does not grow by one period a tick, before and after
        // the tick that is known, or if the known tick has another time.
        #[test]
        fn ticks_are_one_period_apart(period_us in 1u32..10_000, tick in 1u64..1 << 40, time_us in 1u64 << 54..1 << 55) {
            let mut clock = SampleClock::new();
            clock.observe(&banner(period_us));
            clock.observe(&moving(tick, time_us));
            prop_assert_eq!(clock.time_us(tick), Some(time_us));
            prop_assert_eq!(clock.time_us(tick - 1), Some(time_us - u64::from(period_us)));
            prop_assert_eq!(clock.time_us(tick + 3), Some(time_us + 3 * u64::from(period_us)));
        }
    }

    // Fails if a time is told while the period is unknown.
    #[test]
    fn no_time_is_told_before_the_banner() {
        let mut clock = SampleClock::new();
        clock.observe(&moving(5, 5000));
        assert_eq!((clock.time_us(5), clock.period_s()), (None, None));
        clock.observe(&banner(2000));
        assert_eq!((clock.time_us(6), clock.period_s()), (Some(7000), Some(2e-3)));
    }

    // Fails if an absurd tick number panics or wraps.
    #[test]
    fn absurd_ticks_saturate() {
        let mut clock = SampleClock::new();
        clock.observe(&banner(u32::MAX));
        assert_eq!(clock.time_us(u64::MAX), Some(u64::MAX));
        clock.observe(&moving(u64::MAX, 0));
        assert_eq!(clock.time_us(0), Some(0));
    }
}
