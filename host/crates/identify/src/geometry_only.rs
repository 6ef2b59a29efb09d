//! The best geometry alone under a full model, for files that hold no effects.
//!
//! A table of links cannot hold compliance, bending or encoder harmonics. The full
//! model's own table without them is not the best table: the effects leave a mean
//! displacement that lengths and offsets can take up. This is the table, tool and
//! base that come closest to the full model's TCP over the workspace.

use nalgebra::Vector3;
use spherecal_model::fit_pose;
use spherecal_shared::robot::{Robot, Tool};

use crate::evaluate::Flange;
use crate::verdict::ExpectedError;
use crate::{
    Calibration, Experiment, IdentifyError, Method, Noise, Observation, Options, Pose, Set, Target,
    halton_configurations,
};

/// Configurations of the workspace that the geometry is fitted at; as many others judge it.
const CONFIGURATIONS: usize = 200;
/// What a point is worth (m): far below every prior, so that the points decide.
const POINT_M: f64 = 1e-6;
/// Noise of a joint (rad): so small that all directions of the error count alike.
const JOINT_RAD: f64 = 1e-9;

/// A geometry alone, and how good it is.
#[derive(Clone, Debug)]
pub struct GeometryOnly {
    /// The robot with its table of links.
    pub robot: Robot,
    /// Its tool.
    pub tool: Tool,
    /// Mean distance of its TCP from the full model's over the workspace, the base
    /// aligned, in mm.
    pub apart_mm: f64,
    /// Its expected error over the workspace; none where that of the full model is unknown.
    pub expected_error_mm: Option<ExpectedError>,
}

/// The best geometry alone under a calibration.
///
/// # Errors
/// No convergence.
pub(crate) fn geometry_only(calibration: &Calibration) -> Result<GeometryOnly, IdentifyError> {
    let all = halton_configurations(&calibration.robot, 2 * CONFIGURATIONS);
    let (fitted, judging) = all.split_at(CONFIGURATIONS);
    let observations = fitted.iter().map(|q| Observation {
        q: q.clone(),
        tau: None,
        target: Target::Point(calibration.tcp_m(q, None).into()),
        set: Set::Calibrate,
    });
    let experiment = Experiment {
        robot: calibration.robot.clone(),
        tool: calibration.tool,
        spheres: Vec::new(),
        observations: observations.collect(),
    };
    let options = Options {
        method: Method::Geometry,
        student_t: 0.0,
        base: Some(Pose::default()),
        noise: Noise {
            joint_rad: JOINT_RAD,
            point_m: POINT_M,
            estimate: false,
            inflation: 1.0,
            ..Noise::default()
        },
        ..Options::default()
    };
    let found = crate::identify(&experiment, &options)?;
    let flange = Flange::new(&found.robot);
    let tcp = found.tool.tcp();
    let own: Vec<Vector3<f64>> = judging.iter().map(|q| flange.at(q).point(&tcp)).collect();
    let full: Vec<Vector3<f64>> = judging.iter().map(|q| calibration.tcp_m(q, None)).collect();
    let base = fit_pose(&own, &full).unwrap_or_else(Pose::identity);
    let off: Vec<Vector3<f64>> = own.iter().zip(&full).map(|(a, b)| base.point(a) - b).collect();
    let apart_mm = off.iter().map(Vector3::norm).sum::<f64>() / off.len().max(1) as f64 * 1e3;
    Ok(GeometryOnly {
        robot: found.robot,
        tool: found.tool,
        apart_mm,
        expected_error_mm: ExpectedError::of(calibration, judging, Some(&off)),
    })
}

#[cfg(test)]
#[path = "geometry_only_tests.rs"]
mod tests;
