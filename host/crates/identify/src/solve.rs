//! Posterior of a linearised model: normal equations plus priors, scaled and factorised, and
//! inverted if the covariance is needed.

use nalgebra::{DMatrix, DVector, Vector3};

use super::chain::State;
use super::dense::{Factor, gram_of_lower};
use super::error::IdentifyError;
use super::normal::Normal;
use super::parameters::{Layout, Parameter};

/// The free columns of a model, their priors and the present state.
#[derive(Clone, Debug)]
pub(crate) struct Unknowns {
    /// Columns of the layout that are free.
    pub(crate) columns: Vec<usize>,
    /// `1/σ²` of their priors.
    pub(crate) precision: Vec<f64>,
    /// Deviation of the state from the nominal values.
    pub(crate) deviation: Vec<f64>,
}

impl Unknowns {
    pub(crate) fn new(table: &[Parameter]) -> Self {
        let free = || table.iter().enumerate().filter(|(_, p)| p.free);
        Self {
            columns: free().map(|(i, _)| i).collect(),
            precision: free().map(|(_, p)| p.prior_sigma.powi(-2)).collect(),
            deviation: free().map(|_| 0.0).collect(),
        }
    }

    pub(crate) fn len(&self) -> usize {
        self.columns.len()
    }
}

/// A factorised posterior `A = H/s² + Λ`, scaled to a unit diagonal.
pub(crate) struct Posterior {
    scale: DVector<f64>,
    factor: Factor,
}

impl Posterior {
    /// Factorises with noise variance `s2` on the data.
    pub(crate) fn new(normal: &Normal, unknowns: &Unknowns, s2: f64) -> Result<Self, IdentifyError> {
        let m = unknowns.len();
        let singular = || IdentifyError::Singular { free: m };
        let mut a = DMatrix::zeros(m, m);
        for (c, &from) in unknowns.columns.iter().enumerate() {
            for (r, &row) in unknowns.columns.iter().enumerate().skip(c) {
                a[(r, c)] = normal.matrix[(row, from)] / s2;
            }
            a[(c, c)] += unknowns.precision[c];
        }
        let scale = DVector::from_fn(m, |i, _| 1.0 / a[(i, i)].sqrt());
        if !scale.iter().all(|x| x.is_finite()) {
            return Err(singular());
        }
        for c in 0..m {
            for r in c..m {
                a[(r, c)] *= scale[r] * scale[c];
            }
        }
        let factor = Factor::new(a).ok_or_else(singular)?;
        Ok(Self { scale, factor })
    }

    /// The step to the mode, given the data's gradient at the state, and its
    /// squared length in posterior standard deviations (the Newton decrement).
    pub(crate) fn step(&self, normal: &Normal, unknowns: &Unknowns, s2: f64) -> (DVector<f64>, f64) {
        let b = DVector::from_fn(unknowns.len(), |i, _| {
            let data = normal.gradient[unknowns.columns[i]] / s2;
            -self.scale[i] * (data + unknowns.precision[i] * unknowns.deviation[i])
        });
        let step = self.factor.solve_vector(&b);
        let decrement = step.dot(&b);
        (step.component_mul(&self.scale), decrement)
    }

    /// How many parameters the data determine: `m − Σ prior precision x posterior variance`.
    pub(crate) fn effective(unknowns: &Unknowns, covariance: &DMatrix<f64>) -> f64 {
        let held: f64 = unknowns
            .precision
            .iter()
            .enumerate()
            .map(|(c, p)| p * covariance[(c, c)])
            .sum();
        (unknowns.len() as f64 - held).max(0.0)
    }

    /// Lower triangular `R` of the covariance `Rᵀ R` of the unknowns, SI units.
    pub(crate) fn root(&self) -> DMatrix<f64> {
        let mut root = self.factor.inverse_root();
        for (mut column, scale) in root.column_iter_mut().zip(self.scale.iter()) {
            column *= *scale;
        }
        root
    }

    /// Covariance of the unknowns, SI units.
    pub(crate) fn covariance(&self) -> DMatrix<f64> {
        gram_of_lower(&self.root())
    }

    /// Turns `b`, a row of a Jacobian in each column, into `H` whose products `Hᵀ H` are the covariances of these rows.
    pub(crate) fn half_mut(&self, b: &mut DMatrix<f64>) {
        for (mut row, scale) in b.row_iter_mut().zip(self.scale.iter()) {
            row *= *scale;
        }
        self.factor.half_mut(b);
    }

    /// Log evidence (Laplace) at the unknowns, given the log likelihood of the data there, up to a constant.
    pub(crate) fn log_evidence_at(&self, unknowns: &Unknowns, data: f64) -> f64 {
        let prior = unknowns.precision.iter().zip(&unknowns.deviation);
        data + prior.map(|(p, x)| 0.5 * p.ln() - 0.5 * p * x * x).sum::<f64>() - 0.5 * self.log_determinant()
    }

    /// `ln |A|`.
    fn log_determinant(&self) -> f64 {
        self.factor.log_determinant() - 2.0 * self.scale.iter().map(|s| s.ln()).sum::<f64>()
    }
}

/// Converts the first of `count` unknowns from shifts of each base at its pivot to shifts of the base's origin:
/// `δt = δ + ω × (t − c)`.
pub(crate) fn about_base(count: usize, unknowns: &Unknowns, layout: &Layout, state: &State) -> DMatrix<f64> {
    let mut turned = DMatrix::identity(count, count);
    let at = |column: usize| unknowns.columns.iter().position(|c| *c == column);
    for (f, (base, pivot)) in state.bases.iter().zip(&state.pivots).enumerate() {
        let arm = base.position - pivot;
        let first = layout.base(f);
        let mut turn = DMatrix::identity(count, count);
        for axis in 0..3 {
            let Some(column) = at(first + 3 + axis) else { continue };
            let shift = Vector3::<f64>::ith(axis, 1.0).cross(&arm);
            for k in 0..3 {
                if let Some(row) = at(first + k) {
                    turn[(row, column)] = shift[k];
                }
            }
        }
        turned = turn * turned;
    }
    turned
}
