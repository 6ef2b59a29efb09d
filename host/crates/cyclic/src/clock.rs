//! The clock of a simulated robot side.

use std::time::{Duration, Instant};

/// Periods of the wall clock. A thread that is late slips: lost periods are counted, not made up for.
#[derive(Clone, Copy, Debug)]
pub struct PeriodClock {
    period: Duration,
    end: Instant,
    slipped: u64,
}

impl PeriodClock {
    /// The first period begins now.
    pub fn start(period: Duration) -> Self {
        let period = period.max(Duration::from_micros(1));
        Self {
            period,
            end: Instant::now() + period,
            slipped: 0,
        }
    }

    /// The length of a period.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// Sleeps to the end of the period.
    pub fn sleep(&self) {
        if let Some(left) = self.end.checked_duration_since(Instant::now()) {
            std::thread::sleep(left);
        }
    }

    /// Whether less than `patience` has gone by since the end of the period.
    pub fn is_patient(&self, patience: Duration) -> bool {
        Instant::now() < self.end + patience
    }

    /// Begins the next period; now, if the thread is more than a period late.
    pub fn advance(&mut self) {
        self.end += self.period;
        let late = Instant::now().saturating_duration_since(self.end);
        if late > self.period {
            self.slipped += (late.as_nanos() / self.period.as_nanos()) as u64;
            self.end = Instant::now() + self.period;
        }
    }

    /// Periods by which the clock fell behind the wall clock.
    pub fn slipped(&self) -> u64 {
        self.slipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a late thread makes up for lost periods, or does not count them.
    #[test]
    fn a_late_thread_slips() {
        let mut clock = PeriodClock::start(Duration::from_millis(1));
        std::thread::sleep(Duration::from_millis(20));
        clock.advance();
        assert!(clock.slipped() >= 17, "{}", clock.slipped());
        let before = clock.slipped();
        clock.sleep();
        assert!(!clock.is_patient(Duration::ZERO), "the period has ended");
        assert!(clock.is_patient(Duration::from_mins(1)));
        assert_eq!(clock.slipped(), before);
    }
}
