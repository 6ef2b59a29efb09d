//! How far a model is from samples that it has not seen.
//!
//! Where the frame of a sample is known from the fit, the error is the distance
//! between predicted and true TCP there. Where it is not (a place of the plate
//! that was held out), nothing says where the plate stood; what remains is what
//! the calibration is for: that one sphere is one point. The error is then the
//! distance to the mean over the sphere's own samples.

use std::collections::{BTreeMap, HashMap};

use nalgebra::Vector3;
use rayon::prelude::*;
use serde::Serialize;

use super::causes::log_tail;
use super::errors::{Errors, SampleError, error};
use super::judge_targets::{AngleStatistics, Further, ToolPredictor, Turned, align_further, further_errors};
use super::targets::{first_target, frame_of, measured_tcp};
use spherecal_model::fit_pose;

use crate::recordings::Judge;
use crate::{Pose, Reference, Sphere, Target};

/// Tells the TCP in F0 (m) at joint angles and, where measured, torques.
pub type TcpFunction<'a> = Box<dyn Fn(&[f64], Option<&[f64]>) -> Vector3<f64> + Sync + 'a>;

/// A model that predicts: the TCP in F0, and where F0 is in each frame.
pub struct Predictor<'a> {
    /// Name, such as `nominal`.
    pub name: &'static str,
    /// The TCP in F0.
    pub tcp_m: TcpFunction<'a>,
    /// F0 in each frame.
    pub frames: Vec<(Reference, Pose)>,
    /// Targets 2.. and the measured body, where the data have them.
    pub tool: ToolPredictor<'a>,
}

/// One model's errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct JudgedModel {
    /// Model.
    pub name: String,
    /// By sample.
    #[serde(skip)]
    pub samples: Vec<SampleError>,
    /// Errors of targets 2..
    #[serde(skip)]
    pub further: Vec<Further>,
    /// Errors of measured orientations.
    #[serde(skip)]
    pub turned: Vec<Turned>,
    /// Errors of distances between the mean positions of the spheres of one
    /// place, in mm, where the frame was not known: `(place, sphere, sphere, error)`.
    pub distances_mm: Vec<(u32, u32, u32, f64)>,
}

impl JudgedModel {
    /// Probability that its mean error is the smaller one, by how the differences between rows scatter; `None` of fewer than two.
    pub(crate) fn better_than(&self, other: &Self) -> Option<f64> {
        let pairs = other.samples.iter().zip(&self.samples);
        let gains: Vec<f64> = pairs.map(|(other, own)| other.distance_mm - own.distance_mm).collect();
        let count = gains.len() as f64;
        let mean = gains.iter().sum::<f64>() / count;
        let variance = gains.iter().map(|gain| (gain - mean).powi(2)).sum::<f64>() / (count - 1.0);
        let sigmas = mean / (variance / count).sqrt();
        let beyond = 0.5 * log_tail(sigmas * sigmas, 1).exp();
        let sure = if sigmas > 0.0 { 1.0 - beyond } else { beyond };
        sigmas.is_finite().then_some(sure)
    }

    /// Statistics over the samples.
    pub fn errors(&self) -> Errors {
        let d: Vec<f64> = self.samples.iter().map(|s| s.distance_mm).collect();
        Errors::of(&d)
    }

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
    pub fn turns(&self) -> Option<AngleStatistics> {
        let angles: Vec<f64> = self.turned.iter().map(|t| t.angle_rad * 1e3).collect();
        let e = Errors::of(&angles);
        (e.n > 0).then_some(AngleStatistics {
            n: e.n,
            mean_mrad: e.mean_mm,
            rms_mrad: e.rms_mm,
            max_mrad: e.max_mm,
        })
    }

    /// Mean size of the errors of distances between spheres, in mm.
    pub fn mean_distance_error_mm(&self) -> f64 {
        let n = self.distances_mm.len().max(1) as f64;
        self.distances_mm.iter().map(|d| d.3.abs()).sum::<f64>() / n
    }
}

/// Samples judged by several models.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Judged {
    /// What was judged, in words.
    pub by: String,
    /// By model, in the order asked for.
    pub models: Vec<JudgedModel>,
}

impl Judged {
    /// A model's errors by name.
    pub fn model(&self, name: &str) -> Option<&JudgedModel> {
        self.models.iter().find(|m| m.name == name)
    }

    /// Errors of measured points after the best rigid motion of all of them, by
    /// model: what is left when the base is aligned to the judges' own frame.
    /// `judges` are the rows in the order of their numbers, from 0.
    pub fn base_aligned(&self, judges: &[Judge<'_>]) -> Self {
        let mut out = self.clone();
        for model in &mut out.models {
            let mut pairs = Vec::new();
            for (k, s) in model.samples.iter().enumerate() {
                if let Some(p) = judges.get(s.index).and_then(|j| measured_tcp(&j.observation.target)) {
                    pairs.push((k, Vector3::from(s.at_m), p));
                }
            }
            let from: Vec<_> = pairs.iter().map(|p| p.1).collect();
            let onto: Vec<_> = pairs.iter().map(|p| p.2).collect();
            let Some(pose) = fit_pose(&from, &onto) else { continue };
            for (k, tcp, truth) in pairs {
                if let Some(slot) = model.samples.get_mut(k) {
                    *slot = error(slot.index, &tcp, &(pose.point(&tcp) - truth));
                }
            }
            align_further(&mut model.further, &mut model.turned, &pose, judges);
        }
        out
    }

    /// Where the points stand in another frame than was said (every model is more
    /// than 20 mm off as a whole, and a rigid motion takes nine tenths of it away),
    /// takes the best rigid motion out. Returns how far they were, in mm.
    pub fn realign_if_elsewhere(&mut self, judges: &[Judge<'_>]) -> Option<f64> {
        let aligned = self.base_aligned(judges);
        let mean = |j: &Self| {
            j.models
                .iter()
                .map(|m| m.errors().mean_mm)
                .fold(f64::INFINITY, f64::min)
        };
        let (own, fitted) = (mean(self), mean(&aligned));
        let enough = judges.len() >= 6;
        (enough && own > 20.0 && fitted < 0.1 * own).then(|| {
            *self = aligned;
            own
        })
    }

    /// Adds the samples of another judgement, model by model.
    pub fn extend(&mut self, other: Self) {
        for model in other.models {
            if let Some(own) = self.models.iter_mut().find(|m| m.name == model.name) {
                own.samples.extend(model.samples);
                own.further.extend(model.further);
                own.turned.extend(model.turned);
                own.distances_mm.extend(model.distances_mm);
            } else {
                self.models.push(model);
            }
        }
    }
}

/// Judges rows by several models.
pub fn judge(
    models: &[Predictor<'_>],
    judges: &[Judge<'_>],
    spheres: &[Sphere],
    closed_loop: bool,
    by: &str,
) -> Judged {
    let models = models
        .iter()
        .map(|model| judge_one(model, judges, spheres, closed_loop))
        .collect();
    Judged {
        by: by.to_owned(),
        models,
    }
}

/// Rows in a frame that nothing fixed: by what they belong to, the number of the
/// row, the TCP, and the truth.
type Loose<K> = BTreeMap<K, Vec<(usize, Vector3<f64>, Vector3<f64>)>>;

fn judge_one(model: &Predictor<'_>, judges: &[Judge<'_>], spheres: &[Sphere], closed_loop: bool) -> JudgedModel {
    let frames: HashMap<Reference, &Pose> = model.frames.iter().map(|(r, p)| (*r, p)).collect();
    let tcps: Vec<Vector3<f64>> = judges
        .par_iter()
        .map(|j| (model.tcp_m)(&j.observation.q, j.observation.tau.as_deref()))
        .collect();
    let mut out = JudgedModel {
        name: model.name.to_owned(),
        samples: Vec::with_capacity(judges.len()),
        ..JudgedModel::default()
    };
    let (mut contacts, mut points) = (Loose::<(u32, u32)>::new(), Loose::<Reference>::new());
    for (judge, tcp) in judges.iter().zip(&tcps) {
        let target = &judge.observation.target;
        let reference = frame_of(target, judge.place, closed_loop);
        if let Some(pose) = frames.get(&reference) {
            further_errors(&mut out.further, &mut out.turned, &model.tool, judge, pose);
        }
        let Some(truth) = first_target(target, spheres) else {
            continue;
        };
        match (frames.get(&reference), target) {
            (Some(pose), _) => out.samples.push(error(judge.index, tcp, &(pose.point(tcp) - truth))),
            (None, &Target::Sphere { sphere, place }) => {
                contacts
                    .entry((place, sphere))
                    .or_default()
                    .push((judge.index, *tcp, truth));
            }
            (None, _) => points.entry(reference).or_default().push((judge.index, *tcp, truth)),
        }
    }
    judge_contacts(&mut out, &contacts, spheres);
    for own in points.values() {
        // A frame of its own: the best rigid fit of the rows themselves.
        let from: Vec<_> = own.iter().map(|l| l.1).collect();
        let onto: Vec<_> = own.iter().map(|l| l.2).collect();
        let pose = fit_pose(&from, &onto).unwrap_or_default();
        for (index, tcp, truth) in own {
            out.samples.push(error(*index, tcp, &(pose.point(tcp) - truth)));
        }
    }
    out.samples.sort_by_key(|s| s.index);
    out
}

/// One sphere is one point: distances to the mean over its own rows, and between
/// those means against the certificate.
fn judge_contacts(out: &mut JudgedModel, contacts: &Loose<(u32, u32)>, spheres: &[Sphere]) {
    let mut means: Vec<((u32, u32), Vector3<f64>)> = Vec::with_capacity(contacts.len());
    for (key, own) in contacts {
        let mean = own.iter().map(|l| l.1).sum::<Vector3<f64>>() / own.len() as f64;
        for (index, tcp, _) in own {
            out.samples.push(error(*index, tcp, &(tcp - mean)));
        }
        means.push((*key, mean));
    }
    let certified = |id: u32| spheres.iter().find(|s| s.id == id).map(|s| Vector3::from(s.position_m));
    // Sorted by place, so the spheres of one place stand together.
    for (a, ((place, one), first)) in means.iter().enumerate() {
        for ((_, two), second) in means[a + 1..].iter().take_while(|m| m.0.0 == *place) {
            if let (Some(p), Some(q)) = (certified(*one), certified(*two)) {
                let off = (first - second).norm() - (p - q).norm();
                out.distances_mm.push((*place, *one, *two, off * 1e3));
            }
        }
    }
}

/// One value of the hold-out column.
#[derive(Clone, Debug)]
pub struct Fold {
    /// The value.
    pub value: String,
    /// The samples that have it, judged by a fit without them.
    pub judged: Judged,
}

/// All values of a column, held out one after the other.
#[derive(Clone, Debug)]
pub struct HeldOut {
    /// The column.
    pub column: String,
    /// By value.
    pub folds: Vec<Fold>,
    /// All of them together.
    pub pooled: Judged,
}

#[cfg(test)]
mod tests {
    use super::{JudgedModel, SampleError};

    fn model(distances_mm: impl IntoIterator<Item = f64>) -> JudgedModel {
        let sample = |distance_mm| SampleError {
            index: 0,
            at_m: [0.0; 3],
            error_mm: [distance_mm, 0.0, 0.0],
            distance_mm,
        };
        JudgedModel {
            samples: distances_mm.into_iter().map(sample).collect(),
            ..JudgedModel::default()
        }
    }

    // Fails if a gain within the scatter of the rows is one, if a small gain that all rows have is none, if a loss is a gain, or if one
    // row tells anything.
    #[test]
    fn a_gain_is_one_beyond_chance() {
        let scattered = |k: u32| if k.is_multiple_of(2) { 0.2 } else { 2.0 };
        let nominal = model((0..60).map(|k| 1.11 + 0.01 * f64::from(k % 3)));
        let chance = model((0..60).map(scattered)).better_than(&nominal).unwrap();
        assert!((0.5..0.9).contains(&chance), "{chance}");
        let small = model((0..60).map(|k| 1.05 + 0.02 * f64::from(k % 2)));
        let (gain, loss) = (
            small.better_than(&nominal).unwrap(),
            nominal.better_than(&small).unwrap(),
        );
        assert!(gain > 0.999 && loss < 0.001, "{gain} and {loss}");
        assert!(model([0.1]).better_than(&model([1.0])).is_none());
    }
}
