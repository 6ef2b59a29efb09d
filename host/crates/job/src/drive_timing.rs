//! What a drive over a robot's own interface measured of itself, as database and summary hold it.

use serde::{Deserialize, Serialize};
use spherecal_link::native::{DriveRecord, Histogram};

/// Counts and times of the real-time loop. Sessions of a run are added up.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct DriveTiming {
    /// Cycles in which a torque was due and sent.
    pub cycles: u64,
    /// Periods of the commanded motion that passed without an answer.
    pub missed: u64,
    /// The longest gap: missed periods in a row.
    pub longest_gap: u64,
    /// Answers that left later than 300 µs after the state came.
    pub late: u64,
    /// Commands of which a torque changed too fast and was clamped.
    pub rate_limited: u64,
    /// Commands of which a torque exceeded its limit and was clamped.
    pub torque_limited: u64,
    /// Motions that the robot ended.
    pub stops: u64,
    /// Error recoveries that were asked for.
    pub recoveries: u64,
    /// Connections that were made again.
    pub reconnects: u64,
    /// From a state's arrival to its answer.
    pub turnaround: TimeHistogram,
    /// How far the time between two states differs from the control period.
    pub jitter: TimeHistogram,
}

/// A histogram of times.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default)]
pub struct TimeHistogram {
    /// The largest time, in µs.
    pub max_us: u32,
    /// Bins that are not empty, in order.
    pub bins: Vec<Bin>,
}

/// A bin of a histogram.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct Bin {
    /// Start, in µs.
    pub from_us: u32,
    /// First time beyond it, in µs.
    pub to_us: u32,
    /// Times in it.
    pub count: u64,
}

impl From<&Histogram> for TimeHistogram {
    fn from(histogram: &Histogram) -> Self {
        let bin = |(from_us, to_us, count): (u32, u32, u32)| Bin {
            from_us,
            to_us,
            count: count.into(),
        };
        Self {
            max_us: histogram.max_us(),
            bins: histogram.bins().map(bin).collect(),
        }
    }
}

impl TimeHistogram {
    /// Times that were counted.
    pub fn count(&self) -> u64 {
        self.bins.iter().map(|bin| bin.count).sum()
    }

    /// The time that this share (0 to 1) does not exceed, in µs: at most 25 % too large.
    pub fn percentile_us(&self, share: f64) -> u32 {
        let wanted = (share * self.count() as f64).ceil() as u64;
        let mut below = 0;
        for bin in &self.bins {
            below += bin.count;
            if below >= wanted {
                return bin.to_us.min(self.max_us);
            }
        }
        self.max_us
    }

    fn add(&mut self, other: &Self) {
        self.max_us = self.max_us.max(other.max_us);
        for bin in &other.bins {
            match self.bins.iter_mut().find(|own| own.from_us == bin.from_us) {
                Some(own) => own.count += bin.count,
                None => self.bins.push(*bin),
            }
        }
        self.bins.sort_by_key(|bin| bin.from_us);
    }
}

impl From<&DriveRecord> for DriveTiming {
    fn from(record: &DriveRecord) -> Self {
        Self {
            cycles: record.cycles,
            missed: record.missed,
            longest_gap: record.longest_gap,
            late: record.late,
            rate_limited: record.rate_limited,
            torque_limited: record.torque_limited,
            stops: record.stops,
            recoveries: record.recoveries,
            reconnects: record.reconnects,
            turnaround: (&record.turnaround).into(),
            jitter: (&record.jitter).into(),
        }
    }
}

impl DriveTiming {
    /// Adds another session of the same run.
    pub(super) fn add(&mut self, other: &Self) {
        self.cycles += other.cycles;
        self.missed += other.missed;
        self.longest_gap = self.longest_gap.max(other.longest_gap);
        self.late += other.late;
        self.rate_limited += other.rate_limited;
        self.torque_limited += other.torque_limited;
        self.stops += other.stops;
        self.recoveries += other.recoveries;
        self.reconnects += other.reconnects;
        self.turnaround.add(&other.turnaround);
        self.jitter.add(&other.jitter);
    }

    /// One sentence for people.
    pub fn words(&self) -> String {
        let share = |part: u64| 100.0 * part as f64 / self.cycles.max(1) as f64;
        format!(
            "{} cycles, {:.3} % answered later than 300 us, {} periods missed (at most {} in a row), {} stops of the \
             robot; from state to command {} us (median), {} us (99.9 %); jitter of the states {} us (99.9 %)",
            self.cycles,
            share(self.late),
            self.missed,
            self.longest_gap,
            self.stops,
            self.turnaround.percentile_us(0.5),
            self.turnaround.percentile_us(0.999),
            self.jitter.percentile_us(0.999)
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the sum of two sessions loses a count, or its percentiles are not those of all times together.
    #[test]
    fn sessions_add_up() {
        let mut whole = Histogram::default();
        let (mut first, mut second) = (DriveRecord::default(), DriveRecord::default());
        for us in 1..=1000 {
            whole.record(us);
            let part = if us % 3 == 0 { &mut first } else { &mut second };
            part.turnaround.record(us);
            part.cycles += 1;
        }
        (first.longest_gap, second.longest_gap, second.missed) = (4, 9, 11);
        let mut sum = DriveTiming::from(&first);
        sum.add(&DriveTiming::from(&second));
        assert_eq!((sum.cycles, sum.longest_gap, sum.missed), (1000, 9, 11));
        assert_eq!(sum.turnaround, TimeHistogram::from(&whole));
        for share in [0.5, 0.99, 0.999] {
            assert_eq!(sum.turnaround.percentile_us(share), whole.percentile_us(share));
        }
        let text = serde_json::to_string(&sum).expect("JSON");
        assert_eq!(serde_json::from_str::<DriveTiming>(&text).expect("a timing"), sum);
    }
}
