//! A histogram of times that the real-time thread can keep: a fixed array, no allocation.

use std::time::{Duration, Instant};

use serde::{Deserialize, Serialize};
use spherecal_realtime::Granted;
use spherecal_shared::protocol::host::Octaves;

/// Bins: four for each doubling of the time.
const BINS: usize = 88;

/// Counts of times in µs, in bins of a quarter octave: a percentile is at most 25 % too large. Times above 4 s are in
/// the last bin.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(from = "StoredHistogram", into = "StoredHistogram")]
pub struct Histogram {
    bins: [u32; BINS],
    count: u64,
    max_us: u32,
}

/// A histogram as files have it: its largest time in µs, and its bins that are not empty, in order.
#[derive(Default, Serialize, Deserialize)]
#[serde(default)]
struct StoredHistogram {
    max_us: u32,
    bins: Vec<StoredBin>,
}

/// From a time, in µs, to below another.
#[derive(Serialize, Deserialize)]
struct StoredBin {
    from_us: u32,
    to_us: u32,
    count: u32,
}

impl From<Histogram> for StoredHistogram {
    fn from(histogram: Histogram) -> Self {
        let bin = |(from_us, to_us, count)| StoredBin { from_us, to_us, count };
        Self {
            max_us: histogram.max_us,
            bins: histogram.bins().map(bin).collect(),
        }
    }
}

impl From<StoredHistogram> for Histogram {
    fn from(stored: StoredHistogram) -> Self {
        let mut histogram = Self {
            max_us: stored.max_us,
            ..Self::default()
        };
        for one in stored.bins {
            histogram.bins[bin(one.from_us)] = one.count;
            histogram.count += u64::from(one.count);
        }
        histogram
    }
}

impl Default for Histogram {
    fn default() -> Self {
        Self {
            bins: [0; BINS],
            count: 0,
            max_us: 0,
        }
    }
}

fn bin(us: u32) -> usize {
    if us < 4 {
        return us as usize;
    }
    let octave = us.ilog2();
    let quarter = (us >> (octave - 2)) & 3;
    (4 * (octave as usize - 1) + quarter as usize).min(BINS - 1)
}

/// The first time beyond a bin, in µs.
fn end_us(bin: usize) -> u32 {
    if bin < 4 {
        return bin as u32 + 1;
    }
    let (octave, quarter) = (bin / 4 + 1, bin % 4);
    ((4 + quarter as u32 + 1) << octave) >> 2
}

impl Histogram {
    /// Counts a time in µs.
    pub fn record(&mut self, us: u32) {
        if let Some(count) = self.bins.get_mut(bin(us)) {
            *count = count.saturating_add(1);
        }
        self.count += 1;
        self.max_us = self.max_us.max(us);
    }

    /// Adds the times of another histogram.
    pub fn add(&mut self, other: &Self) {
        for (own, count) in self.bins.iter_mut().zip(other.bins) {
            *own = own.saturating_add(count);
        }
        self.count += other.count;
        self.max_us = self.max_us.max(other.max_us);
    }

    /// Times that were counted.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// The largest time, in µs.
    pub fn max_us(&self) -> u32 {
        self.max_us
    }

    /// The time that this share (0 to 1) of all counted times does not exceed, in µs; 0 without any. It is the upper
    /// end of the time's bin, at most the largest time.
    pub fn percentile_us(&self, share: f64) -> u32 {
        let wanted = (share.clamp(0.0, 1.0) * self.count as f64).ceil() as u64;
        let mut below = 0;
        for (k, count) in self.bins.iter().enumerate() {
            below += u64::from(*count);
            if below >= wanted && below > 0 {
                return end_us(k).min(self.max_us);
            }
        }
        self.max_us
    }

    /// The bins that are not empty: start in µs, end in µs (the first time beyond), count.
    pub fn bins(&self) -> impl Iterator<Item = (u32, u32, u32)> {
        let filled = self.bins.iter().enumerate().filter(|(_, count)| **count > 0);
        filled.map(|(k, count)| (if k == 0 { 0 } else { end_us(k - 1) }, end_us(k), *count))
    }
}

impl Histogram {
    /// The same times, counted by octaves.
    pub fn octaves(&self) -> Octaves {
        let mut octaves = Octaves {
            max_us: self.max_us,
            ..Octaves::default()
        };
        for (from_us, _, count) in self.bins() {
            octaves.add(from_us, count);
        }
        octaves
    }
}

impl From<&Octaves> for Histogram {
    /// Every time is rounded up to the end of its octave, at most to the largest time.
    fn from(octaves: &Octaves) -> Self {
        let mut histogram = Self::default();
        for (k, count) in octaves.bins.iter().enumerate() {
            let (_, to_us) = octaves.range_us(k);
            if let Some(bin) = histogram.bins.get_mut(bin(to_us.min(octaves.max_us))) {
                *bin = bin.saturating_add(*count);
            }
            histogram.count += u64::from(*count);
        }
        histogram.max_us = octaves.max_us;
        histogram
    }
}

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

    // Fails if a time is lost on the way through octaves, or if a percentile becomes smaller or more than twice as large.
    #[test]
    fn octaves_keep_every_time() {
        let mut histogram = Histogram::default();
        for us in (0..2000).chain([70_000]) {
            histogram.record(us);
        }
        let seen = Histogram::from(&histogram.octaves());
        assert_eq!((seen.count(), seen.max_us()), (2001, 70_000));
        for share in [0.1, 0.5, 0.9, 0.99, 0.999] {
            let (exact, found) = (histogram.percentile_us(share), seen.percentile_us(share));
            assert!((exact..=2 * exact).contains(&found), "{share}: {exact} {found}");
        }
    }

    // Fails if a time falls into a bin that does not contain it, or bins leave gaps.
    #[test]
    fn every_time_is_in_its_bin() {
        for us in (0..5_000).chain((12..22).flat_map(|k| [(1 << k) - 1, 1 << k, (1 << k) + 1])) {
            let k = bin(us);
            let start = if k == 0 { 0 } else { end_us(k - 1) };
            assert!((start..end_us(k)).contains(&us), "{us} in {start}..{}", end_us(k));
        }
        assert_eq!(bin(u32::MAX), BINS - 1);
    }

    // Fails if a percentile is below the true one, or more than a quarter above it.
    #[test]
    fn percentiles_are_at_most_a_quarter_too_large() {
        let mut histogram = Histogram::default();
        assert_eq!(histogram.percentile_us(0.999), 0);
        for us in 1..=1000 {
            histogram.record(us);
        }
        for (share, exact) in [(0.5, 500.0), (0.9, 900.0), (0.99, 990.0), (1.0, 1000.0)] {
            let found = f64::from(histogram.percentile_us(share));
            assert!((exact..=1.25 * exact + 1.0).contains(&found), "{share}: {found}");
        }
        assert_eq!((histogram.max_us(), histogram.count()), (1000, 1000));
        assert_eq!(
            histogram.bins().map(|(_, _, count)| u64::from(count)).sum::<u64>(),
            1000
        );
    }
}

#[cfg(test)]
mod wake_ups_tests {
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
