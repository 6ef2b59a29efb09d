//! One search for the mode: Gauss-Newton steps, robust weights and noise scale, each at the state
//! after the last step.
//!
//! [`map`](super::map) chooses the searched columns and their order. [`effects`](super::effects)
//! adds the choices that the data make.

use nalgebra::DVector;

use super::chain::{Prepared, State};
use super::error::IdentifyError;
use super::geometry_fit::RowNoise;
use super::noise_scale::{median_scale, scale, weights};
use super::normal::{Group, Normal, Whitening, accumulate, distances, gradient, likelihoods};
use super::options::Options;
use super::parameters::{Layout, Parameter};
use super::solve::{Posterior, Unknowns};

/// A search has converged if a step is shorter than this, in posterior standard deviations (all
/// parameters together).
pub(super) const SETTLED: f64 = 0.1;

/// Candidates for the shape of the noise, as factors on the part that does not come through the
/// joints: mostly joint noise, both, mostly seating.
const SHAPES: [f64; 3] = [1.0, 10.0, 100.0];
/// Gain in log likelihood that is needed to choose another shape.
const SHAPE_GAIN: f64 = 8.0;

/// A search in progress: one set of columns on one set of poses.
pub(super) struct Search<'a> {
    pub(super) layout: &'a Layout,
    pub(super) table: &'a [Parameter],
    pub(super) prepared: &'a [Prepared],
    pub(super) groups: &'a [Group],
    pub(super) whitening: Whitening,
    pub(super) state: State,
    pub(super) unknowns: Unknowns,
    pub(super) weights: Vec<f64>,
    /// Noise variance, as a factor on the whitening.
    pub(super) s2: f64,
    pub(super) effective: f64,
    /// Degrees of freedom of the Student-t weights; 0 for least squares.
    pub(super) nu: f64,
    /// Noise of each row as a richer model found it; its weights then stand in for the Student-t ones.
    pub(super) known: Option<&'a RowNoise>,
    pub(super) options: &'a Options,
}

impl Search<'_> {
    /// Normal equations at the state.
    pub(super) fn equations(&self) -> Normal {
        accumulate(
            &self.state,
            self.layout,
            self.prepared,
            self.groups,
            &self.whitening,
            &self.weights,
        )
    }

    /// The gradient at the present state, combined with the matrix of an earlier one.
    pub(super) fn renew(&self, normal: &mut Normal) {
        normal.gradient = gradient(
            &self.state,
            self.layout,
            self.prepared,
            self.groups,
            &self.whitening,
            &self.weights,
        );
    }

    pub(super) fn advance(&mut self, step: &DVector<f64>) {
        for (i, &column) in self.unknowns.columns.iter().enumerate() {
            self.state.add(self.table[column].kind, step[i]);
            self.unknowns.deviation[i] += step[i];
        }
        self.state.refresh();
    }

    /// One Gauss-Newton step, then noise and weights at the new state. Returns the step's length in
    /// posterior standard deviations.
    pub(super) fn step(&mut self, normal: &Normal, count_parameters: bool) -> Result<f64, IdentifyError> {
        let posterior = Posterior::new(normal, &self.unknowns, self.s2)?;
        let (step, decrement) = posterior.step(normal, &self.unknowns, self.s2);
        self.advance(&step);
        if count_parameters {
            self.effective = posterior.effective(&self.unknowns);
        }
        self.reweight()?;
        Ok(decrement.max(0.0).sqrt())
    }

    /// Noise scale and robust weights at the state.
    pub(super) fn reweight(&mut self) -> Result<(), IdentifyError> {
        let nu = self.nu;
        let rows = distances(&self.state, self.layout, self.prepared, &self.whitening);
        if !rows.iter().map(|row| row.d2).sum::<f64>().is_finite() {
            return Err(IdentifyError::Diverged { rms_mm: f64::INFINITY });
        }
        if let Some(known) = self.known {
            (self.s2, self.weights) = known.with_model_error(&rows, self.effective);
            return Ok(());
        }
        if self.options.noise.estimate {
            let start = if self.effective > 0.0 {
                self.s2
            } else {
                median_scale(&rows)
            };
            self.s2 = scale(&rows, self.effective, nu, start);
        }
        self.weights = weights(&rows, self.s2, nu);
        Ok(())
    }

    /// Fits geometry alone, from the present state. The matrix is computed at the first two states,
    /// because it hardly changes afterwards. The gradient is computed at every state, so that the
    /// result does not depend on this. Returns the first and the last equations.
    pub(super) fn settle(&mut self, most: usize) -> Result<(Normal, Normal), IdentifyError> {
        let first = self.equations();
        self.step(&first, false)?;
        let mut normal = self.equations();
        let mut before = f64::INFINITY;
        for k in 1..most {
            let moved = self.step(&normal, false)?;
            if moved < SETTLED || k + 1 == most {
                break;
            }
            if moved > 0.5 * before {
                normal = self.equations();
            } else {
                self.renew(&mut normal);
            }
            before = moved;
        }
        self.renew(&mut normal);
        Ok((first, normal))
    }

    /// Chooses the shape of the noise that the residuals clearly support. Returns whether it
    /// changed.
    pub(super) fn choose_shape(&mut self) -> Result<bool, IdentifyError> {
        if !self.options.noise.estimate || self.known.is_some() {
            return Ok(false);
        }
        let first = self.whitening;
        let candidates = SHAPES.map(|factor| first.with_floor(factor));
        let nu = self.nu;
        let found = likelihoods(&self.state, self.layout, self.prepared, &candidates, nu);
        let best = (0..found.len()).max_by(|a, b| found[*a].total_cmp(&found[*b]));
        match best {
            Some(best) if found[best] > found[0] + SHAPE_GAIN => {
                self.whitening = candidates[best];
                self.reweight()?;
                Ok(true)
            }
            _ => Ok(false),
        }
    }
}

/// Unknowns of `table`, at the state of `other`, which is a part of the same table.
pub(super) fn joined(table: &[Parameter], other: &[Parameter], unknowns: &Unknowns) -> Unknowns {
    let mut all = Unknowns::new(table);
    for (i, &column) in all.columns.iter().enumerate() {
        let kind = table[column].kind;
        if let Some(at) = unknowns.columns.iter().position(|&c| other[c].kind == kind) {
            all.deviation[i] = unknowns.deviation[at];
        }
    }
    all
}
