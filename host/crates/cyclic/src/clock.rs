//! The clock of a simulated robot side.

use std::time::{Duration, Instant};

/// Periods of a robot. A robot side that is late slips: lost periods are counted, not made up for.
#[derive(Clone, Copy, Debug)]
pub struct PeriodClock {
    period: Duration,
    end: Instant,
    slipped: u64,
}

impl PeriodClock {
    /// The first period begins now.
    pub fn start(period: Duration, now: Instant) -> Self {
        let period = period.max(Duration::from_micros(1));
        Self {
            period,
            end: now + period,
            slipped: 0,
        }
    }

    /// The length of a period.
    pub fn period(&self) -> Duration {
        self.period
    }

    /// The end of this period.
    pub fn end(&self) -> Instant {
        self.end
    }

    /// Whether less than `patience` has gone by since the end of the period.
    pub fn is_patient(&self, now: Instant, patience: Duration) -> bool {
        now < self.end + patience
    }

    /// Begins the next period; now, if the robot side is more than a period late.
    pub fn advance(&mut self, now: Instant) {
        self.end += self.period;
        let late = now.saturating_duration_since(self.end);
        if late > self.period {
            self.slipped += (late.as_nanos() / self.period.as_nanos()) as u64;
            self.end = now + self.period;
        }
    }

    /// Periods by which the robot fell behind the time.
    pub fn slipped(&self) -> u64 {
        self.slipped
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a late robot side makes up for lost periods, or does not count them.
    #[test]
    fn a_late_robot_side_slips() {
        let (ms, begun) = (Duration::from_millis(1), Instant::now());
        let mut clock = PeriodClock::start(ms, begun);
        assert_eq!(clock.end(), begun + ms);
        clock.advance(begun + ms);
        assert_eq!((clock.end(), clock.slipped()), (begun + 2 * ms, 0));
        let late = begun + 20 * ms;
        assert!(!clock.is_patient(late, 18 * ms) && clock.is_patient(late, 19 * ms));
        clock.advance(late);
        assert_eq!((clock.end(), clock.slipped()), (late + ms, 17));
    }
}
