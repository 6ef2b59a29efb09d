//! Lets the data decide some properties of the model: how strong and how rough the robot's effects
//! are, and how much of its noise repeats.
//!
//! This step runs between the search of [`map`](super::map) and its covariance. It only chooses
//! among a few alternatives. Learning every variance from the data fails if the model is wrong
//! (`docs/design/identification.md`).

use nalgebra::Vector3;
use rayon::prelude::*;

use super::chain::{N, Prepared};
use super::error::IdentifyError;
use super::normal::{Normal, Root, likelihoods_of_tails};
use super::parameters::Kind;
use super::search::Search;
use super::solve::{Posterior, Unknowns};

/// Factors that multiply the priors of compliance and bending: a real iiwa 7 has compliances of
/// 6e-5 rad/(N m) by its gravity model. Compliance and bending apart, and a factor of 30, were tried
/// (`docs/design/identification.md`).
const STIFFNESS: [f64; 2] = [1.0, 8.0];

/// Alternatives for the priors of the harmonics: a factor on all, and the highest order that the
/// encoders are assumed to have.
const HARMONICS: [(f64, usize); 5] = [(1.0, usize::MAX), (3.0, usize::MAX), (1.0, 2), (0.7, 2), (3.0, 2)];

/// Factor on the prior of an order that is assumed absent.
const ABSENT: f64 = 1e-3;

/// Gain in log evidence that is needed to replace the first priors.
const GAIN: f64 = 3.0;

/// Degrees of freedom of the Student-t weights without gross errors. The heavy tails that gross
/// errors need cost a tenth of the information of clean data.
const LIGHT_TAILS: f64 = 30.0;

/// Gain in log likelihood that is needed to choose light tails.
const TAILS_GAIN: f64 = 3.0;

/// Share of repeating noise at which inflation begins, and the further increase at which it is
/// complete.
const REPEATING: (f64, f64) = (0.025, 0.05);

/// `ln` of the normalising factor of Student's t density of so many numbers, up to terms that do
/// not depend on `nu`.
fn normaliser(nu: f64, numbers: f64) -> f64 {
    libm::lgamma(0.5 * (nu + numbers)) - libm::lgamma(0.5 * nu) - 0.5 * numbers * nu.ln()
}

/// Priors of the effects that the evidence chose, as factors on the table's priors.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct EffectPriors {
    /// Factor on compliance, bending and tilt.
    pub(crate) stiffness: f64,
    /// Factor on the harmonics.
    pub(crate) harmonics: f64,
    /// Highest order of harmonics that is believed.
    pub(crate) orders: usize,
}

impl Default for EffectPriors {
    fn default() -> Self {
        let (harmonics, orders) = HARMONICS[0];
        Self {
            stiffness: STIFFNESS[0],
            harmonics,
            orders,
        }
    }
}

impl Search<'_> {
    /// The unknowns under other priors of the effects.
    fn under(&self, choice: EffectPriors) -> Unknowns {
        let mut unknowns = self.unknowns.clone();
        for (precision, &column) in unknowns.precision.iter_mut().zip(&self.unknowns.columns) {
            let parameter = &self.table[column];
            if parameter.set_by_user {
                continue;
            }
            let factor = match parameter.kind {
                Kind::Compliance(_) | Kind::Bending(..) | Kind::Tilt(_) => choice.stiffness,
                Kind::Cosine(_, k) | Kind::Sine(_, k) if k > choice.orders => ABSENT,
                Kind::Cosine(..) | Kind::Sine(..) => choice.harmonics,
                _ => continue,
            };
            *precision = (parameter.prior_sigma * factor).powi(-2);
        }
        unknowns
    }

    /// Chooses the priors with the best evidence at inflated noise: first the stiffness, then the
    /// harmonics.
    pub(super) fn choose_priors(&mut self, normal: &Normal, inflation: f64) -> Result<EffectPriors, IdentifyError> {
        let s2 = self.s2 * inflation.powi(2);
        let first = EffectPriors::default();
        let softer = STIFFNESS.map(|stiffness| (Some(stiffness), HARMONICS[0]));
        let rougher = HARMONICS[1..].iter().map(|h| (None, *h));
        let mut best = (first, f64::NEG_INFINITY);
        for (stiffness, (harmonics, orders)) in softer.into_iter().chain(rougher) {
            let candidate = EffectPriors {
                stiffness: stiffness.unwrap_or(best.0.stiffness),
                harmonics,
                orders,
            };
            let unknowns = self.under(candidate);
            let evidence = Posterior::new(normal, &unknowns, s2)?.log_evidence(normal, &unknowns, s2);
            let gain = if candidate == first { 0.0 } else { GAIN };
            if evidence > best.1 + gain {
                best = (candidate, evidence);
            }
        }
        self.unknowns = self.under(best.0);
        Ok(best.0)
    }

    /// Chooses light tails if the residuals support them. Returns the log likelihood of heavy tails
    /// over light ones; 0 where there is no choice.
    pub(super) fn choose_tails(&mut self) -> Result<f64, IdentifyError> {
        let heavy = self.nu;
        if heavy <= 0.0 || heavy >= LIGHT_TAILS || !self.options.noise.estimate {
            return Ok(0.0);
        }
        let tails = [heavy, LIGHT_TAILS];
        let found = likelihoods_of_tails(&self.state, self.layout, self.prepared, &self.whitening, tails);
        let gain = (found[0] + self.normalisers(heavy)) - (found[1] + self.normalisers(LIGHT_TAILS));
        if gain < -TAILS_GAIN {
            self.nu = LIGHT_TAILS;
            self.reweight()?;
        }
        Ok(gain)
    }

    /// [`normaliser`] summed over all rows.
    fn normalisers(&self, nu: f64) -> f64 {
        let three = normaliser(nu, 3.0);
        let single = self.prepared.iter().filter(|p| p.further.is_empty()).count();
        let several = self.prepared.iter().filter(|p| !p.further.is_empty());
        single as f64 * three + several.map(|p| normaliser(nu, p.numbers())).sum::<f64>()
    }

    /// How much of the noise repeats. Poses that are neighbours in one joint's angle are compared
    /// along that joint's motion; the correlation of their residuals is averaged over the joints.
    /// Also returns the standard deviation for noise that does not repeat.
    ///
    /// Gear errors outside the model are functions of a joint's angle. They look like noise, but
    /// two poses with the same angle of one joint share them.
    pub(super) fn repeating(&self) -> (f64, f64) {
        let n = self.layout.n;
        let m = self.prepared.len();
        let shares = |(observation, weight): (&Prepared, &f64)| {
            let k = self.state.at(observation);
            let mut columns = [Vector3::zeros(); N];
            for (column, frame) in columns.iter_mut().zip(&k.frames[..n]) {
                *column = frame.z().cross(&(k.tcp - frame.position));
            }
            let floor = self.whitening.leading(observation);
            let covariance = self.whitening.covariance(&columns[..n], floor);
            let root = Root::new(&covariance);
            let residual = root.times(&self.state.residual(observation, &k.tcp)) * weight.sqrt().min(1.0);
            columns.map(|column| {
                let white = root.times(&column);
                let norm = white.norm();
                if norm > 1e-9 { white.dot(&residual) / norm } else { 0.0 }
            })
        };
        let shares: Vec<[f64; N]> = self.prepared.par_iter().zip(&self.weights).map(shares).collect();
        // The same sums on any number of threads: each joint's is one task.
        let correlation = |joint: usize| {
            let mut along: Vec<(f64, f64)> = self
                .prepared
                .iter()
                .map(|p| p.q[joint])
                .zip(shares.iter().map(|s| s[joint]))
                .collect();
            along.sort_by(|a, b| a.0.total_cmp(&b.0));
            let own: f64 = along.iter().map(|x| x.1 * x.1).sum();
            let both: f64 = along.windows(2).map(|w| w[0].1 * w[1].1).sum();
            if own > 0.0 { both / own } else { 0.0 }
        };
        let correlations: Vec<f64> = (0..n).into_par_iter().map(correlation).collect();
        let sum: f64 = correlations.into_iter().sum();
        let count = n.max(1) as f64;
        (sum / count, 1.0 / (count * m.max(1) as f64).sqrt())
    }

    /// Factor on the noise in the covariance and the mode: 1 if the noise clearly does not repeat,
    /// up to the option's value if it may.
    pub(super) fn inflation(&self) -> f64 {
        let most = self.options.noise.inflation;
        if most <= 1.0 || !self.options.noise.estimate {
            return most;
        }
        let (repeats, uncertain) = self.repeating();
        let share = ((repeats + 2.0 * uncertain - REPEATING.0) / REPEATING.1).clamp(0.0, 1.0);
        1.0 + (most - 1.0) * share
    }
}
