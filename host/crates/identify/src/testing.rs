//! What several tests begin with.

use nalgebra::Vector3;
use spherecal_shared::robot::{Robot, Tool};

use crate::{Experiment, Observation, Set, Target};

/// Measured points (m) of an arm at `postures` (rad), whose TCP is `tcp_m` there.
pub(crate) fn points(
    (robot, tool): (&Robot, &Tool),
    postures: impl IntoIterator<Item = Vec<f64>>,
    mut tcp_m: impl FnMut(&[f64]) -> Vector3<f64>,
) -> Experiment {
    let row = |q: Vec<f64>| Observation {
        seat: None,
        target: Target::Point(tcp_m(&q).into()),
        q,
        tau: None,
        set: Set::Calibrate,
    };
    Experiment {
        robot: robot.clone(),
        tool: *tool,
        spheres: Vec::new(),
        observations: postures.into_iter().map(row).collect(),
    }
}
