//! How well the real-time loop of a run keeps its period, for viewers.

use serde::{Deserialize, Serialize};
use spherecal_link::native::{DriveRecord, Histogram};

/// Counts and times of the loop since the session began.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct RealTime {
    /// Cycles in which a torque was due and sent.
    pub cycles: u64,
    /// Of those, answered later than 300 µs after the state came.
    pub late: u64,
    /// Periods of the commanded motion that passed without an answer.
    pub missed: u64,
    /// From a state's arrival to its answer.
    pub turnaround: Times,
    /// How far the time between two states differs from the control period.
    pub jitter: Times,
}

/// A histogram of times.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct Times {
    /// Median, in µs: at most 25 % too large.
    pub median_us: u32,
    /// What 99.9 % do not exceed, in µs: at most 25 % too large.
    pub most_us: u32,
    /// The largest, in µs.
    pub max_us: u32,
    /// Bins of an octave that are not empty, in order: first time beyond it (µs, a power of two), count.
    pub octaves: Vec<(u64, u64)>,
}

impl From<&DriveRecord> for RealTime {
    fn from(record: &DriveRecord) -> Self {
        Self {
            cycles: record.cycles,
            late: record.late,
            missed: record.missed,
            turnaround: (&record.turnaround).into(),
            jitter: (&record.jitter).into(),
        }
    }
}

impl From<&Histogram> for Times {
    fn from(histogram: &Histogram) -> Self {
        let mut octaves: Vec<(u64, u64)> = Vec::new();
        for (from_us, _, count) in histogram.bins() {
            let beyond = (u64::from(from_us) + 1).next_power_of_two();
            match octaves.last_mut().filter(|last| last.0 == beyond) {
                Some(last) => last.1 += u64::from(count),
                None => octaves.push((beyond, count.into())),
            }
        }
        Self {
            median_us: histogram.percentile_us(0.5),
            most_us: histogram.percentile_us(0.999),
            max_us: histogram.max_us(),
            octaves,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a time is lost, or stands in another octave than its own.
    #[test]
    fn each_time_is_in_its_octave() {
        let mut histogram = Histogram::default();
        for us in [0, 1, 3, 40, 63, 64, 700] {
            histogram.record(us);
        }
        let times = Times::from(&histogram);
        assert_eq!(times.octaves, [(1, 1), (2, 1), (4, 1), (64, 2), (128, 1), (1024, 1)]);
        assert_eq!((times.max_us, times.most_us), (700, 700));
    }
}
