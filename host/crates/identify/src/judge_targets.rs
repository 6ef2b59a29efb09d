//! Errors of what a row tells besides the TCP: further targets, and the orientation of the measured body.

use nalgebra::{Matrix3, Vector3};
use serde::Serialize;

use super::judge::{Errors, JudgedModel, SampleError, ToolPredictor, error};
use super::parts::rotation_vector;
use super::targets::{further_targets, orientation_of};
use crate::Pose;
use crate::recordings::Judge;

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
pub struct Turns {
    /// Samples.
    pub n: usize,
    /// Mean angle.
    pub mean_mrad: f64,
    /// Root mean square.
    pub rms_mrad: f64,
    /// Largest angle.
    pub max_mrad: f64,
}

impl JudgedModel {
    /// Statistics of target `number` of the tool, from 1: the TCP.
    pub fn target_errors(&self, number: usize) -> Errors {
        if number == 1 {
            return self.errors();
        }
        let own = self.further.iter().filter(|f| f.number + 1 == number);
        let distances: Vec<f64> = own.map(|f| f.error.distance_mm).collect();
        Errors::of(&distances)
    }

    /// Statistics of the orientations; none where no row has one.
    pub fn turns(&self) -> Option<Turns> {
        let angles: Vec<f64> = self.turned.iter().map(|t| t.angle_rad * 1e3).collect();
        let e = Errors::of(&angles);
        (e.n > 0).then_some(Turns {
            n: e.n,
            mean_mrad: e.mean_mm,
            rms_mrad: e.rms_mm,
            max_mrad: e.max_mm,
        })
    }

    /// Puts F0 at `pose` in the frame of the measurements, for the further targets and the orientations.
    pub(crate) fn align_further(&mut self, pose: &Pose, judges: &[Judge<'_>]) {
        for own in &mut self.further {
            let target = judges.get(own.error.index).map(|j| &j.observation.target);
            let truth = target.and_then(|t| further_targets(t).find(|t| t.0 == own.number));
            if let Some((_, truth)) = truth {
                let at = Vector3::from(own.error.at_m);
                own.error = error(own.error.index, &at, &(pose.point(&at) - truth));
            }
        }
        for own in &mut self.turned {
            let target = judges.get(own.index).map(|j| &j.observation.target);
            if let Some(measured) = target.and_then(orientation_of) {
                own.angle_rad = angle(pose, &own.at, &measured);
            }
        }
    }
}

/// Angle between a body's orientation in F0 and the measured one, in rad.
fn angle(pose: &Pose, at: &Matrix3<f64>, measured: &Matrix3<f64>) -> f64 {
    rotation_vector(&(pose.rotation * at * measured.transpose())).norm()
}

/// Adds the errors of a row's further targets and orientation; `pose` is F0 in their frame.
pub(crate) fn further_errors(out: &mut JudgedModel, tool: &ToolPredictor<'_>, judge: &Judge<'_>, pose: &Pose) {
    let (q, tau) = (&judge.observation.q, judge.observation.tau.as_deref());
    if let Some(target_m) = &tool.target_m {
        for (number, truth) in further_targets(&judge.observation.target).filter(|t| t.0 <= tool.targets) {
            let at = target_m(number, q, tau);
            out.further.push(Further {
                number,
                error: error(judge.index, &at, &(pose.point(&at) - truth)),
            });
        }
    }
    if let (Some(body), Some(measured)) = (&tool.body, orientation_of(&judge.observation.target)) {
        let at = body(q, tau);
        out.turned.push(Turned {
            index: judge.index,
            at,
            angle_rad: angle(pose, &at, &measured),
        });
    }
}
