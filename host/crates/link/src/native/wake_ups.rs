//! How well this machine wakes a thread at 1 kHz.

use std::time::{Duration, Instant};

use spherecal_realtime::Granted;

use super::Histogram;

/// Period, in µs.
const PERIOD_US: u64 = 1000;

/// How late a real-time thread woke up, each millisecond for some time.
#[derive(Clone, Copy, Debug)]
pub struct WakeUps {
    /// How the thread was scheduled.
    pub granted: Granted,
    /// How much later than asked it woke up, µs.
    pub lateness: Histogram,
    /// Periods that it overslept wholly.
    pub missed: u64,
}

impl WakeUps {
    /// Measures for this long, on a thread of its own.
    ///
    /// # Errors
    /// What the system says if the thread cannot start or fails.
    pub fn measure(time: Duration) -> std::io::Result<Self> {
        let thread = std::thread::Builder::new()
            .name("wake-ups".to_owned())
            .spawn(move || Self::run(time))?;
        thread
            .join()
            .map_err(|_| std::io::Error::other("the measuring thread failed"))
    }

    fn run(time: Duration) -> Self {
        let mut found = Self {
            granted: spherecal_realtime::enter(),
            lateness: Histogram::default(),
            missed: 0,
        };
        let start = Instant::now();
        let mut due_us = PERIOD_US;
        let since = |start: Instant| u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
        while start.elapsed() < time {
            std::thread::sleep(Duration::from_micros(due_us).saturating_sub(start.elapsed()));
            let late = since(start).saturating_sub(due_us);
            found.lateness.record(u32::try_from(late).unwrap_or(u32::MAX));
            let overslept = late / PERIOD_US;
            found.missed += overslept;
            due_us += PERIOD_US * (1 + overslept);
        }
        found
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if periods are lost: each one is a wake-up or was overslept.
    #[test]
    fn every_period_is_counted() {
        let found = WakeUps::measure(Duration::from_millis(300)).expect("a thread");
        let periods = found.lateness.count() + found.missed;
        assert!((290..=20_000).contains(&periods), "{periods}");
        assert!(u64::from(found.lateness.max_us()) >= 1000 * found.missed.min(1));
    }
}
