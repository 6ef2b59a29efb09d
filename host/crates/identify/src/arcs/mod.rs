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
pub use frames::{LaserError, MeasuredFrames, frames_from_arcs};

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

/// Splits a series of measurements into arcs. A new arc begins when another joint starts to turn.
/// Steps below 3 mrad count as rest.
pub fn split_arcs(measured: &[Measured]) -> Vec<MeasuredArc> {
    const REST_RAD: f64 = 3e-3;
    let mut arcs: Vec<MeasuredArc> = Vec::new();
    let mut open: Vec<Measured> = Vec::new();
    let mut moving: Option<usize> = None;
    let mut close = |open: &mut Vec<Measured>, moving: Option<usize>| {
        let measured = std::mem::take(open);
        if let Some(joint) = moving.filter(|_| measured.len() > 1) {
            arcs.push(MeasuredArc {
                joint: joint + 1,
                measured,
            });
        }
    };
    for m in measured {
        if let Some(previous) = open.last() {
            let turned: Vec<usize> = (0..m.q.len().min(previous.q.len()))
                .filter(|i| (m.q[*i] - previous.q[*i]).abs() > REST_RAD)
                .collect();
            match (turned.as_slice(), moving) {
                ([], _) => {}
                ([joint], None) => moving = Some(*joint),
                ([joint], Some(same)) if *joint == same => {}
                _ => {
                    close(&mut open, moving);
                    moving = None;
                }
            }
        }
        open.push(m.clone());
    }
    close(&mut open, moving);
    arcs
}
