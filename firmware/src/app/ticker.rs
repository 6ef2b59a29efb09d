//! The control period in real time: an embassy ticker that counts overruns.

use embassy_time::{Duration, Instant, Ticker};
use spherecal_shared::timing::PeriodWatch;

use super::ports::{Clock, Tick};

/// The control period before the drive has stated one: 1 kHz.
pub const PERIOD: Duration = Duration::from_micros(1000);

/// An `embassy_time::Ticker` with a [`PeriodWatch`] on it: after a missed tick
/// the ticker starts afresh instead of running the missed ticks in a burst.
pub struct TickerClock {
    period: Duration,
    ticker: Ticker,
    watch: PeriodWatch,
}

impl TickerClock {
    /// A clock whose first tick is due after one period.
    pub fn new() -> Self {
        Self::every(PERIOD)
    }

    fn every(period: Duration) -> Self {
        let start = Instant::now();
        let mut ticker = Ticker::every(period);
        ticker.reset_at(start);
        Self {
            period,
            ticker,
            watch: PeriodWatch::new(period.as_micros(), start.as_micros()),
        }
    }

    /// Periods missed since the start.
    pub fn missed(&self) -> u32 {
        self.watch.missed()
    }
}

impl Default for TickerClock {
    fn default() -> Self {
        Self::new()
    }
}

impl Clock for TickerClock {
    fn start(&mut self) {
        *self = Self::every(self.period);
    }

    fn set_period(&mut self, period: Duration) {
        if period != self.period {
            *self = Self::every(period);
        }
    }

    async fn next_tick(&mut self) -> Tick {
        if let Some(now_us) = self.watch.restart_from(Instant::now().as_micros()) {
            self.ticker.reset_at(Instant::from_micros(now_us));
        }
        self.ticker.next().await;
        let at = Instant::now();
        let missed = self.watch.record(at.as_micros());
        if missed > 0 {
            self.ticker.reset_at(at);
        }
        Tick { at, missed }
    }

    fn device_time(&self, tick: &Tick, _drive_us: u64) -> Instant {
        tick.at
    }
}
