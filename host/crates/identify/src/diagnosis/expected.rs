//! The expected error: how far the TCP of a model is from where it really is, over
//! the whole workspace.
//!
//! The *workspace* is a set of configurations spread over the joint ranges whose
//! TCP lies in front of the arm ([`workspace`]); the poses of the measurement play
//! no part in it. The error is that of the arm's shape: the best rigid motion of
//! all points is taken out, because where the base stands is not the model's merit.
//!
//! Draws from the posterior of the extended model
//! ([`discrepancy`](super::discrepancy)) are differences between what may be true
//! and what was estimated. Each draw gives one mean error over the workspace; their
//! mean is the expected error, and their quantiles its interval. So the interval
//! holds what the noise leaves open, what the model may leave out, and how well the
//! sizes of both are known. The draws take one thing for granted: that errors which
//! no cause describes are white, so that they average out. [`Size`] makes the error
//! larger and widens the interval by that where the residuals' tails speak for such errors.

use std::sync::Arc;

use nalgebra::{DMatrix, DVector, DVectorView, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{ChiSquared, Distribution, StandardNormal};
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{LinkTransform, Pose as Frame, Robot, Tool};

use super::budget::{Accounts, ErrorBudget, SizeSet, joint_shares, squared_columns};
use super::dense::transposed_product;
use super::discrepancy::Discrepancy;
use super::linear::{Linear, Posture};
use crate::error::IdentifyError;
use crate::expected_error::ExpectedError;
use spherecal_model::halton::halton;

/// Configurations of a workspace.
pub const WORKSPACE: usize = 200;
/// Sets of amplitudes that are drawn, and draws with each.
const DRAWS: (usize, usize) = (32, 10);
/// Share of the draws inside the interval.
const INSIDE: f64 = 0.95;
/// The size of the whole error beyond what the draws hold: where the residuals have light tails, where
/// the rows are too few to tell, and where they have heavy ones. Set on simulated
/// robots (`docs/theory.md` says which, and what other robots then showed).
const SIZES: [Size; 3] = [
    Size {
        factor: 1.0,
        sigma: 0.10,
    },
    Size {
        factor: 1.0,
        sigma: 0.20,
    },
    Size {
        factor: 1.2,
        sigma: 0.30,
    },
];
/// Log likelihood of heavy tails over light ones, or the reverse, from which the
/// tails are known.
const TAILS_KNOWN: f64 = 3.0;
/// Standard deviations of a normal variable that hold [`INSIDE`].
const TWO_SIDED: f64 = 1.96;

/// The workspace of a robot with its tool: joint angles (rad) of 200 configurations.
///
/// They are spread evenly over 95 % of each joint's range (at most half a turn
/// either way), and kept where the TCP is in front of the arm: x from -0.05 to
/// 1.0 m, y within 0.6 m, z from 0.13 to 1.15 m, scaled by the arm's reach over
/// 1.4 m. That is the box of the paper's Table 4 for any arm.
pub fn workspace(robot: &Robot, tool: &Tool) -> Vec<Vec<f64>> {
    let links: Vec<LinkTransform<f64>> = robot.joints.iter().map(|j| LinkTransform::from(&j.mdh)).collect();
    let mut frames = vec![Frame::identity(); links.len()];
    let mut tcp = |q: &[f64]| -> Vector3<f64> { frames_into(&links, q, &mut frames).point(&tool.tcp()) };
    let configuration = |k: usize| -> Vec<f64> {
        let joint = |(j, of): (usize, &spherecal_shared::robot::Joint)| {
            let l = &of.limits;
            let middle = 0.5 * (l.min_rad + l.max_rad);
            let half = (0.5 * (l.max_rad - l.min_rad)).min(core::f64::consts::PI);
            middle + 0.95 * half * (2.0 * halton(k, j) - 1.0)
        };
        robot.joints.iter().enumerate().map(joint).collect()
    };
    let reach = (1..=500).map(|k| tcp(&configuration(k)).norm()).fold(0.1, f64::max);
    let scale = reach / 1.4;
    let inside = |p: &Vector3<f64>| {
        (-0.05..=1.0).contains(&(p.x / scale)) && (p.y / scale).abs() <= 0.6 && (0.13..=1.15).contains(&(p.z / scale))
    };
    let found: Vec<Vec<f64>> = (1..20_000)
        .map(configuration)
        .filter(|q| inside(&tcp(q)))
        .take(WORKSPACE)
        .collect();
    if found.len() == WORKSPACE {
        return found;
    }
    // An arm that hardly comes before its base: anywhere in its joint ranges.
    (1..=WORKSPACE).map(configuration).collect()
}

/// Takes the best-fitting rigid motion of all points out of displacements.
#[derive(Clone, Debug)]
pub(crate) struct Rigid {
    basis: DMatrix<f64>,
}

impl Rigid {
    pub(crate) fn new(points: &[Vector3<f64>]) -> Self {
        let mut b = DMatrix::zeros(3 * points.len(), 6);
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        for (k, p) in points.iter().enumerate() {
            for axis in 0..3 {
                let e: Vector3<f64> = Vector3::ith(axis, 1.0);
                b[(3 * k + axis, axis)] = 1.0;
                let turn = e.cross(&(p - middle));
                for i in 0..3 {
                    b[(3 * k + i, 3 + axis)] = turn[i];
                }
            }
        }
        Self { basis: b.qr().q() }
    }

    /// Removes the motion from each column.
    pub(crate) fn remove(&self, columns: &mut DMatrix<f64>) {
        let share = transposed_product(&self.basis, columns);
        columns.gemm(-1.0, &self.basis, &share, 1.0);
    }
}

/// Whether the residuals have heavy tails, by the log likelihood of these over light ones.
pub(crate) fn has_heavy_tails(heavy_tails: f64) -> bool {
    heavy_tails > TAILS_KNOWN
}

/// The size of the whole error beyond what the draws hold.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Size {
    /// By how much the error is larger than the draws say, in the median: errors that no cause describes only add.
    pub(crate) factor: f64,
    /// How well that is known: a standard deviation of the logarithm.
    sigma: f64,
}

impl Size {
    /// By the log likelihood of heavy tails of the residuals over light ones. Errors that no cause describes differ
    /// from pose to pose: an arm that has them has residuals with heavy tails.
    pub(crate) fn of(heavy_tails: f64) -> Self {
        let [light, open, heavy] = SIZES;
        if has_heavy_tails(heavy_tails) {
            heavy
        } else if heavy_tails < -TAILS_KNOWN {
            light
        } else {
            open
        }
    }

    /// Of mean errors and 95 % quantiles (m) by draw, which have the factor already where it applies.
    pub(crate) fn summary(self, mut means: Vec<f64>, p95: &[f64]) -> ExpectedError {
        let count = means.len().max(1) as f64;
        means.sort_by(f64::total_cmp);
        let mean = means.iter().sum::<f64>() / count;
        // Both spreads are independent, so their logarithms add in quadrature.
        let end = |share: f64| {
            let own = (quantile(&means, share) / mean).max(f64::MIN_POSITIVE).ln();
            let wide = own.hypot(TWO_SIDED * self.sigma);
            mean * if share < 0.5 { (-wide).exp() } else { wide.exp() }
        };
        let interval = [end(0.5 * (1.0 - INSIDE)), end(0.5 * (1.0 + INSIDE))];
        ExpectedError {
            mean: mean * 1e3,
            p95: p95.iter().sum::<f64>() / count * 1e3,
            interval: if mean > 0.0 {
                interval.map(|m| m * 1e3)
            } else {
                [0.0; 2]
            },
        }
    }
}

/// What may be true minus what was estimated, over the workspace.
#[derive(Clone, Debug)]
pub(crate) struct Field {
    rigid: Rigid,
    /// One draw a column, 3 x configurations, in m, aligned.
    draws: DMatrix<f64>,
    /// The size of the whole error beyond the draws.
    size: Size,
    /// What tells the same by source.
    accounts: Arc<Accounts>,
}

impl Field {
    /// Draws the error of a fit. `rows` gives the columns of the model at a
    /// configuration in units of the linear model's scale (3 x m), and the posture;
    /// `plate` are the columns of the certified coordinates; `size` is that of the fit.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn draw(
        linear: &Linear,
        discrepancy: Discrepancy,
        configurations: &[(DMatrix<f64>, Posture)],
        plate: Vec<usize>,
        size: Size,
    ) -> Result<Self, IdentifyError> {
        let count = configurations.len();
        let (m, all) = (discrepancy.m, discrepancy.w.ncols());
        let points: Vec<Vector3<f64>> = configurations.iter().map(|c| c.1.tcp).collect();
        let rigid = Rigid::new(&points);
        let mut g = DMatrix::zeros(3 * count, all);
        let mut rest: Vec<DMatrix<f64>> = Vec::new();
        for (k, (rows, posture)) in configurations.iter().enumerate() {
            g.view_mut((3 * k, 0), (3, m)).copy_from(rows);
            let (z, own) = discrepancy.prediction(posture);
            g.view_mut((3 * k, m), (3, all - m)).copy_from(&z);
            if rest.is_empty() {
                rest = own.iter().map(|o| DMatrix::zeros(3 * count, o.ncols())).collect();
            }
            for (to, from) in rest.iter_mut().zip(&own) {
                to.rows_mut(3 * k, 3).copy_from(from);
            }
        }
        rigid.remove(&mut g);
        for block in &mut rest {
            rigid.remove(block);
        }
        let estimate = g.columns(0, m) * &linear.estimate;
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let spread = ChiSquared::new(discrepancy.freedom.max(1.0)).ok();
        let mut draws = DMatrix::zeros(3 * count, DRAWS.0 * DRAWS.1);
        let mut sets = Vec::with_capacity(DRAWS.0);
        for h in 0..DRAWS.0 {
            let mut d = discrepancy.sigmas(|_| true);
            for group in &discrepancy.groups {
                let factor = group.drawn(rng.random());
                group.columns.iter().for_each(|c| d[*c] = factor);
            }
            let mut amplitudes = Vec::with_capacity(discrepancy.components.len());
            for component in &discrepancy.components {
                let amplitude = component.drawn(rng.random());
                d.rows_mut(component.at, component.kept).fill(amplitude);
                amplitudes.push(amplitude);
            }
            let chi: f64 = spread.map_or(discrepancy.freedom, |s| s.sample(&mut rng));
            let s2 = discrepancy.s2 * discrepancy.freedom / f64::max(chi, 1e-3 * discrepancy.freedom);
            let factor = discrepancy.factor(&d, s2, 0, all)?;
            let mean = factor.solve_vector(&(d.component_mul(&discrepancy.wy) / s2));
            let joint_variance = discrepancy.pose_s2 * s2 / discrepancy.s2 * linear.joint_variance;
            let mut normal = |n: usize| DVector::from_fn(n, |_, _| StandardNormal.sample(&mut rng));
            let mut w = DMatrix::zeros(all, DRAWS.1);
            for mut column in w.column_iter_mut() {
                let white: DVector<f64> = normal(all);
                column.copy_from(&(&mean + factor.draw(&white)).component_mul(&d));
            }
            let mut own = &g * w;
            for mut column in own.column_iter_mut() {
                column -= &estimate;
                for (block, amplitude) in rest.iter().zip(&amplitudes) {
                    if *amplitude > 0.0 && block.ncols() > 0 {
                        let white: DVector<f64> = normal(block.ncols());
                        column.gemv(*amplitude, block, &white, 1.0);
                    }
                }
                let sigma = joint_variance.sqrt();
                for (k, (_, posture)) in configurations.iter().enumerate() {
                    let white: DVector<f64> = normal(posture.joints.len());
                    for (along, z) in posture.joints.iter().zip(white.iter()) {
                        for axis in 0..3 {
                            column[3 * k + axis] += along[axis] * z * sigma;
                        }
                    }
                }
            }
            draws.columns_mut(h * DRAWS.1, DRAWS.1).copy_from(&own);
            sets.push(SizeSet {
                mean: mean.component_mul(&d),
                sigmas: d,
                amplitudes,
                s2,
                joint_variance,
            });
        }
        let accounts = Accounts {
            factor: size.factor,
            joint_shares: joint_shares(linear),
            contacts: linear.rows.iter().filter(|row| row.sphere.is_some()).count(),
            joints: squared_columns(configurations.iter().map(|c| &c.1.joints)),
            discrepancy,
            plate,
            g,
            rest,
            estimate,
            sets,
        };
        Ok(Self {
            rigid,
            draws,
            size,
            accounts: Arc::new(accounts),
        })
    }

    /// The expected error of a model whose TCP is `off` (m, 3 x configurations) from
    /// the estimate's; of the estimate itself without.
    pub(crate) fn expected(&self, off: Option<&[Vector3<f64>]>) -> ExpectedError {
        let (means, p95) = self.errors(off, self.size.factor);
        self.size.summary(means, &p95)
    }

    /// The same by source; none where the equations have no solution.
    pub(crate) fn budget(&self, off: &[Vector3<f64>]) -> Option<ErrorBudget> {
        self.accounts.budget(&self.aligned(Some(off)))
    }

    /// A displacement over the workspace without its rigid motion, 3 configurations x 1.
    fn aligned(&self, off: Option<&[Vector3<f64>]>) -> DMatrix<f64> {
        let mut shift = DMatrix::zeros(self.draws.nrows(), 1);
        for (k, v) in off.into_iter().flatten().enumerate() {
            for axis in 0..3 {
                shift[(3 * k + axis, 0)] = v[axis];
            }
        }
        self.rigid.remove(&mut shift);
        shift
    }

    /// Root mean square error over the workspace, in m: of all draws, with the factor of the size.
    pub(crate) fn rms(&self, off: &[Vector3<f64>]) -> f64 {
        let shift = self.aligned(Some(off));
        let error = |c: DVectorView<'_, f64>| (c * self.size.factor - shift.column(0)).norm_squared();
        let squares = self.draws.column_iter().map(error);
        (squares.sum::<f64>() / (self.draws.len() / 3).max(1) as f64).sqrt()
    }

    /// Mean error over the workspace by draw, in m, of a model whose TCP is `off` (m) from the estimate's. The draws
    /// are what the data allow; the factor of the size is no part of them.
    pub(crate) fn drawn(&self, off: &[Vector3<f64>]) -> Vec<f64> {
        self.errors(Some(off), 1.0).0
    }

    /// Mean error and its 95 % quantile over the workspace, by draw, in m; the draws are taken `factor` times.
    fn errors(&self, off: Option<&[Vector3<f64>]>, factor: f64) -> (Vec<f64>, Vec<f64>) {
        let shift = self.aligned(off);
        let mut means = Vec::with_capacity(self.draws.ncols());
        let mut p95 = Vec::with_capacity(self.draws.ncols());
        for column in self.draws.column_iter() {
            let mut lengths: Vec<f64> = (0..column.len() / 3)
                .map(|k| {
                    let at = |axis: usize| factor * column[3 * k + axis] - shift[3 * k + axis];
                    Vector3::new(at(0), at(1), at(2)).norm()
                })
                .collect();
            means.push(lengths.iter().sum::<f64>() / lengths.len().max(1) as f64);
            lengths.sort_by(f64::total_cmp);
            p95.push(quantile(&lengths, INSIDE));
        }
        (means, p95)
    }
}

/// Quantile of sorted values, between neighbours in proportion.
fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return 0.0;
    };
    let at = share * last as f64;
    let (low, high) = (at.floor() as usize, at.ceil() as usize);
    sorted[low] + (sorted[high] - sorted[low]) * (at - low as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if draws that all agree give an interval without width, if the interval does not
    // hold the spread of draws that differ, if heavy tails do not widen it, or if no error at all
    // gives a number that is none.
    #[test]
    fn the_interval_is_wider_than_the_draws() {
        let (light, open, heavy) = (Size::of(-4.0), Size::of(0.0), Size::of(4.0));
        let same = light.summary(vec![1e-4; 50], &[2e-4; 50]);
        let (low, high) = (same.interval[0] / same.mean, same.interval[1] / same.mean);
        assert!(
            (0.8..0.9).contains(&low) && (low * high - 1.0).abs() < 1e-12,
            "{same:?}"
        );
        let means: Vec<f64> = (0..101).map(|k| 0.5e-4 + 1e-6 * f64::from(k)).collect();
        let wide = heavy.summary(vec![1e-4; 50], &[2e-4; 50]);
        assert!(wide.interval[1] / wide.mean > 1.7, "{wide:?}");
        assert!(light.sigma < open.sigma && open.sigma < heavy.sigma);
        assert!(light.factor <= open.factor && open.factor < heavy.factor);
        let spread = light.summary(means, &[2e-4; 101]);
        assert!(spread.interval[0] < 0.0525 && spread.interval[1] > 0.1475, "{spread:?}");
        assert_eq!(light.summary(vec![0.0; 3], &[0.0; 3]).interval, [0.0; 2]);
    }
}
