//! What a certificate states beyond the verdict: where the expected error comes from, and how
//! well repeated couplings of one sphere agree.
//!
//! The nest is put on a sphere, the arm moves about it, and the nest comes off again: one
//! coupling. A sphere that was coupled several times is found again each time; the mean
//! residual of a coupling is where the calibrated robot finds it. How far these places lie
//! apart is the repeatability of touching a sphere: of seat, encoders and drift together,
//! and of what the model leaves out where the poses of two couplings differ. It is not the
//! pose repeatability of ISO 9283, which commands one pose thirty times.

use std::collections::BTreeMap;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use super::Evaluation;
use crate::course::Course;
use crate::recordings::Recordings;
use crate::statement::ErrorBudget;
use spherecal_model::Target;

/// Robust weight below which a row is an outlier and says nothing of its coupling.
const OUTLIER: f64 = 0.25;
/// Fewest couplings of repeated spheres for a spread of their distances.
const FEWEST: usize = 3;

impl Evaluation {
    /// The expected error of the full model over the work region by source; `None` where it is unknown.
    pub fn error_budget(&self) -> Option<ErrorBudget> {
        let statement = self.statement.as_ref()?;
        Some(statement.budget_of(|q| self.calibration.tcp_m(q, None)))
    }
}

/// How far the couplings of one sphere lie apart.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Repeatability {
    /// Spheres that were coupled more than once.
    pub spheres: usize,
    /// Their couplings.
    pub couplings: usize,
    /// Standard deviation of a coupling's place (all three axes together), in mm.
    pub sigma_mm: f64,
    /// Mean distance of a coupling from the middle of its sphere's couplings plus three
    /// standard deviations of these distances, in mm: the formula of ISO 9283. None for fewer
    /// than three couplings.
    pub iso_formula_mm: Option<f64>,
}

impl Repeatability {
    /// From places (mm) by sphere; none where no sphere has two.
    fn of(places: impl Iterator<Item = Vec<Vector3<f64>>>) -> Option<Self> {
        let (mut squares, mut freedom, mut spheres) = (0.0, 0, 0);
        let mut distances = Vec::new();
        for own in places.filter(|own| own.len() > 1) {
            let n = own.len() as f64;
            let middle = own.iter().sum::<Vector3<f64>>() / n;
            spheres += 1;
            freedom += own.len() - 1;
            for place in &own {
                let off = (place - middle).norm();
                squares += off * off;
                // The middle of few couplings lies nearer to each than the true one.
                distances.push(off * (n / (n - 1.0)).sqrt());
            }
        }
        let n = distances.len() as f64;
        let mean = distances.iter().sum::<f64>() / n;
        let spread = (distances.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / (n - 1.0)).sqrt();
        (freedom > 0).then(|| Self {
            spheres,
            couplings: distances.len(),
            sigma_mm: (squares / freedom as f64).sqrt(),
            iso_formula_mm: (distances.len() >= FEWEST).then_some(mean + 3.0 * spread),
        })
    }
}

/// The repeatability of the couplings in an evaluation of these recordings; none where no
/// sphere was coupled twice.
pub fn repeatability(recordings: &Recordings, evaluation: &Evaluation) -> Option<Repeatability> {
    let order = Course::in_order(&recordings.experiment);
    let course = recordings.course.as_ref().unwrap_or(&order);
    let mut sums: BTreeMap<((u32, u32), usize), (Vector3<f64>, f64)> = BTreeMap::new();
    for row in &evaluation.calibration.residual.rows {
        let Some(&index) = evaluation.used.get(row.index) else {
            continue;
        };
        let (Some(observation), Some(&coupling)) = (
            recordings.experiment.observations.get(index),
            course.coupling.get(index),
        ) else {
            continue;
        };
        let Target::Sphere { sphere, place } = observation.target else {
            continue;
        };
        if row.weight < OUTLIER {
            continue;
        }
        let sum = sums
            .entry(((place, sphere), coupling))
            .or_insert((Vector3::zeros(), 0.0));
        sum.0 += Vector3::from(row.error_mm);
        sum.1 += 1.0;
    }
    let mut places: BTreeMap<(u32, u32), Vec<Vector3<f64>>> = BTreeMap::new();
    for ((sphere, _), (sum, count)) in sums {
        places.entry(sphere).or_default().push(sum / count);
    }
    Repeatability::of(places.into_values())
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the spread of couplings about their sphere is not that of the numbers, if the
    // distance between two spheres counts as spread, or if a single coupling gives a figure.
    #[test]
    fn couplings_of_one_sphere_are_compared_with_each_other() {
        let along = |x: &[f64]| x.iter().map(|x| Vector3::new(*x, 0.0, 0.0)).collect::<Vec<_>>();
        let found = Repeatability::of([along(&[5.0, 5.2]), along(&[-3.0, -3.2]), along(&[9.0])].into_iter())
            .expect("two spheres twice");
        assert_eq!((found.spheres, found.couplings), (2, 4));
        assert!((found.sigma_mm - (0.04_f64 / 2.0).sqrt()).abs() < 1e-12, "{found:?}");
        // All four are equally far from their middles: no spread of the distances.
        assert!((found.iso_formula_mm.expect("four") - found.sigma_mm).abs() < 1e-9);
        assert_eq!(Repeatability::of([along(&[9.0]), along(&[])].into_iter()), None);
        let pair = Repeatability::of([along(&[0.0, 1.0])].into_iter()).expect("a pair");
        assert_eq!(pair.iso_formula_mm, None);
    }
}
