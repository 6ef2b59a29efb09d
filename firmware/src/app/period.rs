//! The control period: the beat of an embassy ticker, and whether it was kept.
//!
//! An embassy ticker that was held up catches up in a burst: 5 ms of stall give
//! four more ticks at one instant, and the arm would be commanded from the same
//! state four times. [`PeriodWatch`] tells a late beat from a missed one; after
//! a missed one the ticker starts afresh and the missed periods are counted.

use embassy_time::{Duration, Instant, Ticker};

use super::ports::{Beat, Clock};

/// The control period: 1 kHz.
pub const PERIOD: Duration = Duration::from_micros(1000);

/// Watches whether beats come when they are due.
#[derive(Clone, Copy, Debug)]
pub struct PeriodWatch {
    period: Duration,
    due: Instant,
    missed: u32,
}

impl PeriodWatch {
    /// A watch whose first beat is due one period after `start`.
    pub fn new(period: Duration, start: Instant) -> Self {
        Self {
            period,
            due: start.saturating_add(period),
            missed: 0,
        }
    }

    /// Notes a beat at `now`; returns the periods that went by without one.
    /// When there were any, the next beat is due one period after `now`.
    pub fn note(&mut self, now: Instant) -> u32 {
        let late = now.saturating_duration_since(self.due).as_ticks();
        let missed = u32::try_from(late / self.period.as_ticks().max(1)).unwrap_or(u32::MAX);
        let from = if missed > 0 { now } else { self.due };
        self.due = from.saturating_add(self.period);
        self.missed = self.missed.saturating_add(missed);
        missed
    }

    /// When the beats are to start afresh, where a tick that ends at `now` has
    /// run into its next beat: a period from then, in which the links below
    /// have the processor. A control task that is always late would leave them
    /// none, and nobody would hear of it.
    pub fn restart(&self, now: Instant) -> Option<Instant> {
        (now >= self.due).then_some(now)
    }

    /// When the next beat is due.
    pub fn due(&self) -> Instant {
        self.due
    }

    /// Periods missed since the start.
    pub fn missed(&self) -> u32 {
        self.missed
    }
}

/// The beat of an `embassy_time::Ticker`, in real time.
pub struct TickerClock {
    ticker: Ticker,
    watch: PeriodWatch,
}

impl TickerClock {
    /// Starts beating; the first beat is due after one period.
    pub fn start() -> Self {
        let start = Instant::now();
        let mut ticker = Ticker::every(PERIOD);
        ticker.reset_at(start);
        Self {
            ticker,
            watch: PeriodWatch::new(PERIOD, start),
        }
    }

    /// Periods missed since the start.
    pub fn missed(&self) -> u32 {
        self.watch.missed()
    }
}

impl Clock for TickerClock {
    async fn next(&mut self) -> Beat {
        if let Some(now) = self.watch.restart(Instant::now()) {
            self.ticker.reset_at(now);
        }
        self.ticker.next().await;
        let at = Instant::now();
        let missed = self.watch.note(at);
        if missed > 0 {
            self.ticker.reset_at(at);
        }
        Beat { at, missed }
    }

    fn time(&self, beat: &Beat, _drive_us: u64) -> Instant {
        beat.at
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn at(us: u64) -> Instant {
        Instant::from_micros(us)
    }

    // Fails if a beat that is merely late counts as missed, or if lateness adds up.
    #[test]
    fn a_late_beat_is_not_a_missed_one() {
        let mut watch = PeriodWatch::new(PERIOD, at(0));
        for (now, due) in [(1000, 2000), (2999, 3000), (3000, 4000)] {
            assert_eq!(watch.note(at(now)), 0);
            assert_eq!(watch.due(), at(due));
        }
        assert_eq!(watch.missed(), 0);
    }

    // Fails if a stall is followed by a burst, or miscounted.
    #[test]
    fn a_stall_is_counted_and_not_caught_up() {
        let mut watch = PeriodWatch::new(PERIOD, at(0));
        watch.note(at(1000));
        assert_eq!(watch.note(at(7000)), 5);
        assert_eq!(watch.due(), at(8000));
        assert_eq!(watch.note(at(8000)), 0);
        assert_eq!(watch.missed(), 5);
    }

    // Fails if a tick that runs into its next beat is followed by that beat at
    // once, or if the beat that is given up is not counted.
    #[test]
    fn a_tick_that_takes_too_long_leaves_a_period_to_those_below() {
        let mut watch = PeriodWatch::new(PERIOD, at(0));
        watch.note(at(1000));
        assert_eq!(watch.restart(at(1999)), None);
        assert_eq!(watch.restart(at(2500)), Some(at(2500)));
        assert_eq!(watch.note(at(3500)), 1);
        assert_eq!(watch.due(), at(4500));
    }

    // Fails if a clock that went backwards is taken for a stall.
    #[test]
    fn a_beat_before_its_time_is_harmless() {
        let mut watch = PeriodWatch::new(PERIOD, at(10_000));
        assert_eq!(watch.note(at(0)), 0);
        assert_eq!(watch.due(), at(12_000));
    }
}
