//! The statistics of alternatives, each given those that were chosen before: see [`scan`](super::scan).

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector};

use super::alternatives::{Alternative, Family};
use super::extended::Extended;
use super::finding::{FamilyTest, Finding};
use super::linear::Linear;
use super::size::{displaced, displacement, length};
use super::tail::{log_tail, sigmas};
use super::words::{next, short, words};
use crate::course::Course;
use crate::dense::transposed_product;

/// Chance of a false finding over all alternatives of a sound experiment, the load apart.
pub(crate) const FALSE_FINDINGS: f64 = 1e-3;
/// Standard deviations beyond which another load is found: one test, weak too, because the priors of the compliance alone keep a
/// load from passing for more of it. Its chance is 0.5 % for normal errors; `docs/design/record-2026.md` has what was measured.
pub(crate) const LOAD_LIMIT: f64 = 2.8;
/// Natural logarithm of how much more common it is that a nest sits badly for a while than that any other cause
/// meets the same rows: so much less evidence it needs.
const COMMON: f64 = 3.0;
/// An alternative whose effect is less certain than this, in m or rad, is not seen
/// by the data at all.
const UNSEEN: f64 = 5e-3;
/// An alternative that takes up this share of another's effect may be meant instead.
const ALIKE: f64 = 0.9;
/// Alternatives at most that get a closer look.
const CANDIDATES: usize = 12;

/// `ln` of how much more common a cause is than the others.
pub(super) fn odds(alternative: &Alternative) -> f64 {
    match alternative {
        Alternative::Reseat { .. } => COMMON,
        _ => 0.0,
    }
}

/// One alternative with its columns and what was computed of them.
pub(super) struct TriedAlternative {
    pub(super) alternative: Alternative,
    /// Whitened columns.
    pub(super) columns: DMatrix<f64>,
    /// `L⁻¹ Wᵀ A`.
    pub(super) half: DMatrix<f64>,
    /// `Aᵀ P y`.
    pub(super) score: DVector<f64>,
}

/// Scores and half products of all trials over a model.
pub(super) fn prepare(linear: &Linear, model: &Extended, trials: &mut [TriedAlternative]) {
    let factor = model.factor();
    let residual = &linear.y - &model.w * model.mean();
    let total: usize = trials.iter().map(|t| t.columns.ncols()).sum();
    let mut wide = DMatrix::zeros(3 * linear.rows.len(), total);
    let mut at = 0;
    for trial in trials.iter() {
        wide.columns_mut(at, trial.columns.ncols()).copy_from(&trial.columns);
        at += trial.columns.ncols();
    }
    let mut half = transposed_product(&model.w, &wide);
    factor.half_mut(&mut half);
    let score = transposed_product(&wide, &DMatrix::from_columns(&[residual]));
    let mut at = 0;
    for trial in trials {
        let k = trial.columns.ncols();
        trial.half = half.columns(at, k).into_owned();
        trial.score = score.rows(at, k).column(0).into_owned();
        at += k;
    }
}

/// The statistics of trials, given those that were chosen before.
pub(super) struct Selection<'a> {
    /// Families that share the chance of a false finding, with their numbers of alternatives.
    sizes: BTreeMap<Family, usize>,
    pub(super) chosen: Vec<usize>,
    pub(super) trials: &'a [TriedAlternative],
}

impl<'a> Selection<'a> {
    pub(super) fn new(trials: &'a [TriedAlternative]) -> Self {
        let mut sizes = BTreeMap::new();
        for trial in trials {
            *sizes.entry(trial.alternative.family()).or_default() += 1;
        }
        Self {
            sizes,
            chosen: Vec::new(),
            trials,
        }
    }

    /// `Aᵀ P B`.
    fn information(&self, a: &TriedAlternative, b: &TriedAlternative) -> DMatrix<f64> {
        a.columns.tr_mul(&b.columns) - a.half.tr_mul(&b.half)
    }

    /// Score and information of a trial given those chosen before.
    fn given(&self, trial: &TriedAlternative) -> (DVector<f64>, DMatrix<f64>) {
        let mut v = self.information(trial, trial);
        let mut s = trial.score.clone();
        if self.chosen.is_empty() {
            return (s, v);
        }
        let chosen: Vec<&TriedAlternative> = self.chosen.iter().map(|c| &self.trials[*c]).collect();
        let size: usize = chosen.iter().map(|c| c.score.len()).sum();
        let mut inner = DMatrix::zeros(size, size);
        let mut cross = DMatrix::zeros(size, s.len());
        let mut score = DVector::zeros(size);
        let mut row = 0;
        for a in &chosen {
            let mut column = 0;
            for b in &chosen {
                let (r, c) = (a.score.len(), b.score.len());
                inner.view_mut((row, column), (r, c)).copy_from(&self.information(a, b));
                column += c;
            }
            let k = a.score.len();
            cross.rows_mut(row, k).copy_from(&self.information(a, trial));
            score.rows_mut(row, k).copy_from(&a.score);
            row += k;
        }
        if let Ok(inverse) = inner.pseudo_inverse(1e-9) {
            let solved = inverse * &cross;
            v -= cross.tr_mul(&solved);
            s -= solved.tr_mul(&score);
        }
        (s, v)
    }

    /// Effect, its covariance and log tail probability of a trial; `None` where the
    /// data do not see it.
    pub(super) fn test(&self, index: usize) -> Option<(DVector<f64>, DMatrix<f64>, f64)> {
        let trial = &self.trials[index];
        let (s, v) = self.given(trial);
        let eigen = v.symmetric_eigen();
        let mut statistic = 0.0;
        let mut freedom = 0;
        let mut inverse = DMatrix::zeros(s.len(), s.len());
        for (value, vector) in eigen.eigenvalues.iter().zip(eigen.eigenvectors.column_iter()) {
            if *value > UNSEEN.powi(-2) {
                let along = vector.dot(&s);
                statistic += along * along / value;
                freedom += 1;
                inverse.ger(1.0 / value, &vector, &vector, 1.0);
            }
        }
        if freedom == 0 {
            return None;
        }
        Some((&inverse * s, inverse, log_tail(statistic, freedom)))
    }

    /// `ln` of the tail probability below which an alternative is found.
    pub(super) fn limit(&self, alternative: &Alternative) -> f64 {
        match alternative {
            Alternative::Payload => log_tail(LOAD_LIMIT * LOAD_LIMIT, 1),
            _ => FALSE_FINDINGS.ln() - self.tests(alternative) + odds(alternative),
        }
    }

    /// `ln` of the tail probability of the score below which an alternative deserves a closer look. The load's score takes
    /// the compliance for granted that was estimated without it, and so says too little.
    fn looked_at(&self, alternative: &Alternative) -> f64 {
        let limit = self.limit(alternative);
        match alternative {
            Alternative::Payload => 0.5 * limit,
            _ => limit,
        }
    }

    /// `ln` of the number of tests that an alternative's is counted among: each family has the same share of the
    /// false findings, whatever its size, so that a cause with one test is not lost among those with many. The load
    /// is one test with a chance of its own.
    fn tests(&self, alternative: &Alternative) -> f64 {
        if alternative == &Alternative::Payload {
            0.0
        } else {
            let own = self.sizes.get(&alternative.family()).copied().unwrap_or(1);
            ((self.sizes.len() * own) as f64).ln()
        }
    }

    /// The alternatives that deserve a closer look: beyond [`Self::looked_at`], and of those
    /// that differ only in instant or region the strongest.
    pub(super) fn shortlist(&self) -> Vec<usize> {
        let mut over: Vec<(f64, usize)> = (0..self.trials.len())
            .filter(|k| !self.chosen.contains(k))
            .filter_map(|k| Some((self.test(k)?.2, k)))
            .filter(|(log_p, k)| *log_p < self.looked_at(&self.trials[*k].alternative))
            .collect();
        over.sort_by(|a, b| a.0.total_cmp(&b.0));
        let mut kept: Vec<usize> = Vec::new();
        for (_, k) in over {
            let like = |other: &usize| self.trials[*other].alternative.is_like(&self.trials[k].alternative);
            if kept.len() < CANDIDATES && !kept.iter().any(like) {
                kept.push(k);
            }
        }
        kept
    }

    /// The columns of a trial with a prior that does not hold them.
    pub(super) fn wide(&self, index: usize) -> Vec<(DVector<f64>, f64)> {
        let trial = &self.trials[index];
        let Some((effect, covariance, _)) = self.test(index) else {
            return Vec::new();
        };
        let size = (effect.norm_squared() + covariance.trace()).sqrt();
        let column = |c: usize| (trial.columns.column(c).into_owned(), 10.0 * size);
        (0..trial.columns.ncols()).map(column).collect()
    }

    /// The largest statistic of each family.
    pub(super) fn families(&self) -> Vec<FamilyTest> {
        let mut tests: Vec<FamilyTest> = Vec::new();
        for index in 0..self.trials.len() {
            let Some((_, _, log_p)) = self.test(index) else {
                continue;
            };
            let alternative = &self.trials[index].alternative;
            let (family, own) = (alternative.family(), sigmas(log_p));
            let limit = sigmas(self.limit(alternative));
            match tests.iter_mut().find(|t| t.family == family) {
                Some(test) => {
                    test.tested += 1;
                    test.sigmas = test.sigmas.max(own);
                    test.limit = test.limit.min(limit);
                }
                None => tests.push(FamilyTest {
                    family,
                    tested: 1,
                    sigmas: own,
                    found: false,
                    limit,
                }),
            }
        }
        tests.sort_by_key(|t| t.family);
        tests
    }

    /// A finding, its effect from the model `with` its columns, beside what was `known` of it before if the fit holds that.
    pub(super) fn finding(
        &self,
        index: usize,
        log_p: f64,
        known: Option<&Finding>,
        with: &Extended,
        columns: Vec<(DVector<f64>, f64)>,
        linear: &Linear,
        course: &Course,
    ) -> Finding {
        let trial = &self.trials[index];
        let (mut effect, covariance) = with.named_effect(&columns);
        if let Some(known) = known.filter(|known| known.alternative.family().is_of_inputs()) {
            effect += &known.effect;
        }
        let shift = effect.rows(0, effect.len().min(3)).into_owned();
        let (size, sigma) = length(&effect, &covariance);
        let moved = displaced(displacement(linear, &trial.columns), &effect, &covariance);
        let (size, sigma) = match trial.alternative {
            Alternative::Slip { turned: true, .. } => (moved.mm, moved.sigma_mm),
            _ => (size, sigma),
        };
        let signed = if effect.len() == 1 { effect[0] * 1e3 } else { size };
        let words = words(&trial.alternative, &shift, sigma, moved, course);
        if let Some(known) = known {
            return Finding {
                words,
                size: signed,
                sigma,
                columns,
                effect,
                ..known.clone()
            };
        }
        let concerned = |k: &usize| trial.columns.rows(3 * k, 3).norm_squared() > 0.0;
        let mut rows: Vec<usize> = (0..linear.rows.len())
            .filter(concerned)
            .map(|k| linear.rows[k].index)
            .collect();
        // An observation with several targets counts once.
        rows.dedup();
        let mut or: Vec<String> = self.alike(index).into_iter().map(|a| short(&a, course)).collect();
        or.dedup();
        Finding {
            alternative: trial.alternative,
            words,
            size: signed,
            sigma,
            sigmas: sigmas(log_p),
            log10_p: (log_p + self.tests(&trial.alternative)).min(0.0) / core::f64::consts::LN_10,
            harm_mm: 0.0,
            or,
            rows,
            next: next(&trial.alternative),
            columns,
            effect,
        }
    }

    /// Other alternatives that move the data nearly as this one does, one of each
    /// kind.
    fn alike(&self, index: usize) -> Vec<Alternative> {
        let own = &self.trials[index];
        let Some((effect, _, _)) = self.test(index) else {
            return Vec::new();
        };
        let mut found: Vec<Alternative> = Vec::new();
        let (_, v) = self.given(own);
        let strength = (effect.dot(&(&v * &effect))).max(1e-300);
        for (k, other) in self.trials.iter().enumerate() {
            let like = |a: &Alternative| a.says_the_same(&other.alternative);
            if k == index || like(&own.alternative) || found.iter().any(like) {
                continue;
            }
            // How much of the best effect the other's columns take up.
            let cross = self.information(other, own) * &effect;
            let Ok(inverse) = self.information(other, other).pseudo_inverse(UNSEEN.powi(-2)) else {
                continue;
            };
            if cross.dot(&(inverse * &cross)) > ALIKE * strength {
                found.push(other.alternative);
            }
        }
        found
    }
}
