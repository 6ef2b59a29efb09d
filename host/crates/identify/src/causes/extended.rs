//! The linear model of a fit with the columns of named causes.
//!
//! `y = X x + A a + e` with `x ~ N(0, I)` (columns of `X` are scaled by the sizes that the fit found), `e ~ N(0, I)` and a wide
//! prior of each cause. What is named here is a part of the estimate: the posterior of this model is that of the result.

use nalgebra::{DMatrix, DVector, SymmetricTridiagonal};

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
    /// Factor of `I + Wᵀ W`.
    factor: Factor,
    /// Columns of `X`.
    pub(crate) m: usize,
}

impl Extended {
    /// The model of a fit without causes.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn new(linear: &Linear) -> Result<Self, IdentifyError> {
        Self::of(linear.x.clone(), linear, linear.x.ncols())
    }

    fn of(w: DMatrix<f64>, linear: &Linear, m: usize) -> Result<Self, IdentifyError> {
        let mut n = transposed_product(&w, &w);
        let mut of_fit = n.view_mut((0, 0), (m, m));
        of_fit += &linear.rest;
        let mut wy = w.tr_mul(&linear.y);
        let mut of_fit = wy.rows_mut(0, m);
        of_fit += &linear.rest_y;
        let factor = factor_of(n.clone())?;
        Ok(Self { w, n, wy, factor, m })
    }

    /// The same model with further whitened columns (3n) and the sigmas of their priors.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn with(&self, linear: &Linear, columns: &[(DVector<f64>, f64)]) -> Result<Self, IdentifyError> {
        let (rows, before) = self.w.shape();
        let (count, all) = (columns.len(), before + columns.len());
        let mut new = DMatrix::zeros(rows, count);
        for (k, (column, sigma)) in columns.iter().enumerate() {
            new.column_mut(k).axpy(*sigma, column, 0.0);
        }
        let mut w = self.w.clone().resize_horizontally(all, 0.0);
        w.columns_mut(before, count).copy_from(&new);
        let products = transposed_product(&w, &new);
        let mut n = self.n.clone().resize(all, all, 0.0);
        n.columns_mut(before, count).copy_from(&products);
        n.rows_mut(before, count).copy_from(&products.transpose());
        let mut wy = self.wy.clone().resize_vertically(all, 0.0);
        wy.rows_mut(before, count).copy_from(&new.tr_mul(&linear.y));
        let (cross, corner) = (products.rows(0, before).into_owned(), products.rows(before, count));
        let factor = self.factor.extended(&cross, corner + DMatrix::identity(count, count));
        let factor = factor.ok_or(IdentifyError::Singular { free: all })?;
        Ok(Self {
            w,
            n,
            wy,
            factor,
            m: self.m,
        })
    }

    /// The same model about another point of linearisation.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn about(&self, linear: &Linear) -> Result<Self, IdentifyError> {
        let mut w = self.w.clone();
        w.columns_mut(0, self.m).copy_from(&linear.x);
        Self::of(w, linear, self.m)
    }

    /// Factor of `I + Wᵀ W`.
    pub(crate) fn factor(&self) -> &Factor {
        &self.factor
    }

    /// `Wᵀ W` and `Wᵀ y` with the noise of the targets times a factor.
    fn products_with(&self, linear: &Linear, noise: f64) -> (DMatrix<f64>, DVector<f64>) {
        let weight = noise.powi(-2);
        let (mut n, mut wy) = (&self.n * weight, &self.wy * weight);
        // What the orientations tell keeps its own noise.
        let mut of_fit = n.view_mut((0, 0), (self.m, self.m));
        of_fit += &linear.rest * (1.0 - weight);
        let mut of_fit = wy.rows_mut(0, self.m);
        of_fit += &linear.rest_y * (1.0 - weight);
        (n, wy)
    }

    /// The evidence with the noise of the targets times a factor, as a function of the size of the columns beyond `X`.
    /// `numbers` is what the rows count.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn by_size(&self, linear: &Linear, numbers: f64, noise: f64) -> Result<BySize, IdentifyError> {
        let (n, wy) = self.products_with(linear, noise);
        let (m, count) = (self.m, n.nrows() - self.m);
        let factor = factor_of(n.view((0, 0), (m, m)).into_owned())?;
        let right = factor.half_vector(&wy.rows(0, m).into_owned());
        let half = factor.half(&n.view((0, m), (m, count)).into_owned());
        let information = n.view((m, m), (count, count)) - transposed_product(&half, &half);
        let score = wy.rows(m, count) - half.tr_mul(&right);
        let rows = linear.y.norm_squared() * noise.powi(-2);
        let (turn, diagonal, beside) = SymmetricTridiagonal::new(information).unpack();
        Ok(BySize {
            alone: -0.5 * (rows - right.norm_squared() + factor.log_determinant()) - numbers * noise.ln(),
            score: turn.tr_mul(&score),
            diagonal,
            beside,
        })
    }

    /// The model with the columns beyond `X` times `size` and the noise of the targets times `noise`.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn rescaled(mut self, linear: &Linear, size: f64, noise: f64) -> Result<Self, IdentifyError> {
        (self.n, self.wy) = self.products_with(linear, noise);
        self.w /= noise;
        let beyond = self.m..;
        let mut w = self.w.columns_range_mut(beyond.clone());
        w *= size;
        let mut columns = self.n.columns_range_mut(beyond.clone());
        columns *= size;
        let mut rows = self.n.rows_range_mut(beyond.clone());
        rows *= size;
        let mut wy = self.wy.rows_range_mut(beyond);
        wy *= size;
        self.factor = factor_of(self.n.clone())?;
        Ok(self)
    }

    /// Log evidence up to a constant of the data.
    pub(crate) fn log_evidence(&self, linear: &Linear) -> f64 {
        let right = self.factor.half_vector(&self.wy);
        -0.5 * (linear.y.norm_squared() - right.norm_squared() + self.factor.log_determinant())
    }

    /// Means of all columns in units of their priors' sigmas.
    pub(crate) fn mean(&self) -> DVector<f64> {
        self.factor.solve_vector(&self.wy)
    }

    /// Means and covariance of the first `count` columns, in units of their priors' sigmas.
    pub(crate) fn posterior(&self, count: usize) -> (DVector<f64>, DMatrix<f64>) {
        let half = self.factor.half(&DMatrix::identity(self.w.ncols(), count));
        let mean = self.mean().rows(0, count).into_owned();
        (mean, transposed_product(&half, &half))
    }

    /// Displacements (whitened) by the columns from `first` on, where they were estimated.
    pub(crate) fn displaced(&self, first: usize) -> DVector<f64> {
        let (mean, count) = (self.mean(), self.w.ncols() - first);
        self.w.columns(first, count) * mean.rows(first, count)
    }

    /// `ln` of the prior's covariance over the posterior's of the last `count` columns: what the width of their prior
    /// takes off twice the log evidence.
    pub(crate) fn named_volume(&self, count: usize) -> f64 {
        let (_, covariance) = self.last(count);
        -covariance.determinant().max(1e-300).ln()
    }

    /// Effect of the last columns in their own units, and its covariance.
    pub(crate) fn named_effect(&self, columns: &[(DVector<f64>, f64)]) -> (DVector<f64>, DMatrix<f64>) {
        let (mut effect, mut covariance) = self.last(columns.len());
        for (r, (_, sigma)) in columns.iter().enumerate() {
            effect[r] *= sigma;
            for (c, (_, other)) in columns.iter().enumerate() {
                covariance[(r, c)] *= sigma * other;
            }
        }
        (effect, covariance)
    }

    /// Mean and covariance of the last columns.
    fn last(&self, count: usize) -> (DVector<f64>, DMatrix<f64>) {
        let all = self.w.ncols();
        let mean = self.mean().rows(all - count, count).into_owned();
        let mut unit = DMatrix::zeros(all, count);
        for k in 0..count {
            unit[(all - count + k, k)] = 1.0;
        }
        self.factor.half_mut(&mut unit);
        (mean, transposed_product(&unit, &unit))
    }
}

/// Log evidence by the size of columns, at one noise.
///
/// Without the columns of `X` their information is tridiagonal, `Qᵀ V Q`, so that each size takes a pass along a diagonal.
pub(crate) struct BySize {
    /// Log evidence without the columns, up to a constant.
    alone: f64,
    /// `Qᵀ s` of the score.
    score: DVector<f64>,
    diagonal: DVector<f64>,
    beside: DVector<f64>,
}

impl BySize {
    /// Log evidence with columns of a size, up to a constant.
    pub(crate) fn at(&self, size: f64) -> f64 {
        let square = size * size;
        // One pass of L D Lᵀ of I + size² V, and of its solution.
        let (mut pivot, mut half, mut gain) = (1.0, 0.0, 0.0);
        for k in 0..self.score.len() {
            let step = if k == 0 {
                0.0
            } else {
                square * self.beside[k - 1] / pivot
            };
            half = self.score[k] - step * half;
            pivot = 1.0 + square * self.diagonal[k] - step * step * pivot;
            gain += square * half * half / pivot - pivot.ln();
        }
        self.alone + 0.5 * gain
    }
}

/// Factor of `I + n`.
fn factor_of(mut n: DMatrix<f64>) -> Result<Factor, IdentifyError> {
    let free = n.nrows();
    (0..free).for_each(|i| n[(i, i)] += 1.0);
    Factor::new(n).ok_or(IdentifyError::Singular { free })
}
