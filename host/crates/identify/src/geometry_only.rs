//! The best geometry alone under a full model, for files that hold no effects.
//!
//! A table of links cannot hold compliance, bending or encoder harmonics. The full
//! model's own table without them is not the best table: the effects leave a mean
//! displacement that lengths and offsets can take up. This is the table, tool and
//! base that come closest to the full model's TCP over the joints' whole ranges.

use nalgebra::Vector3;
use spherecal_model::fit_pose;
use spherecal_shared::robot::{Robot, Tool};

use crate::expected_error::ExpectedError;
use crate::flange::Flange;
use crate::{
    Calibration, Experiment, IdentifyError, Method, Noise, Observation, Options, Pose, Set, Target,
    halton_configurations,
};

/// Configurations over the joints' whole ranges that the geometry is fitted at; as many others judge it.
const CONFIGURATIONS: usize = 200;
/// Least noise of a point (m), for a model without effects: far below every prior.
const LEAST_NOISE_M: f64 = 1e-6;
/// Noise of a joint (rad): so small that all directions of the error count alike.
const JOINT_RAD: f64 = 1e-9;

/// A geometry alone, and how good it is.
#[derive(Clone, Debug)]
pub struct GeometryOnly {
    /// The robot with its table of links.
    pub robot: Robot,
    /// Its tool.
    pub tool: Tool,
    /// Mean distance of its TCP from the full model's over the joints' whole ranges, the base
    /// aligned, in mm.
    pub apart_mm: f64,
    /// Its expected error over the same configurations, by the posterior alone; none where that of the full model is unknown.
    pub expected_error_mm: Option<ExpectedError>,
}

impl Calibration {
    /// The best table, tool and base without any effect, for files that hold geometry alone.
    ///
    /// # Errors
    /// No convergence.
    pub fn geometry_only(&self) -> Result<GeometryOnly, IdentifyError> {
        geometry_only(self)
    }
}

fn geometry_only(calibration: &Calibration) -> Result<GeometryOnly, IdentifyError> {
    let all = halton_configurations(&calibration.robot, 2 * CONFIGURATIONS);
    let (fitted, judging) = all.split_at(CONFIGURATIONS);
    let observations = fitted.iter().map(|q| Observation {
        seat: None,
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
    let bare = TableDeviation::of(&calibration.robot, &calibration.tool, calibration, fitted);
    let options = Options {
        method: Method::Geometry,
        student_t: 0.0,
        base: Some(Pose::default()),
        noise: Noise {
            joint_rad: JOINT_RAD,
            // What the effects add to the bare table is noise to a geometry: with less, directions
            // that hardly move the TCP would be bent to fit it.
            point_m: bare.rms_m().max(LEAST_NOISE_M),
            estimate: false,
            inflation: 1.0,
            ..Noise::default()
        },
        ..Options::default()
    };
    let found = crate::identify(&experiment, &options)?;
    let best = TableDeviation::of(&found.robot, &found.tool, calibration, judging);
    let bare = TableDeviation::of(&calibration.robot, &calibration.tool, calibration, judging);
    // Where the effects leave nothing to take up, the table stays as it is.
    let (robot, tool, table) = if best.mean_mm() < bare.mean_mm() {
        (found.robot, found.tool, best)
    } else {
        (calibration.robot.clone(), calibration.tool, bare)
    };
    Ok(GeometryOnly {
        robot,
        tool,
        apart_mm: table.mean_mm(),
        expected_error_mm: ExpectedError::of(calibration, judging, Some(&table.off)),
    })
}

/// A table of links and a tool against the full model.
struct TableDeviation {
    /// From the full model's TCP to the table's at each configuration, the base aligned (m).
    off: Vec<Vector3<f64>>,
}

impl TableDeviation {
    fn of(robot: &Robot, tool: &Tool, full: &Calibration, configurations: &[Vec<f64>]) -> Self {
        let flange = Flange::new(robot);
        let tcp = tool.tcp();
        let own: Vec<Vector3<f64>> = configurations.iter().map(|q| flange.at(q).point(&tcp)).collect();
        let full: Vec<Vector3<f64>> = configurations.iter().map(|q| full.tcp_m(q, None)).collect();
        let base = fit_pose(&own, &full).unwrap_or_else(Pose::identity);
        Self {
            off: own.iter().zip(&full).map(|(a, b)| base.point(a) - b).collect(),
        }
    }

    fn mean_mm(&self) -> f64 {
        self.off.iter().map(Vector3::norm).sum::<f64>() / self.off.len().max(1) as f64 * 1e3
    }

    /// Root mean square of one coordinate (m).
    fn rms_m(&self) -> f64 {
        let sum: f64 = self.off.iter().map(Vector3::norm_squared).sum();
        (sum / (3 * self.off.len()).max(1) as f64).sqrt()
    }
}

#[cfg(test)]
#[path = "geometry_only_tests.rs"]
mod tests;
