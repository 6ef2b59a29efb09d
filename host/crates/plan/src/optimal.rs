//! Chooses poses by the predicted error: I-optimality of the predicted TCP over the validation
//! volume, greedy with exchange swaps.
//!
//! Let `Σ` be the posterior covariance of the full model (in units of the prior sigma), `A_c` the
//! whitened 3 x m rows of candidate c, and `W` the mean of `G_vᵀ G_v` over the validation
//! configurations (base aligned). The criterion is `tr(W Σ)`, the mean square of the predicted TCP
//! error. Adding c changes it by `−tr((I + S)⁻¹ T)` with `S = A Σ Aᵀ` and `T = A Σ W Σ Aᵀ`, both 3 x 3. `S` and `T` are
//! stored for every candidate and updated with each choice, so a choice among N costs `18 N m` multiplications,
//! where many are chosen in single precision: they only rank. `Σ` and the criterion have double precision.
//!
//! A choice may weigh a pose's gain against its travel time ([`Travel`]).

use nalgebra::{DMatrix, Matrix3};
use rayon::prelude::*;

use super::selection::{Lanes, SelectionProblem, product};
use super::travel::Travel;

/// Number of chosen poses from which single precision ranks the candidates. `S` and `T` fall by orders of magnitude
/// with the first poses, so the error of single precision would remain.
const MANY: usize = 32;
/// Mean length of a normal 3-vector over its root mean square (exact if isotropic).
const MEAN_OF_RMS: f64 = 0.9213;

/// Predicted TCP error over the validation configurations, base aligned, in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Predicted {
    pub(super) mean: f64,
    /// Mean length at the worst configuration.
    pub(super) worst: f64,
}

/// A growing and changing choice of candidates.
#[derive(Clone)]
pub(super) struct Design<'a> {
    problem: &'a SelectionProblem,
    sigma: DMatrix<f64>,
    s: Vec<Matrix3<f64>>,
    t: Vec<Matrix3<f64>>,
    /// Candidates in the order in which they came.
    pub(super) chosen: Vec<usize>,
    taken: Vec<bool>,
    allowed: Vec<bool>,
    /// Candidates whose gain is kept up to date: those that may be chosen later.
    kept: Vec<bool>,
    /// Travel and how patiently it is borne.
    travel: Option<(Travel<'a>, f64)>,
    /// `tr(W Σ)`, in m².
    pub(super) value: f64,
}

impl<'a> Design<'a> {
    /// Nothing chosen, every candidate allowed.
    pub(super) fn new(problem: &'a SelectionProblem) -> Self {
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
            kept: vec![true; n],
            travel: None,
            value: 0.0,
        };
        design.refresh();
        design
    }

    /// From here on weighs gains against travel time. `patience` is the duration of a turn, in
    /// recordings, at which half of its gain is discounted.
    pub(super) fn hurry(&mut self, mut travel: Travel<'a>, patience: f64) {
        for c in &self.chosen {
            travel.add(*c);
        }
        self.travel = Some((travel, patience));
    }

    /// These candidates chosen, in this order.
    pub(super) fn of(problem: &'a SelectionProblem, chosen: Vec<usize>) -> Self {
        let mut design = Self::new(problem);
        for c in &chosen {
            design.taken[*c] = true;
        }
        design.chosen = chosen;
        design.refresh();
        design
    }

    /// The same design with only `allowed` candidates, filled with the best of these until `count`
    /// are chosen. The others cannot be allowed again.
    pub(super) fn among(&self, allowed: Vec<bool>, count: usize) -> Self {
        let mut design = self.clone();
        design.kept = allowed.iter().zip(&self.taken).map(|(a, t)| *a || *t).collect();
        for c in &self.chosen {
            if !allowed[*c] {
                design.update(*c, -1.0);
            }
        }
        design.allow(allowed);
        design.grow(count, |_| ());
        design
    }

    /// The chosen candidates, and the `count` most useful of the other allowed ones: the candidates
    /// for an exchange.
    pub(super) fn shortlist(&self, count: usize) -> Vec<usize> {
        let mut others: Vec<usize> = (0..self.problem.count())
            .filter(|c| self.allowed[*c] && !self.taken[*c])
            .collect();
        others.sort_by(|a, b| self.worth(*b).total_cmp(&self.worth(*a)));
        others.truncate(count);
        self.chosen.iter().copied().chain(others).collect()
    }

    /// From here on only candidates in `allowed` may be chosen.
    pub(super) fn allow(&mut self, allowed: Vec<bool>) {
        self.allowed = allowed;
    }

    /// Every candidate chosen.
    pub(super) fn with_all(problem: &'a SelectionProblem) -> Self {
        Self::of(problem, (0..problem.count()).collect())
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

    /// How much adding a candidate lowers the criterion, in m².
    fn gain(&self, c: usize) -> f64 {
        let m = Matrix3::identity() + self.s[c];
        m.try_inverse().map_or(0.0, |inverse| (inverse * self.t[c]).trace())
    }

    /// How much removing a chosen candidate raises the criterion, in m².
    fn loss(&self, c: usize) -> f64 {
        let m = Matrix3::identity() - self.s[c];
        m.try_inverse()
            .map_or(f64::INFINITY, |inverse| (inverse * self.t[c]).trace())
    }

    /// Gain of a candidate, with its travel considered.
    fn worth(&self, c: usize) -> f64 {
        let share = self.travel.as_ref().map_or(1.0, |(t, patience)| t.share(c, *patience));
        share * self.gain(c)
    }

    /// The best candidate to add, if there is any left.
    fn best(&self) -> Option<usize> {
        (0..self.problem.count())
            .filter(|c| self.allowed[*c] && !self.taken[*c])
            .map(|c| (c, self.worth(c)))
            .max_by(|a, b| a.1.total_cmp(&b.1))
            .map(|(c, _)| c)
    }

    /// Adds (`sign` 1) or removes (−1) a candidate: the rank-3 update.
    fn update(&mut self, c: usize, sign: f64) {
        let a = self.problem.candidate(c);
        let x = &self.sigma * &a;
        let place = |product: DMatrix<f64>| Matrix3::from_fn(|i, j| product[(i, j)]);
        let m = (place(a.tr_mul(&x)) + Matrix3::identity() * sign).try_inverse();
        let Some(inverse) = m else {
            return;
        };
        let wx = &self.problem.weight * &x;
        let inner = place(x.tr_mul(&wx));
        let wide = &self.sigma * &wx;
        let problem = self.problem;
        if self.chosen.len() < MANY {
            self.rank(&problem.double, &x, &wide, &inverse, &inner);
        } else {
            self.rank(&problem.single, &x, &wide, &inverse, &inner);
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
        if let Some((travel, _)) = &mut self.travel {
            if sign > 0.0 {
                travel.add(c);
            } else {
                travel.remove(c, &self.chosen);
            }
        }
    }

    /// Updates `S` and `T` of all candidates, whose rows these are, with the `X`, `Σ W X`, `(S + 1)⁻¹` and `Xᵀ W X` of
    /// [`Self::update`].
    fn rank<T: Lanes>(
        &mut self,
        rows: &[T],
        x: &DMatrix<f64>,
        wide: &DMatrix<f64>,
        inverse: &Matrix3<f64>,
        inner: &Matrix3<f64>,
    ) {
        let (left, wide) = (T::columns(x), T::columns(wide));
        let own = self.s.par_iter_mut().zip(self.t.par_iter_mut());
        let own = own.zip(rows.par_chunks(left.len().max(1)));
        let own = own.zip(&self.kept).with_min_len(64);
        own.filter(|(_, kept)| **kept).for_each(|(((s, t), rows), _)| {
            let (b, d) = (product(&left, rows), product(&wide, rows));
            let mb = inverse * b;
            let cross = mb.transpose() * d;
            *s -= b.transpose() * mb;
            *t += mb.transpose() * inner * mb - cross - cross.transpose();
        });
    }

    /// Adds the best candidates until `count` are chosen. `on_step` is called with the design after
    /// each.
    pub(super) fn grow(&mut self, count: usize, mut on_step: impl FnMut(&Self)) {
        while self.chosen.len() < count {
            let Some(c) = self.best() else {
                return;
            };
            self.update(c, 1.0);
            on_step(self);
        }
    }

    /// Exchange swaps: removes each chosen pose, the least useful first, and adds the best
    /// candidate instead. Ends when a pass lowers the criterion by less than `tolerance`
    /// (relative), or after `passes`.
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

    /// Root mean square of the predicted error with this choice, with `floor` times the joint
    /// noise, in m (times the mean length over it).
    pub(super) fn root_mean_square(&self, floor: f64) -> f64 {
        let noise = self.problem.noise.iter().sum::<f64>() / self.problem.noise.len().max(1) as f64;
        MEAN_OF_RMS * (self.value + floor * floor * noise).max(0.0).sqrt()
    }

    /// The predicted error with this choice, with `floor` times the joint noise.
    pub(super) fn predicted(&self, floor: f64) -> Predicted {
        let all = self.problem.predictions.par_iter().zip(&self.problem.noise);
        let lengths: Vec<f64> = all
            .map(|(g, noise)| {
                let spread = g.dot(&(&self.sigma * g)) + floor * floor * noise;
                MEAN_OF_RMS * spread.max(0.0).sqrt()
            })
            .collect();
        Predicted {
            mean: lengths.iter().sum::<f64>() / lengths.len().max(1) as f64,
            worst: lengths.iter().copied().fold(0.0, f64::max),
        }
    }
}

#[cfg(test)]
#[path = "optimal_tests.rs"]
mod tests;
