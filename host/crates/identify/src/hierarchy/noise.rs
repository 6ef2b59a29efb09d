//! The noise of a row: of the joints, of each instrument, and the tails of both.
//!
//! A row's covariance is `C = σ_q² J Jᵀ + diag(σ_k² I)`, with the joint noise that all its parts share and each part's own
//! noise. `C` turns with the posture, so the data separate the two. Each variance is updated by one step of the MM algorithm
//! of Zhou, Hu, Zhou and Lange (2019) on the restricted likelihood: with the residual `r`, weight `w` and the model's own
//! uncertainty `G = A P Aᵀ` at a row,
//!
//! `σ² ← σ² · Σ w |Qᵀ C⁻¹ r|² / Σ tr(Qᵀ (C⁻¹ − w C⁻¹ G C⁻¹) Q)`
//!
//! which the hyperprior of `ln σ` pulls. The degrees of freedom of Student's t maximise the likelihood of the whitened
//! residuals with their hyperprior.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;
use spherecal_model::input::MOST_TARGETS;

use super::constants::{INSTRUMENT_FACTOR, JOINT_NOISE, LEAST_NOISE, LEVERAGE_ROWS, TAILS, TAILS_RANGE};
use super::sizes::penalised;
use crate::chain::{Prepared, State};
use crate::normal::{Whitening, plain_columns};
use crate::parameters::Layout;
use crate::parts::Block;
use crate::seen::RowPart;
use crate::solve::Unknowns;

/// Numbers of the variances: joints, contacts, targets (across the line of sight), body, targets along it.
const JOINT: usize = 0;
const SEATING: usize = 1;
const BODY: usize = 2 + MOST_TARGETS;
const ALONG: usize = 3 + MOST_TARGETS;
const COUNT: usize = ALONG + MOST_TARGETS;
type Variances = [f64; COUNT];

fn slot(observation: &Prepared, part: RowPart) -> usize {
    match part {
        RowPart::Target(0) if observation.sphere.is_some() => SEATING,
        RowPart::Target(number) => 2 + number.min(MOST_TARGETS - 1),
        RowPart::Body => BODY,
    }
}

/// Noise of the rows.
#[derive(Clone, Debug)]
pub(crate) struct RowsNoise {
    pub(crate) whitening: Whitening,
    /// Degrees of freedom of Student's t; 0 for normal noise.
    pub(crate) nu: f64,
    /// Medians of the hyperpriors.
    ordinary: Variances,
    /// Whether the data estimate it.
    estimate: bool,
}

fn variances_of(w: &Whitening) -> Variances {
    let mut all = [0.0; COUNT];
    all[JOINT] = w.joint;
    all[SEATING] = w.seating;
    for number in 0..MOST_TARGETS {
        let own = w.own(RowPart::Target(number), Vector3::zeros());
        (all[2 + number], all[ALONG + number]) = (own.across, own.along);
    }
    all[BODY] = w.body;
    all
}

/// The variances of a part's three numbers.
struct PartAxes {
    /// Number of the variance across the line of sight.
    across: usize,
    /// Number of the variance along the line of sight, and that line. `None` if the noise is alike in all directions.
    along: Option<(usize, Vector3<f64>)>,
}

impl PartAxes {
    fn new(observation: &Prepared, block: &Block) -> Self {
        let across = slot(observation, block.part);
        let along = (block.sight != Vector3::zeros()).then(|| (across + ALONG - 2, block.sight));
        Self { across, along }
    }

    /// What each variance gets of `tr(Qᵀ M Q)`, for the part's own block `M` of a matrix.
    fn share(&self, m: &Matrix3<f64>, to: &mut Variances) {
        let along = self.along.map_or(0.0, |(slot, sight)| {
            let along = sight.dot(&(m * sight));
            to[slot] += along;
            along
        });
        to[self.across] += m.trace() - along;
    }
}

/// One row: its joint columns (3K x joints), its residual, and the variance of each part.
struct StackedRow {
    joints: DMatrix<f64>,
    residual: DVector<f64>,
    axes: Vec<PartAxes>,
    inverse: DMatrix<f64>,
    /// `C⁻¹ r`.
    solved: DVector<f64>,
    pub(crate) d2: f64,
}

impl StackedRow {
    fn new(n: usize, observation: &Prepared, blocks: &[Block], variances: &Variances) -> Option<Self> {
        let rows = 3 * blocks.len();
        let joints = DMatrix::from_fn(rows, n, |r, c| blocks[r / 3].joints[c][r % 3]);
        let residual = DVector::from_fn(rows, |r, _| blocks[r / 3].residual[r % 3]);
        let axes: Vec<PartAxes> = blocks.iter().map(|b| PartAxes::new(observation, b)).collect();
        let mut covariance = &joints * joints.transpose() * variances[JOINT];
        for (k, part) in axes.iter().enumerate() {
            let mut own = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            own += Matrix3::from_diagonal_element(variances[part.across]);
            if let Some((slot, sight)) = part.along {
                own += sight * sight.transpose() * (variances[slot] - variances[part.across]);
            }
        }
        let factor = covariance.cholesky()?;
        let solved = factor.solve(&residual);
        Some(Self {
            d2: residual.dot(&solved),
            inverse: factor.inverse(),
            joints,
            residual,
            axes,
            solved,
        })
    }

    fn numbers(&self) -> f64 {
        self.residual.len() as f64
    }

    /// `|Qᵀ C⁻¹ r|²` of every variance.
    fn found(&self) -> Variances {
        let mut found = [0.0; COUNT];
        found[JOINT] = self.joints.tr_mul(&self.solved).norm_squared();
        for (k, part) in self.axes.iter().enumerate() {
            let solved = self.solved.fixed_rows::<3>(3 * k);
            part.share(&(solved * solved.transpose()), &mut found);
        }
        found
    }

    /// `tr(Qᵀ M Q)` of every variance.
    fn traces(&self, m: &DMatrix<f64>) -> Variances {
        let mut traces = [0.0; COUNT];
        traces[JOINT] = (m * &self.joints).dot(&self.joints);
        for (k, part) in self.axes.iter().enumerate() {
            part.share(&m.fixed_view::<3, 3>(3 * k, 3 * k).into_owned(), &mut traces);
        }
        traces
    }
}

/// The model's own covariance at rows, `A P Aᵀ` (3K x 3K, m²) of each.
fn own_covariances(seen: &Seen<'_>, rows: &[&Prepared]) -> Vec<DMatrix<f64>> {
    let columns = &seen.unknowns.columns;
    let blocks: Vec<Vec<f64>> = rows
        .par_iter()
        .map(|observation| {
            // By row of the Jacobian.
            let mut block = Vec::with_capacity(3 * (1 + observation.further.len()) * columns.len());
            plain_columns(seen.state, seen.layout, observation, |_, all| {
                for axis in 0..3 {
                    block.extend(columns.iter().map(|column| all[*column][axis]));
                }
            });
            block
        })
        .collect();
    let m = columns.len().max(1);
    let counts: Vec<usize> = blocks.iter().map(|block| block.len() / m).collect();
    let turned = DMatrix::from_vec(m, counts.iter().sum(), blocks.concat());
    // One product for all rows: small ones are slow.
    let product = seen.covariance * &turned;
    let mut at = 0;
    let of = |count: &usize| {
        let (a, b) = (turned.columns(at, *count), product.columns(at, *count));
        at += count;
        a.tr_mul(&b)
    };
    counts.iter().map(of).collect()
}

/// What an update needs of the search.
pub(crate) struct Seen<'a> {
    pub(crate) state: &'a State,
    pub(crate) layout: &'a Layout,
    pub(crate) unknowns: &'a Unknowns,
    pub(crate) prepared: &'a [Prepared],
    pub(crate) covariance: &'a DMatrix<f64>,
    /// What each row counts.
    pub(crate) shares: &'a [f64],
}

impl RowsNoise {
    pub(crate) fn new(whitening: Whitening, nu: f64, estimate: bool) -> Self {
        let mut ordinary = variances_of(&whitening);
        ordinary[JOINT] = JOINT_NOISE.0.powi(2);
        Self {
            whitening,
            nu,
            ordinary,
            estimate,
        }
    }

    /// Weight of a row with this squared whitened residual.
    pub(crate) fn weight(&self, d2: f64, numbers: f64) -> f64 {
        if self.nu > 0.0 {
            (self.nu + numbers) / (self.nu + d2)
        } else {
            1.0
        }
    }

    /// Updates variances and tails at the state. Returns the largest change of a logarithm.
    pub(crate) fn update(&mut self, seen: &Seen<'_>) -> f64 {
        if !self.estimate {
            return 0.0;
        }
        let variances = variances_of(&self.whitening);
        let n = seen.layout.n;
        let stacked = |p: &Prepared| StackedRow::new(n, p, &seen.state.blocks(n, p), &variances);
        let rows: Vec<Option<StackedRow>> = seen.prepared.par_iter().map(stacked).collect();
        let (mut found, mut all, mut some, mut taken) = ([0.0; COUNT], [0.0; COUNT], [0.0; COUNT], [0.0; COUNT]);
        let mut count = [0.0; COUNT];
        for row in rows.iter().flatten() {
            let weight = self.weight(row.d2, row.numbers());
            let traces = row.traces(&row.inverse);
            for (k, value) in row.found().into_iter().enumerate() {
                found[k] += weight * value;
                all[k] += traces[k];
            }
            count[JOINT] += row.numbers();
            for part in &row.axes {
                part.share(&Matrix3::identity(), &mut count);
            }
        }
        let every = seen.prepared.len().div_ceil(LEVERAGE_ROWS).max(1);
        let chosen: Vec<(&Prepared, &StackedRow, f64)> = seen
            .prepared
            .iter()
            .zip(&rows)
            .zip(seen.shares)
            .step_by(every)
            .filter_map(|((p, row), share)| Some((p, row.as_ref()?, *share)))
            .collect();
        let rows_of: Vec<&Prepared> = chosen.iter().map(|(p, ..)| *p).collect();
        let own = own_covariances(seen, &rows_of);
        let shares: Vec<(Variances, Variances, f64)> = chosen
            .iter()
            .zip(own)
            .map(|((_, row, share), own)| {
                let weight = share * self.weight(row.d2, row.numbers());
                let leverage = row.inverse.dot(&own) * weight / row.numbers();
                let held = &row.inverse * own * &row.inverse * weight;
                (row.traces(&row.inverse), row.traces(&held), leverage.min(1.0))
            })
            .collect();
        for (whole, held, _) in &shares {
            for k in 0..COUNT {
                some[k] += whole[k];
                taken[k] += held[k];
            }
        }
        let mut moved: f64 = 0.0;
        let mut next = variances;
        for k in 0..COUNT {
            if !(all[k] > 0.0 && some[k] > 0.0) {
                continue;
            }
            // Degrees of freedom that the model leaves to this variance.
            let free = (1.0 - taken[k] / some[k]).max(1e-3);
            let expected = all[k] * free;
            let ratio = (found[k] / expected).clamp(0.1, 10.0);
            // As a sum of squares of `count` numbers, which the hyperprior pulls.
            let numbers = count[k] * free * (variances[k] * all[k] / count[k]).clamp(1e-6, 1.0);
            let (middle, factor) = (
                0.5 * self.ordinary[k].ln(),
                if k == JOINT { JOINT_NOISE.1 } else { INSTRUMENT_FACTOR },
            );
            let target = variances[k] * ratio;
            let l = penalised(numbers * target, numbers, middle, factor.ln(), 0.5 * target.ln());
            let least = if k == JOINT { LEAST_NOISE.0 } else { LEAST_NOISE.1 };
            let value = (2.0 * l).exp().max(least * least);
            moved = moved.max((0.5 * (value / variances[k]).ln()).abs());
            next[k] = value;
        }
        self.whitening = Whitening {
            joint: next[JOINT],
            seating: next[SEATING],
            point: next[2],
            further: std::array::from_fn(|k| next[3 + k]),
            along: std::array::from_fn(|k| next[ALONG + k]),
            body: next[BODY],
        };
        if self.nu > 0.0 {
            // The model takes a part of each row's residual: a row that it follows tells nothing of the tails.
            let free = |k: usize| {
                1.0 - shares
                    .get(k / every)
                    .or(shares.last())
                    .map_or(0.0, |(.., leverage)| *leverage)
            };
            let squares = rows
                .iter()
                .flatten()
                .enumerate()
                .map(|(k, row)| (row.d2, row.numbers() * free(k)));
            let nu = tails(&squares.collect::<Vec<_>>());
            moved = moved.max(0.2 * (nu / self.nu).ln().abs());
            self.nu = nu;
        }
        moved
    }
}

/// Degrees of freedom of Student's t that whitened residuals (squared length, numbers that the model leaves free) and
/// hyperprior prefer.
fn tails(rows: &[(f64, f64)]) -> f64 {
    let density = |nu: f64| {
        let row = |&(d2, p): &(f64, f64)| {
            libm::lgamma(0.5 * (nu + p))
                - libm::lgamma(0.5 * nu)
                - 0.5 * p * nu.ln()
                - 0.5 * (nu + p) * (d2 / nu).ln_1p()
        };
        rows.iter().map(row).sum::<f64>() - 0.5 * ((nu / TAILS.0).ln() / TAILS.1.ln()).powi(2)
    };
    // Golden section over the logarithm: the likelihood has one maximum.
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut low, mut high) = (TAILS_RANGE.0.ln(), TAILS_RANGE.1.ln());
    for _ in 0..30 {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if density(a.exp()) > density(b.exp()) {
            high = b;
        } else {
            low = a;
        }
    }
    (0.5 * (low + high)).exp()
}

#[cfg(test)]
mod tests {
    use super::tails;

    // Fails if normal residuals are given heavy tails, or heavy ones light tails, or if rows that the model follows count
    // as evidence of tails.
    #[test]
    fn tails_follow_the_residuals() {
        let normal: Vec<(f64, f64)> = (0..400).map(|k| (3.0 + 2.0 * f64::from(k % 3 - 1), 3.0)).collect();
        assert!(tails(&normal) > 20.0);
        let heavy: Vec<(f64, f64)> = (0..400).map(|k| (if k % 10 == 0 { 60.0 } else { 1.5 }, 3.0)).collect();
        assert!(tails(&heavy) < 5.0);
        let followed = |share: f64| -> Vec<(f64, f64)> {
            (0..20)
                .map(|k| if k % 2 == 0 { (0.3, share) } else { (5.0, 5.0) })
                .collect()
        };
        assert!(tails(&followed(0.3)) > 1.5 * tails(&followed(5.0)));
    }
}
