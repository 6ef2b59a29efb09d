//! Cross-validation: how well a model predicts contacts outside its fit.
//!
//! Observations are split by sphere, by placement of the plate, by region of the joint space, or by
//! any label of the data. Each part in turn is left out of the fit and then predicted. If the
//! left-out part has its own base (a placement that is not in the fit), or if no base can be
//! compared, only the scatter about each sphere's mean and the distances between those means are
//! judged. Otherwise the error itself is judged too.

use std::collections::{BTreeMap, BTreeSet};

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::error::IdentifyError;
use super::hierarchy::{self, Before, Fit, prepare};
use super::load::Nominal;
use super::options::{Method, Model, Options};
use super::parameters::Layout;
use super::targets::reference_of;
use spherecal_model::input::Labels;
use spherecal_model::{Experiment, Set, Target};

/// How the data are split.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Split {
    /// One part per sphere.
    Sphere,
    /// One part per place of the plate.
    Place,
    /// This many parts, each a region of the joint space.
    Region(usize),
    /// One part per label; one label per observation.
    Label(Vec<String>),
}

/// What was found on one left-out part.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct LeftOutPart {
    /// Its name.
    pub name: String,
    /// Observations left out.
    pub count: usize,
    /// Mean distance of the prediction from the target, in mm, if the fit contains the frame of the
    /// target and, for a plate, the sphere.
    pub error_mm: Option<f64>,
    /// Mean distance of the predictions from their mean at each sphere, in mm
    /// (contacts only).
    pub scatter_mm: Option<f64>,
    /// Largest error of a distance between two spheres' means, in mm.
    pub distance_mm: Option<f64>,
}

/// What was found on all of them.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Holdout {
    /// Model that was fitted.
    pub model: Model,
    /// Part by part.
    pub parts: Vec<LeftOutPart>,
    /// Mean over all observations left out, in mm.
    pub error_mm: Option<f64>,
    /// Mean over all observations left out, in mm.
    pub scatter_mm: Option<f64>,
    /// Mean absolute error of the sphere distances, in mm.
    pub distance_mm: Option<f64>,
}

impl Holdout {
    /// The figure for comparing models: the error if it is known, else the scatter.
    pub fn figure_mm(&self) -> Option<f64> {
        self.error_mm.or(self.scatter_mm)
    }
}

/// Part of each observation, and the parts' names.
fn parts(experiment: &Experiment, split: &Split) -> Result<(Vec<usize>, Vec<String>), IdentifyError> {
    let mut numbers = Labels::default();
    let mut number = |name: &str| numbers.number(name) as usize;
    let of: Vec<usize> = match split {
        Split::Sphere => {
            let name = |t: &Target| match t {
                Target::Sphere { sphere, .. } => format!("sphere {sphere}"),
                _ => "points".to_owned(),
            };
            experiment
                .observations
                .iter()
                .map(|o| number(&name(&o.target)))
                .collect()
        }
        Split::Place => {
            let name = |t: &Target| match t {
                Target::Sphere { place, .. } => format!("place {place}"),
                _ => "points".to_owned(),
            };
            experiment
                .observations
                .iter()
                .map(|o| number(&name(&o.target)))
                .collect()
        }
        Split::Label(labels) => {
            if labels.len() != experiment.observations.len() {
                return Err(IdentifyError::Method {
                    method: "holdout",
                    reason: format!(
                        "{} labels for {} observations: give one each",
                        labels.len(),
                        experiment.observations.len()
                    ),
                });
            }
            labels.iter().map(|l| number(l)).collect()
        }
        Split::Region(count) => regions(experiment, *count),
    };
    let names = match split {
        Split::Region(count) => (1..=*count).map(|k| format!("region {k}")).collect(),
        _ => numbers.names().map(str::to_owned).collect(),
    };
    Ok((of, names))
}

/// Regions of nearly equal size, by position along the direction in which the joint angles vary
/// most.
pub(crate) fn regions(experiment: &Experiment, count: usize) -> Vec<usize> {
    let n = experiment.robot.dof();
    let total = experiment.observations.len().max(1);
    let mut mean = vec![0.0; n];
    for o in &experiment.observations {
        for (m, q) in mean.iter_mut().zip(&o.q) {
            *m += q / total as f64;
        }
    }
    let mut spread = nalgebra::DMatrix::zeros(n, n);
    for o in &experiment.observations {
        let d = nalgebra::DVector::from_fn(n, |i, _| o.q.get(i).copied().unwrap_or_default() - mean[i]);
        spread.ger(1.0, &d, &d, 1.0);
    }
    let eigen = spread.symmetric_eigen();
    let direction = eigen.eigenvectors.column(eigen.eigenvalues.imax());
    let along =
        |o: &spherecal_model::Observation| -> f64 { o.q.iter().zip(direction.iter()).map(|(q, d)| q * d).sum() };
    let mut order: Vec<(f64, usize)> = experiment.observations.iter().map(along).zip(0..).collect();
    order.sort_by(|a, b| a.0.total_cmp(&b.0));
    let mut of = vec![0; experiment.observations.len()];
    for (rank, (_, index)) in order.into_iter().enumerate() {
        of[index] = rank * count.max(1) / total;
    }
    of
}

/// Leaves out each part in turn, fits the rest and predicts the part.
///
/// # Errors
/// Everything that [`super::identify`] refuses, and a split with fewer than two parts.
pub fn holdout(experiment: &Experiment, options: &Options, split: &Split) -> Result<Holdout, IdentifyError> {
    held_out(experiment, options, split, |experiment, options, model, of, part| {
        hierarchy::fit(experiment, options, model, &Before::default(), |i| {
            of.get(i) != Some(&part)
        })
    })
}

/// The hold-out; `fit` fits a model to the observations whose part (by observation) is not the given one.
fn held_out(
    experiment: &Experiment,
    options: &Options,
    split: &Split,
    fit: impl Fn(&Experiment, &Options, Model, &[usize], usize) -> Result<Fit, IdentifyError>,
) -> Result<Holdout, IdentifyError> {
    experiment.check()?;
    options.check()?;
    let model = if options.method == Method::Geometry {
        Model::Geometry
    } else {
        options.model
    };
    let (of, names) = parts(experiment, split)?;
    let used: BTreeSet<usize> = (0..of.len())
        .filter(|&i| experiment.observations[i].set == Set::Calibrate)
        .map(|i| of[i])
        .collect();
    if used.len() < 2 {
        return Err(IdentifyError::Method {
            method: "holdout",
            reason: format!("the split has {} part(s), but at least two are needed", used.len()),
        });
    }
    let mut sums = Sums::default();
    let mut found = Vec::new();
    for &part in &used {
        let fitted = fit(experiment, options, model, &of, part)?;
        let mut own = Sums::default();
        predict(experiment, options, &fitted, |i| of.get(i) == Some(&part), &mut own)?;
        found.push(LeftOutPart {
            name: names.get(part).cloned().unwrap_or_default(),
            count: own.count,
            error_mm: mean(&own.errors),
            scatter_mm: mean(&own.scatters),
            distance_mm: own.distances.iter().copied().reduce(f64::max),
        });
        sums.errors.extend(own.errors);
        sums.scatters.extend(own.scatters);
        sums.distances.extend(own.distances);
    }
    Ok(Holdout {
        model,
        parts: found,
        error_mm: mean(&sums.errors),
        scatter_mm: mean(&sums.scatters),
        distance_mm: mean(&sums.distances),
    })
}

#[derive(Default)]
struct Sums {
    count: usize,
    errors: Vec<f64>,
    scatters: Vec<f64>,
    distances: Vec<f64>,
}

fn mean(values: &[f64]) -> Option<f64> {
    (!values.is_empty()).then(|| values.iter().sum::<f64>() / values.len() as f64)
}

/// Predicts the observations that `wanted` names.
fn predict(
    experiment: &Experiment,
    options: &Options,
    fitted: &Fit,
    wanted: impl Fn(usize) -> bool,
    sums: &mut Sums,
) -> Result<(), IdentifyError> {
    let layout = Layout::new(experiment, 0, false);
    let nominal = Nominal::new(&experiment.robot, &experiment.tool);
    let calibrate = |i: usize| wanted(i) && experiment.observations[i].set == Set::Calibrate;
    let prepared = prepare(experiment, &layout, &nominal, options.torque, calibrate)?;
    let seen: BTreeSet<_> = fitted.prepared.iter().map(|p| (p.reference, p.sphere)).collect();
    // The plate gives the position of a sphere outside the fit if three other spheres determine the
    // plate. With two, it may rotate about the line through them.
    let known = |reference: usize, sphere: Option<usize>| {
        seen.contains(&(reference, sphere)) || seen.iter().filter(|s| s.0 == reference && s.1.is_some()).count() >= 3
    };
    let mut tcps: BTreeMap<(usize, usize), Vec<Vector3<f64>>> = BTreeMap::new();
    sums.count = prepared.len();
    for observation in &prepared {
        let tcp = fitted.state.at(observation).tcp;
        if known(observation.reference, observation.sphere) {
            sums.errors
                .push(fitted.state.residual(observation, &tcp).norm() * 1000.0);
        }
        if let Some(sphere) = observation.sphere {
            tcps.entry((observation.reference, sphere)).or_default().push(tcp);
        }
    }
    let mut means = Vec::new();
    for ((reference, sphere), points) in &tcps {
        let middle = points.iter().sum::<Vector3<f64>>() / points.len() as f64;
        sums.scatters
            .extend(points.iter().map(|p| (p - middle).norm() * 1000.0));
        means.push((*reference, *sphere, middle));
    }
    for (i, a) in means.iter().enumerate() {
        for b in means.iter().skip(i + 1).filter(|b| b.0 == a.0) {
            let certified = |s: usize| {
                let id = layout.spheres.get(s);
                let sphere = experiment.spheres.iter().find(|x| Some(&x.id) == id);
                Vector3::from(sphere.map_or([0.0; 3], |x| x.position_m))
            };
            let length = (certified(a.1) - certified(b.1)).norm();
            sums.distances.push(((a.2 - b.2).norm() - length).abs() * 1000.0);
        }
    }
    Ok(())
}

/// The splits that the data allow, the best first: placements, then spheres, then regions.
pub fn possible_splits(experiment: &Experiment) -> Vec<Split> {
    let calibrate = || experiment.observations.iter().filter(|o| o.set == Set::Calibrate);
    let places: std::collections::BTreeSet<_> = calibrate().map(|o| reference_of(&o.target)).collect();
    let spheres: std::collections::BTreeSet<_> = calibrate()
        .filter_map(|o| match o.target {
            Target::Sphere { sphere, .. } => Some(sphere),
            _ => None,
        })
        .collect();
    let mut splits = Vec::new();
    if places.len() > 1 {
        splits.push(Split::Place);
    }
    if spheres.len() > 1 {
        splits.push(Split::Sphere);
    }
    if calibrate().count() >= 20 {
        splits.push(Split::Region(4));
    }
    splits
}
