//! Choosing poses by the error that they leave: I-optimality of the predicted
//! TCP over the validation volume, greedy with exchange swaps.
//!
//! With `Σ` the posterior covariance of the structured model (prior sigma as
//! unit), `A_c` the whitened 3 x m rows of candidate c and `W` the mean of
//! `G_vᵀ G_v` over the validation configurations (base aligned), the criterion
//! is `tr(W Σ)`: the mean square of the predicted TCP error. Adding c changes it
//! by `−tr((I + S)⁻¹ T)` with `S = A Σ Aᵀ` and `T = A Σ W Σ Aᵀ`, both 3 x 3. They
//! are kept for every candidate and updated with each choice by products of 6
//! vectors with all rows, so a choice among N costs `18 N m` multiplications.

use nalgebra::{DMatrix, Matrix3, Matrix6, Matrix6xX, SMatrix, Vector3};

/// Mean length of a normal 3-vector over its root mean square (exact if isotropic).
const MEAN_OF_RMS: f64 = 0.9213;

/// What is to be predicted, and what can be measured.
pub(super) struct Problem {
    /// Rows of candidate c are the columns 3c, 3c+1, 3c+2; m x 3N.
    rows: DMatrix<f64>,
    /// `W`, m x m.
    weight: DMatrix<f64>,
    /// `G_vᵀ` of each validation configuration, base aligned, m x 3, in m.
    predictions: Vec<DMatrix<f64>>,
    /// Variance (trace) of the unmodelled joint noise at each of them, in m².
    noise: Vec<f64>,
}

/// Predicted TCP error over the validation configurations, base aligned, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Predicted {
    /// Mean length.
    pub(super) mean: f64,
    /// Mean length at the worst configuration.
    pub(super) worst: f64,
}

impl Problem {
    /// From the candidates' rows (3 x m each, row by row) and from rows, place
    /// and noise of the predictions ([`crate::identify::rows::DesignModel`]).
    pub(super) fn new(m: usize, candidates: &[Vec<f64>], predictions: &[(Vec<f64>, Vector3<f64>, f64)]) -> Self {
        let mut rows = DMatrix::zeros(m, 3 * candidates.len());
        for (target, source) in rows.as_mut_slice().chunks_mut((3 * m).max(1)).zip(candidates) {
            target.copy_from_slice(&source[..3 * m]);
        }
        let noise: Vec<f64> = predictions.iter().map(|p| p.2).collect();
        let points: Vec<Vector3<f64>> = predictions.iter().map(|p| p.1).collect();
        let mut blocks: Vec<DMatrix<f64>> = predictions
            .iter()
            .map(|p| DMatrix::from_column_slice(m, 3, &p.0[..3 * m]))
            .collect();
        align(&mut blocks, &points);
        let mut weight = DMatrix::zeros(m, m);
        for block in &blocks {
            weight.gemm(1.0 / blocks.len().max(1) as f64, block, &block.transpose(), 1.0);
        }
        Self {
            rows,
            weight,
            predictions: blocks,
            noise,
        }
    }

    fn candidate(&self, c: usize) -> DMatrix<f64> {
        self.rows.columns(3 * c, 3).into_owned()
    }

    fn count(&self) -> usize {
        self.rows.ncols() / 3
    }
}

/// Takes the best-fitting rigid motion of all points out of every column.
fn align(blocks: &mut [DMatrix<f64>], points: &[Vector3<f64>]) {
    let m = blocks.first().map_or(0, DMatrix::nrows);
    let mut normal = Matrix6::zeros();
    let mut moments = Matrix6xX::<f64>::zeros(m);
    let motion = |p: &Vector3<f64>| -> SMatrix<f64, 3, 6> {
        let mut b = SMatrix::<f64, 3, 6>::zeros();
        for axis in 0..3 {
            let e: Vector3<f64> = Vector3::ith(axis, 1.0);
            b.fixed_view_mut::<3, 1>(0, axis).copy_from(&e);
            b.fixed_view_mut::<3, 1>(0, axis + 3).copy_from(&e.cross(p));
        }
        b
    };
    for (block, p) in blocks.iter().zip(points) {
        let b = motion(p);
        normal += b.transpose() * b;
        moments += b.transpose() * block.transpose();
    }
    let Some(factor) = normal.cholesky() else {
        return;
    };
    let fitted = factor.solve(&moments);
    for (block, p) in blocks.iter_mut().zip(points) {
        *block -= (motion(p) * &fitted).transpose();
    }
}

/// A growing and changing choice of candidates.
#[derive(Clone)]
pub(super) struct Design<'a> {
    problem: &'a Problem,
    sigma: DMatrix<f64>,
    s: Vec<Matrix3<f64>>,
    t: Vec<Matrix3<f64>>,
    /// Candidates in the order in which they came.
    pub(super) chosen: Vec<usize>,
    taken: Vec<bool>,
    allowed: Vec<bool>,
    /// `tr(W Σ)`, in m².
    pub(super) value: f64,
}

impl<'a> Design<'a> {
    /// Nothing chosen, every candidate allowed.
    pub(super) fn new(problem: &'a Problem) -> Self {
        let m = problem.weight.nrows();
        let n = problem.count();
        let mut design = Self {
            problem,
            sigma: DMatrix::identity(m, m),
            s: vec![Matrix3::zeros(); n],
            t: vec![Matrix3::zeros(); n],
            chosen: Vec::new(),
            taken: vec![false; n],
            allowed: vec![true; n],
            value: 0.0,
        };
        design.refresh();
        design
    }

    /// Only candidates that `allowed` names may be chosen from here on.
    pub(super) fn allow(&mut self, allowed: Vec<bool>) {
        self.allowed = allowed;
    }

    /// Every candidate chosen.
    pub(super) fn with_all(problem: &'a Problem) -> Self {
        let n = problem.count();
        let mut design = Self::new(problem);
        design.chosen = (0..n).collect();
        design.taken = vec![true; n];
        design.refresh();
        design
    }

    /// Computes what the updates keep from scratch.
    fn refresh(&mut self) {
        let m = self.sigma.nrows();
        let mut information = DMatrix::identity(m, m);
        for c in &self.chosen {
            let a = self.problem.candidate(*c);
            information.gemm(1.0, &a, &a.transpose(), 1.0);
        }
        if let Some(factor) = information.cholesky() {
            self.sigma = factor.inverse();
        }
        let weighted = &self.sigma * &self.problem.weight * &self.sigma;
        let y = &weighted * &self.problem.rows;
        let x = if self.chosen.is_empty() {
            self.problem.rows.clone()
        } else {
            &self.sigma * &self.problem.rows
        };
        for c in 0..self.problem.count() {
            let a = self.problem.rows.columns(3 * c, 3);
            let place = |of: &DMatrix<f64>| {
                let product = a.tr_mul(&of.columns(3 * c, 3));
                Matrix3::from_fn(|i, j| product[(i, j)])
            };
            self.s[c] = place(&x);
            self.t[c] = place(&y);
        }
        self.value = self.problem.weight.dot(&self.sigma);
    }

    /// How much adding a candidate takes off the criterion, in m².
    fn gain(&self, c: usize) -> f64 {
        let m = Matrix3::identity() + self.s[c];
        m.try_inverse().map_or(0.0, |inverse| (inverse * self.t[c]).trace())
    }

    /// How much removing a chosen one adds to the criterion, in m².
    fn loss(&self, c: usize) -> f64 {
        let m = Matrix3::identity() - self.s[c];
        m.try_inverse()
            .map_or(f64::INFINITY, |inverse| (inverse * self.t[c]).trace())
    }

    /// The best candidate to add, if there is any left.
    fn best(&self) -> Option<usize> {
        (0..self.problem.count())
            .filter(|c| self.allowed[*c] && !self.taken[*c])
            .max_by(|a, b| self.gain(*a).total_cmp(&self.gain(*b)))
    }

    /// Adds (`sign` 1) or removes (−1) a candidate: the rank-3 update.
    fn update(&mut self, c: usize, sign: f64) {
        let m = (self.s[c] + Matrix3::identity() * sign).try_inverse();
        let Some(inverse) = m else {
            return;
        };
        let n = self.sigma.nrows();
        let a = self.problem.candidate(c);
        let x = &self.sigma * &a;
        let wx = &self.problem.weight * &x;
        let inner = {
            let product = x.tr_mul(&wx);
            Matrix3::from_fn(|i, j| product[(i, j)])
        };
        let mut left = DMatrix::zeros(n, 6);
        left.columns_mut(0, 3).copy_from(&x);
        left.columns_mut(3, 3).copy_from(&(&self.sigma * &wx));
        let product = left.tr_mul(&self.problem.rows);
        for k in 0..self.problem.count() {
            let b: Matrix3<f64> = product.fixed_view::<3, 3>(0, 3 * k).into_owned();
            let d: Matrix3<f64> = product.fixed_view::<3, 3>(3, 3 * k).into_owned();
            let mb = inverse * b;
            let cross = mb.transpose() * d;
            self.s[k] -= b.transpose() * mb;
            self.t[k] += mb.transpose() * inner * mb - cross - cross.transpose();
        }
        let scaled = &x * inverse;
        self.sigma.gemm(-1.0, &scaled, &x.transpose(), 1.0);
        self.value -= (inverse * inner).trace();
        self.taken[c] = sign > 0.0;
        if sign > 0.0 {
            self.chosen.push(c);
        } else {
            self.chosen.retain(|k| *k != c);
        }
    }

    /// Adds the best candidates until `count` are chosen. `on_step` sees the
    /// design after each.
    pub(super) fn grow(&mut self, count: usize, mut on_step: impl FnMut(&Self)) {
        while self.chosen.len() < count {
            let Some(c) = self.best() else {
                return;
            };
            self.update(c, 1.0);
            on_step(self);
        }
    }

    /// Exchange swaps: each chosen pose is taken out, least useful first, and
    /// the best candidate put in its place; ends when a pass takes less than
    /// `tolerance` (relative) off the criterion, or after `passes`.
    pub(super) fn exchange(&mut self, passes: usize, tolerance: f64) {
        for _ in 0..passes {
            let before = self.value;
            let mut turn: Vec<usize> = self.chosen.clone();
            turn.sort_by(|a, b| self.loss(*a).total_cmp(&self.loss(*b)));
            for c in turn {
                self.update(c, -1.0);
                match self.best() {
                    Some(new) => self.update(new, 1.0),
                    None => self.update(c, 1.0),
                }
            }
            if before - self.value < tolerance * before {
                break;
            }
        }
    }

    /// The predicted error with this choice, `floor` times the joint noise included.
    pub(super) fn predicted(&self, floor: f64) -> Predicted {
        let (mut sum, mut worst) = (0.0, 0.0f64);
        for (g, noise) in self.problem.predictions.iter().zip(&self.problem.noise) {
            let spread = g.dot(&(&self.sigma * g)) + floor * floor * noise;
            let length = MEAN_OF_RMS * spread.max(0.0).sqrt();
            sum += length;
            worst = worst.max(length);
        }
        Predicted {
            mean: sum / self.problem.predictions.len().max(1) as f64,
            worst,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plan::ik::halton;

    fn problem(n: usize, m: usize) -> Problem {
        let number = |i: usize, k: usize| 4.0 * halton(i * 31 + k * 7 + 1, (i + k) % 11) - 2.0;
        let candidates: Vec<Vec<f64>> = (0..n).map(|c| (0..3 * m).map(|k| number(c, k)).collect()).collect();
        let predictions = (0..9)
            .map(|v| {
                let rows = (0..3 * m).map(|k| number(v + 1000, k)).collect();
                let p = Vector3::new(halton(v + 1, 0), halton(v + 1, 1), halton(v + 1, 2));
                (rows, p, 0.1)
            })
            .collect::<Vec<_>>();
        Problem::new(m, &candidates, &predictions)
    }

    // The criterion from scratch, by inverting the information matrix.
    fn direct(problem: &Problem, chosen: &[usize]) -> f64 {
        let m = problem.weight.nrows();
        let mut information = DMatrix::<f64>::identity(m, m);
        for c in chosen {
            let a = problem.candidate(*c);
            information += &a * a.transpose();
        }
        (&problem.weight * information.try_inverse().expect("positive definite")).trace()
    }

    // Fails if an update of Σ, S, T or the criterion is wrong in adding or removing.
    #[test]
    fn updates_equal_the_direct_computation() {
        let problem = problem(40, 8);
        let mut design = Design::new(&problem);
        assert!((design.value - direct(&problem, &[])).abs() < 1e-9);
        for (c, sign) in [(3, 1.0), (17, 1.0), (22, 1.0), (17, -1.0), (30, 1.0), (3, -1.0)] {
            let expected = design.value - if sign > 0.0 { design.gain(c) } else { -design.loss(c) };
            design.update(c, sign);
            assert!((design.value - expected).abs() < 1e-9);
            assert!((design.value - direct(&problem, &design.chosen)).abs() < 1e-9);
        }
        let (s, t) = (design.s.clone(), design.t.clone());
        design.refresh();
        for k in 0..40 {
            assert!((design.s[k] - s[k]).amax() < 1e-9);
            assert!((design.t[k] - t[k]).amax() < 1e-9);
        }
    }

    // Fails if the greedy step is not the best single one, or a swap makes things worse.
    #[test]
    fn greedy_takes_the_best_and_exchange_never_loses() {
        let problem = problem(40, 8);
        let mut design = Design::new(&problem);
        design.grow(1, |_| ());
        let best = (0..40).map(|c| direct(&problem, &[c])).fold(f64::INFINITY, f64::min);
        assert!((design.value - best).abs() < 1e-9);
        design.grow(6, |_| ());
        let before = design.value;
        design.exchange(3, 1e-9);
        assert_eq!(design.chosen.len(), 6);
        assert!(design.value <= before + 1e-12);
    }

    // Fails if a rigid motion of all validation points still counts as error.
    #[test]
    fn the_base_is_aligned_out() {
        let points: Vec<Vector3<f64>> = (1..9)
            .map(|i| Vector3::new(halton(i, 0), halton(i, 1), halton(i, 2)))
            .collect();
        let mut blocks: Vec<DMatrix<f64>> = points
            .iter()
            .map(|p| {
                let v = Vector3::new(0.1, -0.2, 0.3) + Vector3::new(0.4, 0.5, -0.6).cross(p);
                DMatrix::from_row_slice(1, 3, v.as_slice())
            })
            .collect();
        align(&mut blocks, &points);
        assert!(blocks.iter().all(|b| b.amax() < 1e-12));
    }
}
