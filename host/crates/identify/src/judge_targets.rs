//! Errors of what a row tells besides the TCP: further targets, and the orientation of the measured body.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::errors::{SampleError, error};
use super::parts::rotation_vector;
use super::targets::{further_targets, orientation_of};
use crate::Pose;
use crate::recordings::Judge;

/// Tells where target `number` (from 1: target 2) is in F0, in m, at joint angles and torques.
pub type TargetTcp<'a> = Box<dyn Fn(usize, &[f64], Option<&[f64]>) -> Vector3<f64> + Sync + 'a>;
/// Tells the orientation of the measured body in F0.
pub type BodyOrientation<'a> = Box<dyn Fn(&[f64], Option<&[f64]>) -> Matrix3<f64> + Sync + 'a>;

/// What a model predicts of the tool besides the TCP.
#[derive(Default)]
pub struct ToolPredictor<'a> {
    /// Targets besides the TCP.
    pub targets: usize,
    /// Where they are in F0.
    pub target_m: Option<TargetTcp<'a>>,
    /// How the measured body is turned in F0.
    pub body: Option<BodyOrientation<'a>>,
}

/// The error of one further target of a row.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Further {
    /// Number of the target, from 1: target 2.
    pub number: usize,
    /// Its error.
    pub error: SampleError,
}

/// The error of one measured orientation.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Turned {
    /// Index of the sample among those judged.
    pub index: usize,
    /// Orientation of the measured body in F0 by the model.
    pub at: Matrix3<f64>,
    /// Angle between model and measurement, in rad.
    pub angle_rad: f64,
}

/// Statistics of angles, in mrad.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct AngleStatistics {
    /// Samples.
    pub n: usize,
    /// Mean angle.
    pub mean_mrad: f64,
    /// Root mean square.
    pub rms_mrad: f64,
    /// Largest angle.
    pub max_mrad: f64,
}

/// Puts F0 at `pose` in the frame of the measurements, for further targets and orientations.
pub(crate) fn align_further(further: &mut [Further], turned: &mut [Turned], pose: &Pose, judges: &[Judge<'_>]) {
    for own in further {
        let target = judges.get(own.error.index).map(|j| &j.observation.target);
        let truth = target.and_then(|t| further_targets(t).find(|t| t.0 == own.number));
        if let Some((_, truth)) = truth {
            let at = Vector3::from(own.error.at_m);
            own.error = error(own.error.index, &at, &(pose.point(&at) - truth));
        }
    }
    for own in turned {
        let target = judges.get(own.index).map(|j| &j.observation.target);
        if let Some(measured) = target.and_then(orientation_of) {
            own.angle_rad = angle(pose, &own.at, &measured);
        }
    }
}

/// Angle between a body's orientation in F0 and the measured one, in rad.
fn angle(pose: &Pose, at: &Matrix3<f64>, measured: &Matrix3<f64>) -> f64 {
    rotation_vector(&(pose.rotation * at * measured.transpose())).norm()
}

/// Adds the errors of a row's further targets and orientation; `pose` is F0 in their frame.
pub(crate) fn further_errors(
    further: &mut Vec<Further>,
    turned: &mut Vec<Turned>,
    tool: &ToolPredictor<'_>,
    judge: &Judge<'_>,
    pose: &Pose,
) {
    let (q, tau) = (&judge.observation.q, judge.observation.tau.as_deref());
    if let Some(target_m) = &tool.target_m {
        for (number, truth) in further_targets(&judge.observation.target).filter(|t| t.0 <= tool.targets) {
            let at = target_m(number, q, tau);
            further.push(Further {
                number,
                error: error(judge.index, &at, &(pose.point(&at) - truth)),
            });
        }
    }
    if let (Some(body), Some(measured)) = (&tool.body, orientation_of(&judge.observation.target)) {
        let at = body(q, tau);
        turned.push(Turned {
            index: judge.index,
            at,
            angle_rad: angle(pose, &at, &measured),
        });
    }
}
