//! What a store keeps of a past calibration for [`history`](crate::history).

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};
use spherecal_model::fit_pose;
use spherecal_model::halton::spread;
use spherecal_shared::robot::Robot;

/// Name of a fingerprint among a run's results.
pub const FINGERPRINT: &str = "fingerprint";
/// Name of the headline among a run's results.
pub(super) const HEADLINE: &str = "headline";
/// Configurations of a fingerprint.
pub(super) const POINTS: usize = 60;

/// One past calibration as a store gives it.
#[derive(Clone, Debug, PartialEq)]
pub struct StoredPast {
    pub(super) run: i64,
    pub(super) created_utc: String,
    pub(super) robot: String,
    pub(super) arm: String,
    pub(super) state: String,
    /// As JSON; `None` if the run has no result.
    pub(super) headline: Option<String>,
    /// As JSON.
    pub(super) fingerprint: Option<String>,
}

/// Where a calibrated model puts the TCP.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Fingerprint {
    /// TCP in F0, in m.
    pub points_m: Vec<[f64; 3]>,
    /// Root mean square uncertainty of these positions, in mm.
    pub sigma_mm: f64,
}

/// Configurations over the middle half of a robot's joint ranges, in rad.
fn configurations(robot: &Robot) -> Vec<Vec<f64>> {
    let limits = || robot.joints.iter().map(|joint| &joint.limits);
    (1..=POINTS)
        .map(|index| spread(limits(), index, 0.5, f64::INFINITY))
        .collect()
}

impl Fingerprint {
    /// The fingerprint of a calibrated model of `robot`. `tcp_m` gives the TCP in F0 (m) at joint
    /// angles in rad. `variance_m2` gives the trace of its covariance there, in m².
    pub fn of(robot: &Robot, tcp_m: impl Fn(&[f64]) -> Vector3<f64>, variance_m2: impl Fn(&[f64]) -> f64) -> Self {
        let configurations = configurations(robot);
        let variance: f64 = configurations.iter().map(|q| variance_m2(q)).sum();
        Self {
            points_m: configurations.iter().map(|q| tcp_m(q).into()).collect(),
            sigma_mm: (variance / POINTS as f64).sqrt() * 1e3,
        }
    }

    /// Mean distance to another fingerprint after the best rigid motion, in mm; `None` if they
    /// belong to different kinds of robot.
    pub fn moved_mm(&self, other: &Self) -> Option<f64> {
        if self.points_m.len() != other.points_m.len() || self.points_m.is_empty() {
            return None;
        }
        let vectors = |points: &[[f64; 3]]| points.iter().map(|p| Vector3::from(*p)).collect::<Vec<_>>();
        let (from, to) = (vectors(&self.points_m), vectors(&other.points_m));
        let pose = fit_pose(&from, &to)?;
        let sum: f64 = from.iter().zip(&to).map(|(a, b)| (pose.point(a) - b).norm()).sum();
        Some(sum / from.len() as f64 * 1e3)
    }
}
