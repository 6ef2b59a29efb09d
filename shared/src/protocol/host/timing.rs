//! How punctual a control loop is that keeps the time of its robot.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

/// Bins of [`Octaves`].
pub const OCTAVES: usize = 20;

/// A histogram of times. Bin 0 counts times under 1 µs, bin k those from 2^(k-1) to under 2^k µs; the last bin also
/// counts all longer ones.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Octaves {
    /// Times per bin.
    pub bins: [u32; OCTAVES],
    /// The longest time, in µs.
    pub max_us: u32,
}

impl Octaves {
    /// Counts `count` times of `us` µs.
    pub fn add(&mut self, us: u32, count: u32) {
        let bin = (u32::BITS - us.leading_zeros()) as usize;
        if let Some(bin) = self.bins.get_mut(bin.min(OCTAVES - 1)) {
            *bin = bin.saturating_add(count);
        }
    }

    /// The first and the last time of a bin, in µs; the last one of the last bin is [`Self::max_us`].
    pub fn range_us(&self, bin: usize) -> (u32, u32) {
        let from = match bin {
            0 => 0,
            _ => 1 << (bin - 1).min(31),
        };
        if bin + 1 >= OCTAVES {
            return (from, self.max_us.max(from));
        }
        (from, (1 << bin) - 1)
    }
}

/// Counts and times of a real-time control loop since its start. All is 0 where the drive waits for the controller,
/// and on boards, which state [`CycleCost`](super::CycleCost).
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct LoopTiming {
    /// Cycles in which a torque was due and sent.
    pub cycles: u32,
    /// Cycles whose answer left later than 300 µs after the state came.
    pub late: u32,
    /// Periods of the commanded motion that passed without an answer.
    pub missed: u32,
    /// The longest gap: missed periods in a row.
    pub longest_gap: u32,
    /// Motions that the robot ended: reflexes, stops, lost sessions.
    pub stops: u32,
    /// From a state's arrival to its answer.
    pub turnaround: Octaves,
    /// How far the time between two states differs from the control period.
    pub jitter: Octaves,
}

/// Stages of a control cycle, in order.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Stage {
    /// Messages of the drive and commands of the host.
    Commands,
    /// Checks of the drive state.
    Admission,
    /// Kinematics and dynamics.
    Model,
    /// Observer and guards.
    Guards,
    /// The phase: setpoint, contact, recording.
    Phase,
    /// Torque of the law.
    Law,
    /// Torque loop, saturation and rate.
    Output,
    /// Command, events and telemetry passed on.
    Report,
}

/// Number of stages.
pub const STAGES: usize = 8;

/// Mean and largest cost of one stage or of a whole cycle, in counts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct Cost {
    /// Mean.
    pub mean: u32,
    /// Largest.
    pub worst: u32,
}

/// Cost of the control cycles of the last second, in counts of the board's stopwatch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, Schema)]
pub struct CycleCost {
    /// Counts per second of the stopwatch; 0 where there is none, and all else is 0 then.
    pub hz: u32,
    /// Number of cycles measured.
    pub cycles: u32,
    /// The whole cycle.
    pub whole: Cost,
    /// Its stages, in the order of [`Stage`].
    pub stages: [Cost; STAGES],
}

impl CycleCost {
    /// The cost of one stage.
    pub fn of(&self, stage: Stage) -> Cost {
        self.stages.get(stage as usize).copied().unwrap_or_default()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a time is counted in a bin that does not contain it.
    #[test]
    fn every_time_is_in_its_bin() {
        for us in (0..5_000)
            .chain((12..32).flat_map(|k| [(1 << k) - 1, 1 << k]))
            .chain([u32::MAX])
        {
            let mut octaves = Octaves {
                max_us: us,
                ..Octaves::default()
            };
            octaves.add(us, 3);
            let bin = octaves.bins.iter().position(|count| *count == 3).expect("counted");
            let (from, to) = octaves.range_us(bin);
            assert!((from..=to).contains(&us), "{us} in {from}..={to}");
        }
    }
}
