//! A laser tracker's measurement and a contact's force, as plain data.

use serde::{Deserialize, Serialize};

/// A laser tracker shot.
#[derive(Clone, Debug, PartialEq)]
pub struct LaserShot {
    /// What it was made for: `calibrate`, `validate`, or an arc (`base_1`,
    /// `base_2`, `tool_5`, …).
    pub purpose: String,
    /// Joint angles as the encoders gave them, in rad.
    pub q: Vec<f64>,
    /// Measured point in the tracker's frame, in m.
    pub point_m: [f64; 3],
}

impl LaserShot {
    /// Purpose of the points that a model is calibrated from.
    pub const CALIBRATE: &'static str = "calibrate";
    /// Purpose of the points that models are judged by.
    pub const VALIDATE: &'static str = "validate";
    /// Purpose of an arc for the base, before the joint's number.
    pub const BASE: &'static str = "base_";
    /// Purpose of an arc for the tool, before the joint's number.
    pub const TOOL: &'static str = "tool_";
}

/// Which of the paper's laser sessions a shot belongs to.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum TrackerSession {
    /// Arcs of joints 1 and 2, which give the base.
    BaseArcs,
    /// Arcs of joints 5 to 7, which give the tool.
    ToolArcs,
    /// Calibration and validation measurements.
    #[default]
    Measurement,
}

/// The force against the approach around one contact.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ContactTrace {
    /// Id of the sphere.
    pub sphere: u32,
    /// Device time of the trigger, in s.
    pub trigger_s: f64,
    /// Device time, in s, and force against the approach, in N, to a thousandth: the store keeps all digits as text.
    pub samples: Vec<(f64, f64)>,
}
