//! Base and tool from a tracker's arcs (Section 4.3 of the paper), independent of any calibration.
//!
//! Vocabulary. A *configuration* is one vector of joint angles. An *arc* is a series of
//! configurations in which one joint turns and the others rest; the TCP then moves on a circle
//! about that joint's axis. The *tracker frame* is the frame of the measured points. *Arc-measured*
//! frames are the robot's base and tool computed from the axes of arcs.
//!
//! ```text
//! (some tracker measures) ─▶ Measured ─▶ frames_from_arcs ─▶ validate
//!                                └─────▶ identify (absolute points)
//! ```

mod circle;
mod frames;

pub use circle::{Circle, CircleError, fit_circle};
pub use frames::{LaserError, MeasuredFrames, frames_from_arcs, split_arcs};

use serde::{Deserialize, Serialize};

/// One configuration and where the tracker saw the TCP.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Measured {
    /// Joint angles as the encoders gave them, base to flange, in rad.
    pub q: Vec<f64>,
    /// The TCP in the tracker frame, in m.
    pub point_m: [f64; 3],
}

/// A measured arc.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct MeasuredArc {
    /// The joint that turned, from 1.
    pub joint: usize,
    /// What was measured, in the order of motion.
    pub measured: Vec<Measured>,
}
