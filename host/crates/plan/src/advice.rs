//! Which further pose on a sphere would tell most about the robot, given the poses that were already recorded.
//!
//! The covariance of the full model's parameters starts at their priors and shrinks with each recorded pose. A candidate
//! is judged by how much it would reduce the mean variance of the predicted TCP over the workspace.

use nalgebra::{DMatrix, Matrix3, Rotation3, Vector3};
use spherecal_identify::{DesignModel, IdentifyError, Options};
use spherecal_model::Sphere;
use spherecal_model::chain::{Chain, TcpPose};
use spherecal_model::halton::spread;
use spherecal_shared::robot::{Robot, Tool};

/// Configurations over which the variance of the predicted TCP is averaged.
const PREDICTIONS: usize = 40;
/// Smallest distance of a suggested pose from the joint limits, in rad.
const MARGIN_RAD: f64 = 0.1;

/// What the recorded poses have told, and what a further one would tell.
#[derive(Clone, Debug)]
pub struct PoseAdvice {
    model: DesignModel,
    chain: Chain,
    covariance: DMatrix<f64>,
    predictions: Vec<DMatrix<f64>>,
}

/// The most useful further pose.
#[derive(Clone, Debug, PartialEq)]
pub struct Advised {
    /// Joint angles, in rad.
    pub joints: Vec<f64>,
    /// Part of the mean variance of the predicted TCP that it would remove, from 0 to 1.
    pub gain: f64,
}

impl PoseAdvice {
    /// No pose is recorded yet. `places`: number of placements of the plate.
    ///
    /// # Errors
    /// A robot or options that cannot be used.
    pub fn new(
        robot: &Robot,
        tool: &Tool,
        spheres: &[Sphere],
        places: u32,
        options: &Options,
    ) -> Result<Self, IdentifyError> {
        let model = DesignModel::new(robot, tool, spheres, places, options)?;
        let chain = Chain::unchecked(robot, tool);
        let m = model.columns();
        let predictions = (0..PREDICTIONS)
            .map(|k| {
                let q = spread(chain.limits(), k + 1, 1.0, f64::INFINITY);
                DMatrix::from_row_slice(3, m, &model.prediction(&q).0)
            })
            .collect();
        Ok(Self {
            chain,
            covariance: DMatrix::identity(m, m),
            predictions,
            model,
        })
    }

    /// A pose at `q` (rad) was recorded on this sphere, in this placement (from 0).
    pub fn add(&mut self, q: &[f64], sphere: u32, place: usize) {
        if let Some((gain, _)) = self.gain(q, sphere, place) {
            self.covariance -= gain;
        }
    }

    /// Mean standard deviation of the predicted TCP over the workspace, in m, if the model and its priors are right.
    pub fn expected_m(&self) -> f64 {
        let variance: f64 = self
            .predictions
            .iter()
            .map(|p| (p * &self.covariance * p.transpose()).trace())
            .sum();
        (variance.max(0.0) / PREDICTIONS as f64).sqrt()
    }

    /// The most useful pose near `from` (rad), which is on this sphere. `None` if no other pose is within the joint limits.
    pub fn suggest(&self, from: &[f64], sphere: u32, place: usize) -> Option<Advised> {
        let at = self.chain.pose(from);
        let before: f64 = self.expected_m().powi(2) * PREDICTIONS as f64;
        turned(&at)
            .iter()
            .filter_map(|pose| self.chain.solve_from(pose, from))
            .filter(|q| self.chain.limit_margin(q) > MARGIN_RAD)
            .filter_map(|joints| {
                let (_, removed) = self.gain(&joints, sphere, place)?;
                Some(Advised {
                    joints,
                    gain: removed / before,
                })
            })
            .max_by(|a, b| a.gain.total_cmp(&b.gain))
    }

    /// What a pose removes from the covariance, and from the sum of the predictions' variances.
    fn gain(&self, q: &[f64], sphere: u32, place: usize) -> Option<(DMatrix<f64>, f64)> {
        let m = self.covariance.nrows();
        let rows = DMatrix::from_row_slice(3, m, &self.model.observation(q, sphere, place));
        let seen = &rows * &self.covariance;
        let innovation = Matrix3::identity() + Matrix3::from_iterator((&seen * rows.transpose()).iter().copied());
        let inverse = DMatrix::from_column_slice(3, 3, innovation.try_inverse()?.as_slice());
        let removed = self
            .predictions
            .iter()
            .map(|p| {
                let cross = p * seen.transpose();
                (&cross * &inverse * cross.transpose()).trace()
            })
            .sum();
        Some((seen.transpose() * inverse * &seen, removed))
    }
}

/// The same TCP with the tool tilted and turned, and with another elbow.
fn turned(at: &TcpPose) -> Vec<TcpPose> {
    let turn = |axis: Vector3<f64>, degrees: f64| TcpPose {
        rotation: at.rotation * Rotation3::new(axis * degrees.to_radians()),
        ..*at
    };
    let mut poses = Vec::new();
    for tilt in [-30.0, -15.0, 15.0, 30.0] {
        poses.push(turn(Vector3::x(), tilt));
        poses.push(turn(Vector3::y(), tilt));
    }
    for spin in [-90.0, -45.0, 45.0, 90.0] {
        poses.push(turn(Vector3::z(), spin));
    }
    for change in [-0.8, -0.4, 0.4, 0.8] {
        poses.extend(at.elbow.map(|elbow| TcpPose {
            elbow: Some(elbow + change),
            ..*at
        }));
    }
    poses
}

#[cfg(test)]
mod tests {
    use super::*;
    use spherecal_model::paper_plate;
    use spherecal_model::robots;

    // Fails if a repeated pose counts as much as the suggested one, a recorded pose does not reduce the expected
    // deviation, or a suggestion leaves the sphere.
    #[test]
    fn the_suggested_pose_tells_more_than_the_same_pose_again() {
        let model = robots::load("panda").expect("built in");
        let tool = model.tool_in_table();
        let mut advice = PoseAdvice::new(&model.robot, &tool, &paper_plate(), 1, &Options::default()).expect("a model");
        let q = [0.2, -0.3, 0.1, -2.0, 0.3, 1.8, 0.6];
        let before = advice.expected_m();
        advice.add(&q, 1, 0);
        let once = advice.expected_m();
        assert!(once <= before);
        let advised = advice.suggest(&q, 1, 0).expect("a pose");
        let chain = Chain::unchecked(&model.robot, &tool);
        let moved = chain.pose(&advised.joints).position - chain.pose(&q).position;
        assert!(moved.norm() < 1e-6);
        let after = |q: &[f64]| {
            let mut next = advice.clone();
            next.add(q, 1, 0);
            next.expected_m()
        };
        assert!(after(&advised.joints) < after(&q));
        let predicted = once * (1.0 - advised.gain).sqrt();
        assert!((after(&advised.joints) - predicted).abs() < 1e-9);
    }
}
