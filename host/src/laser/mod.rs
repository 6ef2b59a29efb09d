//! The laser tracker's part in the study (Section 4.3 of the paper): the
//! reference that a calibration from spheres is compared with.
//!
//! Vocabulary. A *configuration* is one vector of joint angles. An *arc* is a
//! series of configurations in which one joint turns and the others rest; the
//! TCP then draws a circle about that joint's axis. The *tracker frame* is the
//! frame in which points are measured. *Arc-measured* frames are the robot's
//! base and tool as the paper finds them: independently of any calibration,
//! from the axes of arcs.
//!
//! Two things happen here, both on plain data:
//!
//! - [`plan`] says what to measure: 284 configurations to calibrate, 125 to
//!   validate, spread as Tables 3 and 4, and the arcs for base (150 points,
//!   joints 1 and 2) and tool (153 points, the last three joints).
//! - [`frames_from_arcs`] turns measured arcs into base pose and tool, each
//!   with its uncertainty.
//!
//! ```text
//! plan ─▶ (some tracker measures) ─▶ Measured ─▶ frames_from_arcs ─▶ validate
//!                                        └─────▶ identify (absolute points)
//! ```

mod chain;
mod circle;
mod frames;
mod plan;

pub use circle::{Circle, CircleError, fit_circle};
pub use frames::{LaserError, MeasuredFrames, frames_from_arcs, split_arcs};
pub use plan::{
    BASE_ARC_POINTS, CALIBRATION_POINTS, PlanError, Spread, TABLE_3, TABLE_4, TOOL_ARC_POINTS, VALIDATION_POINTS, plan,
};

pub(crate) use chain::Chain;

use serde::{Deserialize, Serialize};

/// One configuration and where the tracker saw the TCP.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Joint angles as the encoders gave them, base to flange, in rad.
    pub q: Vec<f64>,
    /// The TCP in the tracker frame, in m.
    pub point_m: [f64; 3],
}

/// A planned arc: one joint turns, the others rest.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Arc {
    /// The joint that turns, from 1.
    pub joint: usize,
    /// Joint angles in rad, in the order of motion.
    pub configurations: Vec<Vec<f64>>,
}

/// A measured arc.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredArc {
    /// The joint that turned, from 1.
    pub joint: usize,
    /// What was measured, in the order of motion.
    pub measured: Vec<Measured>,
}

/// What the tracker is to measure, as joint angles in rad.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct LaserPlan {
    /// Configurations to calibrate from (284, Table 3).
    pub calibration: Vec<Vec<f64>>,
    /// Other configurations to judge by (125, Table 4).
    pub validation: Vec<Vec<f64>>,
    /// Arcs of joints 1 and 2 (75 points each).
    pub base_arcs: Vec<Arc>,
    /// Arcs of the last three joints (51 points each).
    pub tool_arcs: Vec<Arc>,
}
