//! How large the errors are that the model has no parameter for.
//!
//! The fit is extended by the columns `Z` of every [`Cause`](super::causes), each
//! with one unknown amplitude, and by factors on the priors of the model's own
//! groups of parameters:
//!
//! `y ~ N(0, s² I + X F² Xᵀ + Z D² Zᵀ)`
//!
//! The marginal likelihood of one amplitude, the others held, needs only the block
//! of `K = Zᵀ V⁻¹ Z` that belongs to it; its posterior is taken on a grid, in
//! sweeps over all. The prior of an amplitude is half Cauchy with a scale far below
//! the noise of a pose: it says that most causes are absent, and its heavy tail
//! does not hold against data. An amplitude about which the data say nothing keeps
//! its prior and widens what is predicted; so does a group whose prior may be
//! narrower or wider than it is.

use nalgebra::{DMatrix, DVector};

use super::causes::{Cause, Occasion, shapes};
use super::component::{
    Component, FACTORS, GRID, ParameterGroup, block_posterior, component, half_cauchy, noise, pose_variance,
};
use super::dense::{Factor, transposed_product};
use super::linear::{Linear, Posture};
use crate::course::Course;
use crate::error::IdentifyError;

/// Sweeps over all amplitudes, before and after the groups' factors are found.
const SWEEPS: (usize, usize) = (6, 3);

/// The extended model.
#[derive(Debug)]
pub(crate) struct Discrepancy {
    pub(crate) components: Vec<Component>,
    pub(crate) groups: Vec<ParameterGroup>,
    /// `[X Z]`, 3n x (m + k).
    pub(crate) w: DMatrix<f64>,
    /// `Wᵀ W` and `Wᵀ y`.
    pub(crate) n: DMatrix<f64>,
    pub(crate) wy: DVector<f64>,
    /// Columns of `X`.
    pub(crate) m: usize,
    /// Noise variance with all that.
    pub(crate) s2: f64,
    /// Variance of a sound pose's noise, in units of the whitening without robust weights.
    pub(crate) pose_s2: f64,
    /// Degrees of freedom that it rests on.
    pub(crate) freedom: f64,
    /// Root mean square displacement of the TCP by the noise of one observation, in m.
    pub(crate) noise_m: f64,
    /// Columns of causes that were named by tests: they have a wide prior.
    pub(crate) named: usize,
    /// A cause that is absent.
    pub(crate) absent: Option<Cause>,
}

impl Discrepancy {
    /// Finds amplitudes and factors. `groups` are columns of the linear model with
    /// a common prior.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn find(linear: &Linear, course: &Course, groups: Vec<ParameterGroup>) -> Result<Self, IdentifyError> {
        let n = linear.rows.len();
        let joints = linear.rows.first().map_or(0, |p| p.posture.q.len());
        let torques: Vec<f64> = (0..joints)
            .map(|j| (linear.rows.iter().map(|p| p.posture.torque[j].powi(2)).sum::<f64>() / n.max(1) as f64).sqrt())
            .collect();
        let noise_m = noise(linear);
        let seated = linear.rows.iter().any(|p| p.sphere.is_some());
        let shapes = shapes(&torques, course, seated, n > 3);
        let m = linear.x.ncols();
        let mut blocks = Vec::new();
        let mut components = Vec::new();
        let mut at = m;
        for shape in shapes {
            let Some((component, block)) = component(linear, course, shape, noise_m, at) else {
                continue;
            };
            at += component.kept;
            components.push(component);
            blocks.push(block);
        }
        let mut w = DMatrix::zeros(3 * n, at);
        w.columns_mut(0, m).copy_from(&linear.x);
        for (component, block) in components.iter().zip(&blocks) {
            w.columns_mut(component.at, component.kept).copy_from(block);
        }
        let mut found = Self {
            components,
            groups,
            n: transposed_product(&w, &w),
            wy: w.tr_mul(&linear.y),
            w,
            m,
            s2: linear.s2,
            pose_s2: linear.s2,
            freedom: 1.0,
            noise_m,
            named: 0,
            absent: None,
        };
        found.sweep(SWEEPS.0)?;
        found.update_groups()?;
        found.update_noise(linear)?;
        found.sweep(SWEEPS.1)?;
        found.update_groups()?;
        found.update_noise(linear)?;
        Ok(found)
    }

    /// The same model with further whitened columns (3n) that have a wide prior of
    /// the given sigma: its amplitudes are found again.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn with(&self, linear: &Linear, columns: &[(DVector<f64>, f64)]) -> Result<Self, IdentifyError> {
        self.searched(linear, columns, None)
    }

    /// The same model without a cause: the other amplitudes are found again, as [`Self::with`] finds them.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn without(&self, linear: &Linear, cause: Option<Cause>) -> Result<Self, IdentifyError> {
        self.searched(linear, &[], cause)
    }

    /// The same model about another point of linearisation, its amplitudes as they are.
    pub(crate) fn about(&self, linear: &Linear) -> Self {
        let mut w = self.w.clone();
        w.columns_mut(0, self.m).copy_from(&linear.x);
        Self {
            components: self.components.clone(),
            groups: self.groups.clone(),
            n: transposed_product(&w, &w),
            wy: w.tr_mul(&linear.y),
            w,
            absent: self.absent.clone(),
            ..*self
        }
    }

    fn searched(
        &self,
        linear: &Linear,
        columns: &[(DVector<f64>, f64)],
        absent: Option<Cause>,
    ) -> Result<Self, IdentifyError> {
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
        let mut found = Self {
            components: self.components.clone(),
            groups: self.groups.clone(),
            wy: transposed_product(&w, &DMatrix::from_columns(std::slice::from_ref(&linear.y)))
                .column(0)
                .into_owned(),
            n,
            w,
            named: self.named + columns.len(),
            absent,
            ..*self
        };
        for component in &mut found.components {
            if Some(&component.shape.cause) == found.absent.as_ref() {
                component.amplitude = 0.0;
            }
        }
        found.sweep(SWEEPS.0)?;
        found.update_groups()?;
        found.update_noise(linear)?;
        found.sweep(SWEEPS.1)?;
        Ok(found)
    }

    /// Log evidence of the extended model at its amplitudes, their priors included,
    /// up to a constant of the data.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn log_evidence(&self, linear: &Linear) -> Result<f64, IdentifyError> {
        let d = self.sigmas(|_| true);
        let all = self.w.ncols();
        let factor = self.factor(&d, self.s2, 0, all)?;
        let right = factor.half_vector(&(d.component_mul(&self.wy) / self.s2));
        let square = linear.y.norm_squared() / self.s2 - right.norm_squared();
        let mut log = -0.5 * (square + factor.log_determinant() + linear.y.len() as f64 * self.s2.ln());
        for component in &self.components {
            let scale = component.scale();
            log -= (component.amplitude / scale).powi(2).ln_1p();
        }
        for group in self.groups.iter().filter(|g| g.open) {
            log += group.log_prior(group.factor);
        }
        Ok(log)
    }

    /// `ln` of the prior's covariance over the posterior's of the last `count` named
    /// columns: what their prior's width takes off twice the log evidence.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn named_volume(&self, count: usize) -> Result<f64, IdentifyError> {
        let d = self.sigmas(|_| true);
        let all = self.w.ncols();
        let factor = self.factor(&d, self.s2, 0, all)?;
        let mut unit = DMatrix::zeros(all, count);
        for k in 0..count {
            unit[(all - count + k, k)] = 1.0;
        }
        factor.half_mut(&mut unit);
        let covariance = transposed_product(&unit, &unit);
        Ok(-covariance.determinant().max(1e-300).ln())
    }

    /// Means of all columns in units of their sigmas without factors.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn mean(&self) -> Result<DVector<f64>, IdentifyError> {
        let d = self.sigmas(|_| true);
        let factor = self.factor(&d, self.s2, 0, self.w.ncols())?;
        Ok(self.mean_by(&factor, &d, self.s2))
    }

    /// The same by the [`factor`](Self::factor) of all columns at the sigmas `d` and the noise `s2`.
    pub(crate) fn mean_by(&self, factor: &Factor, d: &DVector<f64>, s2: f64) -> DVector<f64> {
        factor.solve_vector(&(d.component_mul(&self.wy) / s2)).component_mul(d)
    }

    /// Effect of the last `count` named columns in their own units, and its covariance.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn named_effect(
        &self,
        columns: &[(DVector<f64>, f64)],
    ) -> Result<(DVector<f64>, DMatrix<f64>), IdentifyError> {
        let d = self.sigmas(|_| true);
        let all = self.w.ncols();
        let count = columns.len();
        let factor = self.factor(&d, self.s2, 0, all)?;
        let mean = self.mean_by(&factor, &d, self.s2);
        let mut unit = DMatrix::zeros(all, count);
        for k in 0..count {
            unit[(all - count + k, k)] = 1.0;
        }
        factor.half_mut(&mut unit);
        let mut covariance = transposed_product(&unit, &unit);
        let mut effect = DVector::zeros(count);
        for r in 0..count {
            effect[r] = mean[all - count + r] * columns[r].1;
            for c in 0..count {
                covariance[(r, c)] *= columns[r].1 * columns[c].1;
            }
        }
        Ok((effect, covariance))
    }

    /// Sigmas of all columns: at the posterior means, without those causes that
    /// `with` refuses.
    pub(crate) fn sigmas(&self, with: impl Fn(&Cause) -> bool) -> DVector<f64> {
        let mut d = DVector::from_element(self.w.ncols(), 1.0);
        for group in &self.groups {
            for &c in &group.columns {
                d[c] = group.factor;
            }
        }
        for component in &self.components {
            let amplitude = if with(&component.shape.cause) {
                component.amplitude
            } else {
                0.0
            };
            d.rows_mut(component.at, component.kept).fill(amplitude);
        }
        d
    }

    /// Factor of `I + D N D / s²` over the columns `from..from + count`.
    pub(crate) fn factor(&self, d: &DVector<f64>, s2: f64, from: usize, count: usize) -> Result<Factor, IdentifyError> {
        let mut a = DMatrix::zeros(count, count);
        for c in 0..count {
            for r in c..count {
                a[(r, c)] = self.n[(from + r, from + c)] * d[from + r] * d[from + c] / s2;
            }
            a[(c, c)] += 1.0;
        }
        Factor::new(a).ok_or(IdentifyError::Singular { free: count })
    }

    /// `Wᵀ V⁻¹ W` and `Wᵀ V⁻¹ y` for the columns `keep`, with `V` of noise and of
    /// the columns `out` alone.
    fn eliminated(
        &self,
        d: &DVector<f64>,
        keep: (usize, usize),
        out: (usize, usize),
    ) -> Result<(DMatrix<f64>, DVector<f64>), IdentifyError> {
        let factor = self.factor(d, self.s2, out.0, out.1)?;
        let mut cross = self.n.view((out.0, keep.0), (out.1, keep.1)).into_owned();
        let mut right = self.wy.rows(out.0, out.1).into_owned();
        for r in 0..out.1 {
            cross.row_mut(r).scale_mut(d[out.0 + r]);
            right[r] *= d[out.0 + r];
        }
        factor.half_mut(&mut cross);
        let right = factor.half_vector(&right);
        let mut g = self.n.view((keep.0, keep.0), (keep.1, keep.1)).into_owned() / self.s2;
        g.gemm(-1.0 / self.s2.powi(2), &cross.transpose(), &cross, 1.0);
        let mut b = self.wy.rows(keep.0, keep.1).into_owned() / self.s2;
        b.gemv_tr(-1.0 / self.s2.powi(2), &cross, &right, 1.0);
        Ok((g, b))
    }

    /// The same with the kept columns in `V` as well.
    fn marginal(
        &self,
        g: &DMatrix<f64>,
        b: &DVector<f64>,
        d: &DVector<f64>,
    ) -> Result<(DMatrix<f64>, DVector<f64>), IdentifyError> {
        let count = b.len();
        let mut a = DMatrix::from_fn(count, count, |r, c| g[(r, c)] * d[r] * d[c]);
        for i in 0..count {
            a[(i, i)] += 1.0;
        }
        let factor = Factor::new(a).ok_or(IdentifyError::Singular { free: count })?;
        let mut half = DMatrix::from_fn(count, count, |r, c| d[r] * g[(r, c)]);
        factor.half_mut(&mut half);
        let right = factor.half_vector(&d.component_mul(b));
        let mut k = g.clone();
        k.gemm(-1.0, &half.transpose(), &half, 1.0);
        let mut v = b.clone();
        v.gemv_tr(-1.0, &half, &right, 1.0);
        Ok((k, v))
    }

    /// Sweeps over all amplitudes.
    fn sweep(&mut self, count: usize) -> Result<(), IdentifyError> {
        let z = (self.m, self.w.ncols() - self.m);
        let (g, b) = self.eliminated(&self.sigmas(|_| true), z, (0, self.m))?;
        for _ in 0..count {
            let d = self.sigmas(|_| true).rows(z.0, z.1).into_owned();
            let (k, v) = self.marginal(&g, &b, &d)?;
            let absent = self.absent.as_ref();
            for component in self.components.iter_mut().filter(|c| Some(&c.shape.cause) != absent) {
                let (from, width) = (component.at - self.m, component.kept);
                let block = k.view((from, from), (width, width)).into_owned();
                let scale = component.scale();
                let (posterior, logs) = block_posterior(
                    block,
                    &v.rows(from, width).into_owned(),
                    component.amplitude.powi(2),
                    GRID.map(|a| a * a),
                    half_cauchy(scale),
                );
                let square: f64 = posterior.iter().zip(GRID).map(|(p, a)| p * a * a).sum();
                component.posterior = posterior;
                component.gain = logs.iter().copied().fold(f64::NEG_INFINITY, f64::max) - logs[0];
                // Half the way in the logarithm: causes that explain the same
                // residuals would else take turns.
                component.amplitude = (component.amplitude.max(1e-3) * square.sqrt().max(1e-3)).sqrt();
            }
        }
        Ok(())
    }

    /// The factors of the model's own groups.
    fn update_groups(&mut self) -> Result<(), IdentifyError> {
        if !self.groups.iter().any(|g| g.open) {
            return Ok(());
        }
        let d = self.sigmas(|_| true);
        let (g, b) = self.eliminated(&d, (0, self.m), (self.m, self.w.ncols() - self.m))?;
        let (k, v) = self.marginal(&g, &b, &d.rows(0, self.m).into_owned())?;
        for group in self.groups.iter_mut().filter(|g| g.open && !g.columns.is_empty()) {
            let block = k.select_rows(&group.columns).select_columns(&group.columns);
            let (posterior, _) = block_posterior(
                block,
                &v.select_rows(&group.columns),
                group.factor.powi(2),
                FACTORS.map(|f| f * f),
                FACTORS.map(|f| group.log_prior(f).exp()),
            );
            let log: f64 = posterior.iter().zip(FACTORS).map(|(p, f)| p * f.ln()).sum();
            group.posterior = posterior;
            group.factor = log.exp();
        }
        Ok(())
    }

    /// Noise variance by the residuals of the extended model, and its freedom.
    fn update_noise(&mut self, linear: &Linear) -> Result<(), IdentifyError> {
        let d = self.sigmas(|_| true);
        let all = self.w.ncols();
        let factor = self.factor(&d, self.s2, 0, all)?;
        let mean = self.mean_by(&factor, &d, self.s2);
        let residual = &linear.y - &self.w * mean;
        let root = factor.half(&DMatrix::identity(all, all));
        let determined = all as f64 - root.norm_squared();
        let rows = 3.0 * linear.rows.iter().map(|p| p.weight.min(1.0)).sum::<f64>();
        self.freedom = (rows - determined).max(1.0);
        self.s2 = (residual.norm_squared() / self.freedom).max(1e-8);
        self.pose_s2 = pose_variance(linear, &residual, rows / self.freedom).unwrap_or(self.s2);
        Ok(())
    }

    /// Whether a column of `W` describes where the nest sits.
    pub(crate) fn is_seat(&self, column: usize) -> bool {
        let seats = self
            .components
            .iter()
            .filter(|c| matches!(c.shape.cause, Cause::Seat | Cause::Nest));
        seats.into_iter().any(|c| (c.at..c.at + c.kept).contains(&column))
    }

    /// `Z` of a prediction at `posture`, 3 x k, and of what the data do not tell
    /// of wide causes, by component.
    pub(crate) fn prediction(&self, posture: &Posture) -> (DMatrix<f64>, Vec<DMatrix<f64>>) {
        let mut z = DMatrix::zeros(3, self.w.ncols() - self.m);
        let mut rest = Vec::with_capacity(self.components.len());
        for component in &self.components {
            let all = component.columns(posture, &Occasion::NOW);
            z.columns_mut(component.at - self.m, component.kept)
                .copy_from(&all.columns(0, component.kept));
            rest.push(all.columns(component.kept, all.ncols() - component.kept).into_owned());
        }
        (z, rest)
    }
}
