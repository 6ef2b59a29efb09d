//! Sizes of single causes and of groups of parameters, found on a grid.

use nalgebra::{DMatrix, DVector, Vector3};

use super::causes::{Cause, Occasion, Shape};
use super::dense::transposed_product;
use super::linear::{Linear, LinearRow, Posture};
use crate::course::Course;

/// Amplitudes that are tried: root mean square of the TCP's displacement over the
/// observations, in units of the noise of one observation.
pub(crate) const GRID: [f64; 14] = [
    0.0, 0.025, 0.05, 0.1, 0.2, 0.4, 0.8, 1.6, 3.2, 6.4, 12.8, 25.6, 51.2, 102.4,
];
/// Scale of the half Cauchy prior of an amplitude, in the same unit: a cause that
/// small changes no expected error, alone or with all others.
const SCALE: f64 = 0.02;
/// The same for torque: harmonic drives stiffen by 1.3 to 2 over their range of
/// torque (their data sheets' K1, K2, K3), so some of it is always there.
const TORQUE_SCALE: f64 = 0.05;
/// Factors on the priors of the model's own groups that are tried.
pub(crate) const FACTORS: [f64; 12] = [0.03125, 0.0625, 0.125, 0.25, 0.5, 1.0, 2.0, 4.0, 8.0, 16.0, 32.0, 64.0];
/// How well the sigma of a group's prior is known, as a standard deviation of its
/// logarithm. That of lengths, twists and offsets, which are made and measured: within a
/// factor of two. That of effects, which an arm may not have at all: within a factor of
/// four.
const FACTOR_SIGMA: [f64; 2] = [core::f64::consts::LN_2, 2.0 * core::f64::consts::LN_2];
/// Robust weight below which a row is a gross error.
const GROSS: f64 = 0.1;
/// Median of chi-square with three degrees of freedom.
const CHI_SQUARE_3_MEDIAN: f64 = 2.365_974;

/// A cause with its columns as the data see them.
#[derive(Clone, Debug)]
pub(crate) struct Component {
    pub(crate) shape: Shape,
    /// Turns the shape's columns into those kept (first) and those left out, scaled
    /// so that amplitude 1 displaces the TCP by the noise of one observation.
    turn: DMatrix<f64>,
    /// First column in `Z` and number of columns there.
    pub(crate) at: usize,
    pub(crate) kept: usize,
    /// Posterior probabilities of [`GRID`].
    pub(crate) posterior: [f64; GRID.len()],
    /// Root of the posterior mean of the squared amplitude.
    pub(crate) amplitude: f64,
    /// Log of the evidence for it against its absence.
    pub(crate) gain: f64,
}

/// What a group of parameters describes.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum GroupOf {
    /// Lengths of links.
    Lengths,
    /// Twists, offsets, frames.
    Geometry,
    /// Compliance, bending, harmonics.
    Effects,
}

/// A group of the model's own parameters that share how well their prior is known.
#[derive(Clone, Debug)]
pub(crate) struct ParameterGroup {
    pub(crate) columns: Vec<usize>,
    /// Whether the factor may differ from 1.
    pub(crate) open: bool,
    /// What these are.
    pub(crate) of: GroupOf,
    pub(crate) posterior: [f64; FACTORS.len()],
    pub(crate) factor: f64,
}

/// Prior weights on a grid: half Cauchy with `scale`, by the width of each cell.
pub(crate) fn half_cauchy(scale: f64) -> [f64; GRID.len()] {
    let mut weights = [0.0; GRID.len()];
    for (k, a) in GRID.iter().enumerate() {
        let width = if k == 0 { GRID[1] } else { a * core::f64::consts::LN_2 };
        weights[k] = width / (scale * (1.0 + (a / scale).powi(2)));
    }
    weights
}

/// Posterior over candidates of a block's variance: `k` and `v` are its block of
/// `K` and of `Wᵀ V⁻¹ y` at the variance `now`.
pub(crate) fn block_posterior<const N: usize>(
    k: DMatrix<f64>,
    v: &DVector<f64>,
    now: f64,
    candidates: [f64; N],
    prior: [f64; N],
) -> ([f64; N], [f64; N]) {
    let eigen = k.symmetric_eigen();
    let u = eigen.eigenvectors.tr_mul(v);
    let logs: [f64; N] = core::array::from_fn(|c| {
        let t = candidates[c];
        let mut log = prior[c].ln();
        for (value, u) in eigen.eigenvalues.iter().zip(&u) {
            // Without the block: G = K (1 - now K)⁻¹, b = (1 + now G) v.
            let value = value.max(0.0);
            let g = value / (1.0 - now * value).max(1e-9);
            let b = (1.0 + now * g) * u;
            log += 0.5 * (t * b * b / (1.0 + t * g) - (1.0 + t * g).ln());
        }
        log
    });
    let top = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max);
    let mut weights = logs.map(|l| (l - top).exp());
    let sum: f64 = weights.iter().sum();
    for weight in &mut weights {
        *weight /= sum;
    }
    (weights, logs)
}

impl Component {
    /// Displacements (m, F0) by one unit of each turned column, 3 x width.
    pub(crate) fn columns(&self, posture: &Posture, moment: &Occasion) -> DMatrix<f64> {
        let mut columns = vec![Vector3::zeros(); self.shape.width()];
        self.shape.fill(posture, moment, &mut columns);
        let raw = DMatrix::from_fn(3, columns.len(), |axis, c| columns[c][axis]);
        raw * &self.turn
    }

    /// Scale of the prior of its amplitude.
    pub(crate) fn scale(&self) -> f64 {
        match self.shape.cause {
            Cause::Torque(_) => TORQUE_SCALE,
            _ => SCALE,
        }
    }

    /// An amplitude by its posterior; `u` in [0, 1).
    pub(crate) fn drawn(&self, u: f64) -> f64 {
        pick(&self.posterior, u, &GRID)
    }
}

impl ParameterGroup {
    /// A group of columns; a closed one keeps its prior.
    pub(crate) fn new(columns: Vec<usize>, open: bool, of: GroupOf) -> Self {
        Self {
            columns,
            open,
            of,
            posterior: FACTORS.map(|f| f64::from(u8::from(f == 1.0))),
            factor: 1.0,
        }
    }

    /// Logarithm of the prior density of a factor, up to a constant.
    pub(crate) fn log_prior(&self, factor: f64) -> f64 {
        let sigma = FACTOR_SIGMA[usize::from(self.of == GroupOf::Effects)];
        -0.5 * (factor.ln() / sigma).powi(2)
    }

    /// A factor by its posterior; `u` in [0, 1).
    pub(crate) fn drawn(&self, u: f64) -> f64 {
        if self.open {
            pick(&self.posterior, u, &FACTORS)
        } else {
            self.factor
        }
    }
}

fn pick(weights: &[f64], mut u: f64, values: &[f64]) -> f64 {
    for (weight, value) in weights.iter().zip(values) {
        u -= weight;
        if u <= 0.0 {
            return *value;
        }
    }
    values.last().copied().unwrap_or_default()
}

/// Root mean square displacement of the TCP by the noise of one observation, in m.
pub(crate) fn noise(linear: &Linear) -> f64 {
    let (mut sum, mut weight) = (0.0, 0.0);
    for row in linear.rows.iter().filter(|row| row.leads()) {
        // The whitener carries the root of the robust weight.
        sum += row.root.inverse().norm_squared() * row.weight * row.weight;
        weight += row.weight;
    }
    (sum / f64::max(weight, 1e-12) * linear.s2).sqrt().max(1e-9)
}

/// Variance of a sound pose's noise from the residuals (weighted, 3n), in units of the whitening
/// without robust weights; `share` is rows over degrees of freedom. None without sound rows.
///
/// Robust weights bend the weighted sum of squares: of data with gross errors, rows that agree
/// weigh more than 1. The median of the squares of the sound rows is free of that.
pub(crate) fn pose_variance(linear: &Linear, residual: &DVector<f64>, share: f64) -> Option<f64> {
    let sound = |row: &LinearRow| row.weight >= GROSS;
    let squares = linear.rows.iter().enumerate().filter(|(_, row)| sound(row));
    let mut squares: Vec<f64> = squares
        .map(|(k, row)| residual.rows(3 * k, 3).norm_squared() / row.weight)
        .collect();
    if squares.is_empty() {
        return None;
    }
    let count = squares.len();
    let variance = if count == linear.rows.len() {
        squares.iter().sum::<f64>() / (3.0 * count as f64)
    } else {
        squares.sort_unstable_by(f64::total_cmp);
        squares[count / 2] / CHI_SQUARE_3_MEDIAN
    };
    Some((variance * share).max(1e-8))
}

/// A cause on the data: its component and its block of `Z`; `None` where it does
/// not move the TCP there.
pub(crate) fn component(
    linear: &Linear,
    course: &Course,
    shape: Shape,
    noise_m: f64,
    at: usize,
) -> Option<(Component, DMatrix<f64>)> {
    let n = linear.rows.len();
    let width = shape.width();
    let mut block = DMatrix::zeros(3 * n, width);
    let mut columns = vec![Vector3::zeros(); width];
    let mut square = 0.0;
    let runs = course.runs();
    for (k, row) in linear.rows.iter().enumerate() {
        let moment = Occasion {
            time: course.time.get(row.index).copied().unwrap_or_default(),
            coupling: Some(course.coupling.get(row.index).copied().unwrap_or_default()),
            run: runs.get(row.index).copied(),
        };
        shape.fill(&row.posture, &moment, &mut columns);
        for (c, column) in columns.iter().enumerate() {
            square += column.norm_squared();
            let v = row.whiten(k, column, |row| block.fixed_view::<3, 1>(3 * row, c).into());
            for axis in 0..3 {
                block[(3 * k + axis, c)] = v[axis];
            }
        }
    }
    let rms = (square / n.max(1) as f64).sqrt();
    if rms.is_nan() || rms <= 1e-12 {
        return None;
    }
    let unit = noise_m / rms;
    let most = shape.most();
    let (turn, kept) = if width > most {
        let eigen = transposed_product(&block, &block).symmetric_eigen();
        let mut order: Vec<usize> = (0..width).collect();
        order.sort_by(|a, b| eigen.eigenvalues[*b].total_cmp(&eigen.eigenvalues[*a]));
        (eigen.eigenvectors.select_columns(&order) * unit, most)
    } else {
        (DMatrix::identity(width, width) * unit, width)
    };
    let block = block * turn.columns(0, kept);
    let component = Component {
        shape,
        turn,
        at,
        kept,
        posterior: half_cauchy(SCALE),
        amplitude: SCALE,
        gain: 0.0,
    };
    Some((component, block))
}
