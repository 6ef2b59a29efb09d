//! Posterior of a linearised model: normal equations plus priors, scaled,
//! factorised, inverted where the covariance is wanted.

use nalgebra::{Cholesky, DMatrix, DVector, Dyn};

use super::error::IdentifyError;
use super::normal::Normal;
use super::parameters::Parameter;

/// The free columns of a model, their priors and where the state stands.
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

    /// The step to the mode, given the data's gradient at the state.
    pub(crate) fn step(&self, normal: &Normal, unknowns: &Unknowns, s2: f64) -> DVector<f64> {
        let mut b = DVector::from_fn(unknowns.len(), |i, _| {
            let data = normal.gradient[unknowns.columns[i]] / s2;
            -self.scale[i] * (data + unknowns.precision[i] * unknowns.deviation[i])
        });
        self.factor.solve_mut(&mut b);
        b.component_mul(&self.scale)
    }

    /// `L⁻¹` of the scaled matrix, lower triangular.
    fn inverse_root(&self) -> DMatrix<f64> {
        let l = self.factor.l_dirty();
        let m = l.nrows();
        let mut inverse = DMatrix::zeros(m, m);
        let mut column = vec![0.0; m];
        for c in 0..m {
            column[c..].fill(0.0);
            column[c] = 1.0;
            for k in c..m {
                let value = column[k] / l[(k, k)];
                column[k] = value;
                let below = &l.column(k);
                for (x, y) in column[k + 1..].iter_mut().zip(below.iter().skip(k + 1)) {
                    *x -= value * y;
                }
            }
            for k in c..m {
                inverse[(k, c)] = column[k];
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
        let step = self.step(normal, unknowns, s2);
        let mut sum = -self.log_determinant();
        for (i, (precision, x)) in unknowns.precision.iter().zip(&unknowns.deviation).enumerate() {
            let b = -(normal.gradient[unknowns.columns[i]] / s2 + precision * x);
            sum += step[i] * b - precision * x * x + precision.ln();
        }
        0.5 * sum
    }

    /// `ln |A|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        let l = self.factor.l_dirty();
        (0..l.nrows()).map(|i| 2.0 * (l[(i, i)] / self.scale[i]).ln()).sum()
    }
}
