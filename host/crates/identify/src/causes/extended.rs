//! The linear model of a fit with the columns of named causes.
//!
//! `y = X x + A a + e` with `x ~ N(0, I)` (columns of `X` are scaled by the sizes that the fit found), `e ~ N(0, I)` and a wide
//! prior of each cause. What is named here is a part of the estimate: the posterior of this model is that of the result.

use nalgebra::{DMatrix, DVector};

use super::linear::Linear;
use crate::dense::{Factor, transposed_product};
use crate::error::IdentifyError;

/// The extended model.
#[derive(Clone, Debug)]
pub(crate) struct Extended {
    /// `[X A]`, 3n x (m + k), the columns of causes times the sigmas of their priors.
    pub(crate) w: DMatrix<f64>,
    /// `Wᵀ W` and `Wᵀ y`, with what the orientations add.
    n: DMatrix<f64>,
    wy: DVector<f64>,
    /// Columns of `X`.
    pub(crate) m: usize,
}

impl Extended {
    /// The model of a fit without causes.
    pub(crate) fn new(linear: &Linear) -> Self {
        Self::of(linear.x.clone(), linear, linear.x.ncols())
    }

    fn of(w: DMatrix<f64>, linear: &Linear, m: usize) -> Self {
        let mut n = transposed_product(&w, &w);
        let mut of_fit = n.view_mut((0, 0), (m, m));
        of_fit += &linear.rest;
        let mut wy = w.tr_mul(&linear.y);
        let mut of_fit = wy.rows_mut(0, m);
        of_fit += &linear.rest_y;
        Self { w, n, wy, m }
    }

    /// The same model with further whitened columns (3n) and the sigmas of their priors.
    pub(crate) fn with(&self, linear: &Linear, columns: &[(DVector<f64>, f64)]) -> Self {
        let (rows, before) = self.w.shape();
        let all = before + columns.len();
        let mut new = DMatrix::zeros(rows, columns.len());
        for (k, (column, sigma)) in columns.iter().enumerate() {
            new.column_mut(k).axpy(*sigma, column, 0.0);
        }
        let mut w = self.w.clone().resize_horizontally(all, 0.0);
        w.columns_mut(before, columns.len()).copy_from(&new);
        let cross = transposed_product(&w, &new);
        let mut n = self.n.clone().resize(all, all, 0.0);
        n.columns_mut(before, columns.len()).copy_from(&cross);
        n.rows_mut(before, columns.len()).copy_from(&cross.transpose());
        let mut wy = self.wy.clone().resize_vertically(all, 0.0);
        wy.rows_mut(before, columns.len()).copy_from(&new.tr_mul(&linear.y));
        Self { w, n, wy, m: self.m }
    }

    /// The same model about another point of linearisation.
    pub(crate) fn about(&self, linear: &Linear) -> Self {
        let mut w = self.w.clone();
        w.columns_mut(0, self.m).copy_from(&linear.x);
        Self::of(w, linear, self.m)
    }

    /// Factor of `I + Wᵀ W`.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn factor(&self) -> Result<Factor, IdentifyError> {
        factor_of(self.n.clone())
    }

    /// `Wᵀ W` and `Wᵀ y` with the columns beyond `X` times a factor and the noise of the targets times another.
    fn products_with(&self, linear: &Linear, [size, noise]: [f64; 2]) -> (DMatrix<f64>, DVector<f64>) {
        let scale = |k: usize| if k < self.m { 1.0 / noise } else { size / noise };
        let count = self.n.nrows();
        let mut n = DMatrix::from_fn(count, count, |r, c| self.n[(r, c)] * scale(r) * scale(c));
        let mut wy = DVector::from_fn(count, |k, _| self.wy[k] * scale(k) / noise);
        // What the orientations tell keeps its own noise.
        let kept = 1.0 - noise.powi(-2);
        let mut of_fit = n.view_mut((0, 0), (self.m, self.m));
        of_fit += &linear.rest * kept;
        let mut of_fit = wy.rows_mut(0, self.m);
        of_fit += &linear.rest_y * kept;
        (n, wy)
    }

    /// Log evidence with these factors, up to a constant; minus infinity where there is no solution. `numbers` is what the
    /// rows count.
    pub(crate) fn evidence_with(&self, linear: &Linear, numbers: f64, factors: [f64; 2]) -> f64 {
        let (n, wy) = self.products_with(linear, factors);
        let Ok(factor) = factor_of(n) else {
            return f64::NEG_INFINITY;
        };
        let [_, noise] = factors;
        let rows = linear.y.norm_squared() / noise.powi(2);
        let right = factor.half_vector(&wy).norm_squared();
        -0.5 * (rows - right + factor.log_determinant()) - numbers * noise.ln()
    }

    /// The model with these factors.
    pub(crate) fn rescaled(mut self, linear: &Linear, [size, noise]: [f64; 2]) -> Self {
        (self.n, self.wy) = self.products_with(linear, [size, noise]);
        self.w /= noise;
        let mut beyond = self.w.columns_range_mut(self.m..);
        beyond *= size;
        self
    }

    /// Log evidence up to a constant of the data.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn log_evidence(&self, linear: &Linear) -> Result<f64, IdentifyError> {
        let factor = self.factor()?;
        let right = factor.half_vector(&self.wy);
        Ok(-0.5 * (linear.y.norm_squared() - right.norm_squared() + factor.log_determinant()))
    }

    /// Means of all columns in units of their priors' sigmas.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn mean(&self) -> Result<DVector<f64>, IdentifyError> {
        Ok(self.factor()?.solve_vector(&self.wy))
    }

    /// Means and covariance of the first `count` columns, in units of their priors' sigmas.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn posterior(&self, count: usize) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
        let factor = self.factor()?;
        let mean = factor.solve_vector(&self.wy).rows(0, count).into_owned();
        let half = factor.half(&DMatrix::identity(self.w.ncols(), count));
        Ok((mean, transposed_product(&half, &half)))
    }

    /// Displacements (whitened) by the columns from `first` on, where they were estimated.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn displaced(&self, first: usize) -> Result<DVector<f64>, IdentifyError> {
        let (mean, count) = (self.mean()?, self.w.ncols() - first);
        Ok(self.w.columns(first, count) * mean.rows(first, count))
    }

    /// `ln` of the prior's covariance over the posterior's of the last `count` columns: what the width of their prior
    /// takes off twice the log evidence.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn named_volume(&self, count: usize) -> Result<f64, IdentifyError> {
        let (_, covariance) = self.last(count)?;
        Ok(-covariance.determinant().max(1e-300).ln())
    }

    /// Effect of the last columns in their own units, and its covariance.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn named_effect(
        &self,
        columns: &[(DVector<f64>, f64)],
    ) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
        let (mut effect, mut covariance) = self.last(columns.len())?;
        for (r, (_, sigma)) in columns.iter().enumerate() {
            effect[r] *= sigma;
            for (c, (_, other)) in columns.iter().enumerate() {
                covariance[(r, c)] *= sigma * other;
            }
        }
        Ok((effect, covariance))
    }

    /// Mean and covariance of the last columns.
    fn last(&self, count: usize) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
        let factor = self.factor()?;
        let all = self.w.ncols();
        let mean = factor.solve_vector(&self.wy).rows(all - count, count).into_owned();
        let mut unit = DMatrix::zeros(all, count);
        for k in 0..count {
            unit[(all - count + k, k)] = 1.0;
        }
        factor.half_mut(&mut unit);
        Ok((mean, transposed_product(&unit, &unit)))
    }
}

/// Factor of `I + n`.
fn factor_of(mut n: DMatrix<f64>) -> Result<Factor, IdentifyError> {
    let free = n.nrows();
    (0..free).for_each(|i| n[(i, i)] += 1.0);
    Factor::new(n).ok_or(IdentifyError::Singular { free })
}
