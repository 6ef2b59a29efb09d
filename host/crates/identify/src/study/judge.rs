//! How far a model is from samples that it has not seen.
//!
//! Where the frame of a sample is known from the fit, the error is the distance
//! between predicted and true TCP there. Where it is not (a place of the plate
//! that was held out), nothing says where the plate stood; what remains is what
//! the calibration is for: that one sphere is one point. The error is then the
//! distance to the mean over the sphere's own samples.

use nalgebra::Vector3;
use serde::Serialize;

use super::align::reference_of;
use super::load::Sample;
use crate::{Pose, Reference, Sphere, Target};

/// Statistics of distances, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Samples.
    pub n: usize,
    /// Mean distance.
    pub mean_mm: f64,
    /// Standard deviation of the distances.
    pub std_mm: f64,
    /// Smallest distance.
    pub min_mm: f64,
    /// Largest distance.
    pub max_mm: f64,
    /// Root mean square of the distances.
    pub rms_mm: f64,
}

impl Errors {
    /// Of distances in mm.
    pub fn of(distances_mm: &[f64]) -> Self {
        let n = distances_mm.len();
        if n == 0 {
            return Self::default();
        }
        let mean = distances_mm.iter().sum::<f64>() / n as f64;
        let square = distances_mm.iter().map(|d| d * d).sum::<f64>() / n as f64;
        let spread = distances_mm.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n as f64;
        Self {
            n,
            mean_mm: mean,
            std_mm: spread.sqrt(),
            min_mm: distances_mm.iter().copied().fold(f64::INFINITY, f64::min),
            max_mm: distances_mm.iter().copied().fold(0.0, f64::max),
            rms_mm: square.sqrt(),
        }
    }
}

/// A model that predicts: the TCP in F0, and where F0 is in each frame.
pub struct Predictor<'a> {
    /// Name, such as `nominal`.
    pub name: &'static str,
    /// TCP in F0 (m) at joint angles and, where measured, torques.
    pub tcp_m: Box<dyn Fn(&[f64], Option<&[f64]>) -> Vector3<f64> + 'a>,
    /// F0 in each frame.
    pub frames: Vec<(Reference, Pose)>,
}

/// One sample's error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampleError {
    /// Index of the sample among those judged.
    pub index: usize,
    /// Where the TCP is in F0 by the model, in m.
    pub at_m: [f64; 3],
    /// Predicted minus true, in mm.
    pub error_mm: [f64; 3],
    /// Its length.
    pub distance_mm: f64,
}

/// One model's errors.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ModelErrors {
    /// Model.
    pub name: String,
    /// By sample.
    #[serde(skip)]
    pub samples: Vec<SampleError>,
    /// Errors of distances between the mean positions of the spheres of one
    /// place, in mm, where the frame was not known: `(place, sphere, sphere, error)`.
    pub distances_mm: Vec<(u32, u32, u32, f64)>,
}

impl ModelErrors {
    /// Statistics over the samples.
    pub fn errors(&self) -> Errors {
        let d: Vec<f64> = self.samples.iter().map(|s| s.distance_mm).collect();
        Errors::of(&d)
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
    pub models: Vec<ModelErrors>,
}

impl Judged {
    /// A model's errors by name.
    pub fn model(&self, name: &str) -> Option<&ModelErrors> {
        self.models.iter().find(|m| m.name == name)
    }

    /// Errors of measured points after the best rigid motion of all of them, by
    /// model: what is left when the base is aligned to the judges' own frame.
    pub fn base_aligned(&self, samples: &[&Sample]) -> Self {
        let mut out = self.clone();
        for model in &mut out.models {
            let mut pairs = Vec::new();
            for (k, s) in model.samples.iter().enumerate() {
                if let Some(Target::Point(p)) = samples.get(s.index).map(|s| s.observation.target) {
                    pairs.push((k, Vector3::from(s.at_m), Vector3::from(p)));
                }
            }
            let from: Vec<_> = pairs.iter().map(|p| p.1).collect();
            let onto: Vec<_> = pairs.iter().map(|p| p.2).collect();
            let Some(pose) = Pose::fit(&from, &onto) else { continue };
            for (k, tcp, truth) in pairs {
                if let Some(slot) = model.samples.get_mut(k) {
                    *slot = error(slot.index, &tcp, &(pose.point(&tcp) - truth));
                }
            }
        }
        out
    }

    /// Where the points stand in another frame than was said (every model is more
    /// than 20 mm off as a whole, and a rigid motion takes nine tenths of it away),
    /// takes the best rigid motion out. Returns how far they were, in mm.
    pub fn realign_if_elsewhere(&mut self, samples: &[&Sample]) -> Option<f64> {
        let aligned = self.base_aligned(samples);
        let mean = |j: &Self| {
            j.models
                .iter()
                .map(|m| m.errors().mean_mm)
                .fold(f64::INFINITY, f64::min)
        };
        let (own, fitted) = (mean(self), mean(&aligned));
        let enough = samples.len() >= 6;
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
                own.distances_mm.extend(model.distances_mm);
            } else {
                self.models.push(model);
            }
        }
    }
}

/// The frame that a sample's target is given in: points of closed-loop data
/// live in the plate's frame.
fn frame_of(sample: &Sample, closed_loop: bool) -> Reference {
    match (reference_of(&sample.observation.target), closed_loop) {
        (Reference::Tracker, true) => Reference::Place(sample.place),
        (reference, _) => reference,
    }
}

/// Judges samples; `indices` name them for the result.
pub fn judge(
    models: &[Predictor<'_>],
    samples: &[&Sample],
    indices: &[usize],
    spheres: &[Sphere],
    closed_loop: bool,
    by: &str,
) -> Judged {
    let models = models
        .iter()
        .map(|model| judge_one(model, samples, indices, spheres, closed_loop))
        .collect();
    Judged {
        by: by.to_owned(),
        models,
    }
}

fn judge_one(
    model: &Predictor<'_>,
    samples: &[&Sample],
    indices: &[usize],
    spheres: &[Sphere],
    closed_loop: bool,
) -> ModelErrors {
    let mut out = ModelErrors {
        name: model.name.to_owned(),
        ..ModelErrors::default()
    };
    // Samples in frames that nothing fixed, by place and sphere: index, TCP.
    let mut loose: Vec<((u32, u32), usize, Vector3<f64>)> = Vec::new();
    let mut loose_points: Vec<(Reference, usize, Vector3<f64>, Vector3<f64>)> = Vec::new();
    for (sample, &index) in samples.iter().zip(indices) {
        let o = &sample.observation;
        let tcp = (model.tcp_m)(&o.q, o.tau.as_deref());
        let reference = frame_of(sample, closed_loop);
        let pose = model.frames.iter().find(|(r, _)| *r == reference).map(|(_, p)| p);
        let truth: Vector3<f64> = match o.target {
            Target::Point(p) => p.into(),
            Target::Sphere { sphere, .. } => spheres
                .iter()
                .find(|s| s.id == sphere)
                .map_or([0.0; 3], |s| s.position_m)
                .into(),
        };
        match (pose, o.target) {
            (Some(pose), _) => out.samples.push(error(index, &tcp, &(pose.point(&tcp) - truth))),
            (None, Target::Sphere { sphere, place }) => loose.push(((place, sphere), index, tcp)),
            (None, Target::Point(_)) => loose_points.push((reference, index, tcp, truth)),
        }
    }
    judge_loose(&mut out, &loose, spheres);
    let mut references: Vec<Reference> = loose_points.iter().map(|l| l.0).collect();
    references.dedup();
    for reference in references {
        // A frame of its own: the best rigid fit of the samples themselves.
        let own: Vec<_> = loose_points.iter().filter(|l| l.0 == reference).collect();
        let from: Vec<_> = own.iter().map(|l| l.2).collect();
        let onto: Vec<_> = own.iter().map(|l| l.3).collect();
        let pose = Pose::fit(&from, &onto).unwrap_or_default();
        for (_, index, tcp, truth) in own {
            out.samples.push(error(*index, tcp, &(pose.point(tcp) - truth)));
        }
    }
    out.samples.sort_by_key(|s| s.index);
    out
}

/// One sphere is one point: distances to the mean over its own samples, and
/// between those means against the certificate.
fn judge_loose(out: &mut ModelErrors, loose: &[((u32, u32), usize, Vector3<f64>)], spheres: &[Sphere]) {
    let mut keys: Vec<(u32, u32)> = loose.iter().map(|l| l.0).collect();
    keys.sort_unstable();
    keys.dedup();
    let mut means = Vec::with_capacity(keys.len());
    for key in &keys {
        let own: Vec<_> = loose.iter().filter(|l| l.0 == *key).collect();
        let mean = own.iter().map(|l| l.2).sum::<Vector3<f64>>() / own.len() as f64;
        for (_, index, tcp) in &own {
            out.samples.push(error(*index, tcp, &(tcp - mean)));
        }
        means.push(mean);
    }
    let certified = |id: u32| spheres.iter().find(|s| s.id == id).map(|s| Vector3::from(s.position_m));
    for a in 0..keys.len() {
        for b in (a + 1)..keys.len() {
            let ((place, one), (other_place, two)) = (keys[a], keys[b]);
            if place == other_place
                && let (Some(p), Some(q)) = (certified(one), certified(two))
            {
                let off = (means[a] - means[b]).norm() - (p - q).norm();
                out.distances_mm.push((place, one, two, off * 1e3));
            }
        }
    }
}

fn error(index: usize, tcp: &Vector3<f64>, off: &Vector3<f64>) -> SampleError {
    SampleError {
        index,
        at_m: (*tcp).into(),
        error_mm: (off * 1e3).into(),
        distance_mm: off.norm() * 1e3,
    }
}
