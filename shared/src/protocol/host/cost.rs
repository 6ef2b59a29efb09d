//! What a control cycle costs on its board.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

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
