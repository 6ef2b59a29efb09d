//! Geometry alone, fitted to the data of an arm that has effects too.
//!
//! What a geometry cannot follow looks like outliers: joints that yield put every pose without load
//! apart from the poses under load, and robust weights by the geometry's own residuals would throw
//! such poses out. But they are right, and the fit needs them. So the full model decides
//! what an outlier is: a row is one only if the richest model cannot follow it.
//!
//! The noise of row i in the geometry is that of the full model and one variance for all rows:
//!
//! `v_i = s² / w_i + m²`
//!
//! with noise scale `s` and robust weight `w_i` of the full fit, both on the same whitening, and the
//! error `m` of the geometry as a model. `m` follows from the residuals (`Σ d_i² / v_i` is the number of
//! degrees of freedom). A gross error keeps its small weight, and all other rows count nearly alike where
//! `m` is larger than the noise. So the geometry comes close to the projection of the full model on
//! geometry at the poses of the data, and without effects to the fit by its own weights.

use super::error::IdentifyError;
use super::map::{self, Fit};
use super::noise_scale::{Squared, numbers};
use super::normal::{Whitening, distances};
use super::options::{Model, Options};
use spherecal_model::Experiment;

/// Newton steps for the model's error. They rise to the root without passing it.
const STEPS: usize = 60;
/// Relative change of the model's error at which it is found.
const SETTLED: f64 = 1e-12;

/// Noise of each row, as another model found it.
#[derive(Clone, Debug)]
pub(crate) struct RowNoise {
    /// What the variances are factors on.
    pub(crate) whitening: Whitening,
    /// Variance of a row whose weight is 1.
    s2: f64,
    /// Variance by prepared observation.
    variance: Vec<f64>,
}

impl RowNoise {
    fn of(fit: &Fit) -> Self {
        let s2 = fit.scale.powi(2);
        Self {
            whitening: fit.whitening,
            s2,
            variance: fit.weights.iter().map(|w| s2 / w).collect(),
        }
    }

    /// Variance of a row of weight 1, and the rows' weights, in a model whose whitened residuals are
    /// `rows` after `effective` parameters were taken from them.
    pub(crate) fn with_model_error(&self, rows: &[Squared], effective: f64) -> (f64, Vec<f64>) {
        let freedom = (numbers(rows) - effective).max(1.0);
        let mut model = 0.0;
        for _ in 0..STEPS {
            let (mut sum, mut slope) = (0.0, 0.0);
            for (row, v) in rows.iter().zip(&self.variance) {
                let share = row.d2 / (v + model);
                sum += share;
                slope += share / (v + model);
            }
            // The sum falls with the model's error and is convex, so a step from the left stays on the left.
            let step = (sum - freedom) / slope;
            if step <= SETTLED * (self.s2 + model) {
                break;
            }
            model += step;
        }
        let s2 = self.s2 + model;
        (s2, self.variance.iter().map(|v| s2 / (v + model)).collect())
    }
}

/// Whether the full model decides what an outlier of `model` is.
pub(crate) fn by_full_model(options: &Options, model: Model) -> bool {
    model == Model::Geometry && options.student_t > 0.0 && options.noise.estimate
}

/// Fits `model` to the observations that `wanted` names; geometry alone with the full model's noise of each
/// row, all else as [`map::fit`].
///
/// Where the options ask for least squares or for noise of a stated size, nothing is an outlier, and the
/// geometry is fitted as it is.
///
/// # Errors
/// Bad data, too few of them, or no convergence.
pub(crate) fn fit(
    experiment: &Experiment,
    options: &Options,
    model: Model,
    wanted: impl Fn(usize) -> bool,
) -> Result<Fit, IdentifyError> {
    if !by_full_model(options, model) {
        return map::fit(experiment, options, model, wanted);
    }
    // Data that say too little for the full model can still say enough for geometry.
    let Ok(full) = map::fit(experiment, options, Model::Full, &wanted) else {
        return map::fit(experiment, options, model, wanted);
    };
    let noise = RowNoise::of(&full);
    let mut found = map::fit_knowing(experiment, options, model, Some(&noise), wanted)?;
    let d2 = distances(&full.state, &full.layout, &full.prepared, &full.whitening);
    found.richer = Some(d2.iter().map(|row| row.d2.sqrt() / full.scale).collect());
    Ok(found)
}

#[cfg(test)]
#[path = "geometry_fit_tests.rs"]
mod tests;
