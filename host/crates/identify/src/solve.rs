//! Posterior of a linearised model: normal equations plus priors, scaled and factorised, and
//! inverted if the covariance is needed.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::error::IdentifyError;
use super::normal::Normal;
use super::parameters::Parameter;

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
    factor: Cholesky<f64, Dyn>,
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
        let factor = Cholesky::new(a).ok_or_else(singular)?;
        Ok(Self { scale, factor })
    }

    /// The step to the mode, given the data's gradient at the state, and its
    /// squared length in posterior standard deviations (the Newton decrement).
    pub(crate) fn step(&self, normal: &Normal, unknowns: &Unknowns, s2: f64) -> (DVector<f64>, f64) {
        let b = DVector::from_fn(unknowns.len(), |i, _| {
            let data = normal.gradient[unknowns.columns[i]] / s2;
            -self.scale[i] * (data + unknowns.precision[i] * unknowns.deviation[i])
        });
        let mut step = b.clone();
        self.factor.solve_mut(&mut step);
        let decrement = step.dot(&b);
        (step.component_mul(&self.scale), decrement)
    }

    /// `L⁻¹` of the scaled matrix, lower triangular.
    fn inverse_root(&self) -> DMatrix<f64> {
        let l = self.factor.l_dirty();
        let m = l.nrows();
        let l = l.as_slice();
        let mut inverse = DMatrix::zeros(m, m);
        for (c, column) in inverse.as_mut_slice().chunks_exact_mut(m.max(1)).enumerate() {
            column[c] = 1.0;
            for k in c..m {
                let (above, below) = column.split_at_mut(k + 1);
                let of = &l[k * m + k..(k + 1) * m];
                let value = above[k] / of[0];
                above[k] = value;
                for (x, y) in below.iter_mut().zip(&of[1..]) {
                    *x -= value * y;
                }
            }
        }
        inverse
    }

    /// How many parameters the data determine: `m − Σ prior precision x posterior variance`.
    pub(crate) fn effective(&self, unknowns: &Unknowns) -> f64 {
        let root = self.inverse_root();
        let mut held = 0.0;
        for (c, column) in root.column_iter().enumerate() {
            held += column.norm_squared() * self.scale[c].powi(2) * unknowns.precision[c];
        }
        (unknowns.len() as f64 - held).max(0.0)
    }

    /// Covariance of the unknowns, SI units.
    pub(crate) fn covariance(&self) -> DMatrix<f64> {
        let root = self.inverse_root();
        let transposed = root.transpose();
        let mut covariance = &transposed * &root;
        for c in 0..covariance.ncols() {
            for r in 0..covariance.nrows() {
                covariance[(r, c)] *= self.scale[r] * self.scale[c];
            }
        }
        covariance
    }

    /// Log evidence of the linearised model up to a constant of data and noise:
    /// `½ (bᵀA⁻¹b − xᵀΛx + ln|Λ| − ln|A|)`.
    pub(crate) fn log_evidence(&self, normal: &Normal, unknowns: &Unknowns, s2: f64) -> f64 {
        let (_, decrement) = self.step(normal, unknowns, s2);
        let mut sum = decrement - self.log_determinant();
        for (precision, x) in unknowns.precision.iter().zip(&unknowns.deviation) {
            sum += precision.ln() - precision * x * x;
        }
        0.5 * sum
    }

    /// `ln |A|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        let l = self.factor.l_dirty();
        (0..l.nrows()).map(|i| 2.0 * (l[(i, i)] / self.scale[i]).ln()).sum()
    }
}
