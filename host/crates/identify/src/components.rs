//! What each target's noise and the joints' noise are, where rows have several parts.
//!
//! A row of one part cannot tell its joint noise from its own; only their proportion in three steps
//! is tried there ([`search`](super::search)). The parts of one row share the joint noise and
//! nothing else, so all variances follow from the residuals: the covariance of a row is
//! `C = σ_q² J Jᵀ + diag(σ_k² I)`. The likelihood is maximised by the multiplicative steps of Zhou, Hu,
//! Zhou and Lange (2019, "MM algorithms for variance components models"), which keep every variance
//! positive: `σ² ← σ² √(Σ w |Qᵀ C⁻¹ r|² / Σ tr(Qᵀ C⁻¹ Q))`.

use nalgebra::{DMatrix, DVector};
use rayon::prelude::*;
use spherecal_model::input::MOST_TARGETS;

use super::error::IdentifyError;
use super::noise_scale::Squared;
use super::normal::Whitening;
use super::parts::Block;
use super::search::Search;
use super::seen::RowPart;

/// Most rows that the variances are estimated from, spread evenly: more hardly change them.
const ROWS: usize = 400;
/// Most steps, and the change of a standard deviation at which they end.
const STEPS: (usize, f64) = (25, 0.02);
/// Smallest standard deviations: of a joint (rad), of a target (m), of an orientation (rad).
const LEAST: [f64; 3] = [1e-7, 1e-6, 1e-6];

/// Numbers of the variances: joints, targets, body.
const JOINT: usize = 0;
const BODY: usize = 1 + MOST_TARGETS;
type Variances = [f64; 2 + MOST_TARGETS];

fn slot(part: RowPart) -> usize {
    match part {
        RowPart::Target(number) => 1 + number.min(MOST_TARGETS - 1),
        RowPart::Body => BODY,
    }
}

/// A row's joint columns (3K x joints), its residual, and its parts.
struct StackedRow {
    joints: DMatrix<f64>,
    residual: DVector<f64>,
    slots: Vec<usize>,
}

impl StackedRow {
    fn new(n: usize, blocks: &[Block]) -> Self {
        let rows = 3 * blocks.len();
        Self {
            joints: DMatrix::from_fn(rows, n, |r, c| blocks[r / 3].joints[c][r % 3]),
            residual: DVector::from_fn(rows, |r, _| blocks[r / 3].residual[r % 3]),
            slots: blocks.iter().map(|b| slot(b.part)).collect(),
        }
    }

    /// Adds `w |Qᵀ C⁻¹ r|²` and `tr(Qᵀ C⁻¹ Q)` of every variance.
    fn sums(&self, variances: &Variances, nu: f64) -> (Variances, Variances) {
        let (mut found, mut expected) = (Variances::default(), Variances::default());
        let mut covariance = &self.joints * self.joints.transpose() * variances[JOINT];
        for (k, &slot) in self.slots.iter().enumerate() {
            for axis in 0..3 {
                covariance[(3 * k + axis, 3 * k + axis)] += variances[slot];
            }
        }
        let Some(factor) = covariance.cholesky() else {
            return (found, expected);
        };
        let solved = factor.solve(&self.residual);
        let inverse = factor.inverse();
        let row = Squared {
            d2: self.residual.dot(&solved),
            numbers: self.residual.len() as f64,
        };
        let weight = if nu > 0.0 { row.weight(1.0, nu) } else { 1.0 };
        found[JOINT] = weight * self.joints.tr_mul(&solved).norm_squared();
        expected[JOINT] = (&inverse * &self.joints).dot(&self.joints);
        for (k, &slot) in self.slots.iter().enumerate() {
            found[slot] += weight * solved.rows(3 * k, 3).norm_squared();
            expected[slot] += (0..3).map(|axis| inverse[(3 * k + axis, 3 * k + axis)]).sum::<f64>();
        }
        (found, expected)
    }
}

impl Search<'_> {
    /// Whether a row has more than one part.
    pub(super) fn several(&self) -> bool {
        self.prepared.iter().any(|p| !p.further.is_empty())
    }

    /// Estimates the variances at the state, then scale and weights. Returns whether they may have changed.
    pub(super) fn choose_components(&mut self) -> Result<bool, IdentifyError> {
        if !self.options.noise.estimate {
            return Ok(false);
        }
        let step = self.prepared.len().div_ceil(ROWS).max(1);
        let n = self.layout.n;
        let rows = self.prepared.par_iter().step_by(step);
        let rows: Vec<StackedRow> = rows.map(|p| StackedRow::new(n, &self.state.blocks(n, p))).collect();
        let mut variances = variances_of(&self.whitening).map(|v| v * self.s2);
        for _ in 0..STEPS.0 {
            let (mut found, mut expected) = (Variances::default(), Variances::default());
            for row in &rows {
                let (own, trace) = row.sums(&variances, self.nu);
                for (k, (own, trace)) in own.into_iter().zip(trace).enumerate() {
                    found[k] += own;
                    expected[k] += trace;
                }
            }
            let mut moved: f64 = 0.0;
            for (k, variance) in variances.iter_mut().enumerate().filter(|(k, _)| expected[*k] > 0.0) {
                let least = match k {
                    JOINT => LEAST[0],
                    BODY => LEAST[2],
                    _ => LEAST[1],
                };
                let next = (*variance * (found[k] / expected[k]).sqrt()).max(least.powi(2));
                moved = moved.max((next / *variance).ln().abs());
                *variance = next;
            }
            if moved < 2.0 * STEPS.1 {
                break;
            }
        }
        self.whitening = Whitening {
            joint: variances[JOINT],
            seating: self.whitening.seating * self.s2,
            point: variances[1],
            further: std::array::from_fn(|k| variances[2 + k]),
            body: variances[BODY],
        };
        self.s2 = 1.0;
        self.reweight()?;
        Ok(true)
    }
}

fn variances_of(whitening: &Whitening) -> Variances {
    std::array::from_fn(|k| match k {
        JOINT => whitening.joint,
        BODY => whitening.body,
        k => whitening.own(RowPart::Target(k - 1)),
    })
}
