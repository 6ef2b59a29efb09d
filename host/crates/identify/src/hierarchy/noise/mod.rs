//! The noise of a row: of the joints, of each instrument, and the tails of both.
//!
//! A row's covariance is `C = σ_q² J Jᵀ + diag(σ_k² I)`, with the joint noise that all its parts share and each part's own noise.
//! Several targets also share shifts and turns of the tool that no joint makes: between them the instrument has hardly any noise, and
//! where the arm is singular, what no joint makes would rule the fit. `C` turns with the posture, so the data separate the noises. Each
//! variance is updated by one step of the MM algorithm of Zhou, Hu, Zhou and Lange (2019) on the restricted likelihood: with the
//! residual `r`, weight `w` and the model's own uncertainty `G = A P Aᵀ` at a row,
//!
//! `σ² ← σ² · Σ w |Qᵀ C⁻¹ r|² / Σ tr(Qᵀ (C⁻¹ − w C⁻¹ G C⁻¹) Q)`
//!
//! which the hyperprior of `ln σ` pulls. The degrees of freedom of Student's t maximise the likelihood of the whitened
//! residuals with their hyperprior.

mod row;

use nalgebra::{DMatrix, Matrix3, Vector3};
use rayon::prelude::*;
use spherecal_model::input::MOST_TARGETS;

use self::row::{Row, Solved};
use super::constants::{INSTRUMENT_FACTOR, JOINT_NOISE, LEAST_NOISE, LEVERAGE_ROWS, SETTLED};
use super::sizes::penalised;
use super::tails::tails;
use crate::chain::{Prepared, State};
use crate::normal::{Whitening, plain_columns};
use crate::parameters::Layout;
use crate::seen::RowPart;
use crate::solve::{Posterior, Unknowns};

/// Numbers of the variances: joints, contacts, targets (across the line of sight), body, targets along it, shifts and turns of the
/// tool.
const JOINT: usize = 0;
const SEATING: usize = 1;
const BODY: usize = 2 + MOST_TARGETS;
const ALONG: usize = 3 + MOST_TARGETS;
const SHIFT: usize = ALONG + MOST_TARGETS;
const TURN: usize = SHIFT + 1;
const COUNT: usize = TURN + 1;
type Variances = [f64; COUNT];

/// Most steps of the variances in one update.
const STEPS: usize = 20;

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
    [all[SHIFT], all[TURN]] = w.tool;
    all
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
    // One substitution for all rows: small ones are slow.
    let mut half = DMatrix::from_vec(m, counts.iter().sum(), blocks.concat());
    seen.posterior.half_mut(&mut half);
    let mut at = 0;
    let of = |count: &usize| {
        let own = half.columns(at, *count);
        at += count;
        own.tr_mul(&own)
    };
    counts.iter().map(of).collect()
}

/// What an update needs of the search.
pub(crate) struct Seen<'a> {
    pub(crate) state: &'a State,
    pub(crate) layout: &'a Layout,
    pub(crate) unknowns: &'a Unknowns,
    pub(crate) prepared: &'a [Prepared],
    pub(crate) posterior: &'a Posterior,
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

    /// Begins at another noise of the same instruments, where the data estimate it.
    pub(super) fn begin_at(&mut self, other: &Self) {
        if self.estimate {
            (self.whitening, self.nu) = (other.whitening, other.nu);
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
        let n = seen.layout.n;
        let row = |p| Row::new(n, p, &seen.state.blocks(n, p));
        let all: Vec<Row> = seen.prepared.par_iter().map(row).collect();
        let solved = |variances: &Variances| -> Vec<Option<Solved<'_>>> {
            all.par_iter().map(|row| row.solved(variances)).collect()
        };
        let before = variances_of(&self.whitening);
        let mut rows = solved(&before);
        let leverage = Leverage::new(self, seen, &rows);
        // Joints and instruments are hardly told apart where all postures are alike: one step then goes a small part of the way.
        let mut variances = before;
        for _ in 0..STEPS {
            let next = self.step(&rows, &variances, &leverage.free);
            let moved = largest_change(&next, &variances);
            variances = next;
            if moved < 0.1 * SETTLED {
                break;
            }
            rows = solved(&variances);
        }
        self.whitening = Whitening {
            joint: variances[JOINT],
            seating: variances[SEATING],
            point: variances[2],
            further: std::array::from_fn(|k| variances[3 + k]),
            along: std::array::from_fn(|k| variances[ALONG + k]),
            body: variances[BODY],
            tool: [variances[SHIFT], variances[TURN]],
        };
        let mut moved = largest_change(&variances, &before);
        if self.nu > 0.0 {
            // The model takes a part of each row's residual: a row that it follows tells nothing of the tails.
            let squares = rows
                .iter()
                .flatten()
                .enumerate()
                .map(|(k, solved)| (solved.d2, solved.row.numbers() * (1.0 - leverage.of(k))));
            let nu = tails(&squares.collect::<Vec<_>>());
            moved = moved.max(0.2 * (nu / self.nu).ln().abs());
            self.nu = nu;
        }
        moved
    }

    /// One step of all variances; `free` is the share of each variance's numbers that the model leaves to it.
    fn step(&self, rows: &[Option<Solved<'_>>], variances: &Variances, free: &Variances) -> Variances {
        let (mut found, mut all, mut count) = ([0.0; COUNT], [0.0; COUNT], [0.0; COUNT]);
        for solved in rows.iter().flatten() {
            let numbers = solved.row.numbers();
            let weight = self.weight(solved.d2, numbers);
            let traces = solved.traces(&solved.inverse);
            for (k, value) in solved.found().into_iter().enumerate() {
                found[k] += weight * value;
                all[k] += traces[k];
            }
            for slot in [JOINT, SHIFT, TURN] {
                count[slot] += numbers;
            }
            for part in &solved.row.axes {
                part.share(&Matrix3::identity(), &mut count);
            }
        }
        let mut next = *variances;
        for k in 0..COUNT {
            if !(all[k] > 0.0 && free[k] > 0.0) {
                continue;
            }
            let ratio = (found[k] / (all[k] * free[k])).clamp(0.1, 10.0);
            // As a sum of squares of `count` numbers, which the hyperprior pulls.
            let numbers = count[k] * free[k] * (variances[k] * all[k] / count[k]).clamp(1e-6, 1.0);
            let (middle, factor) = (
                0.5 * self.ordinary[k].ln(),
                if k == JOINT { JOINT_NOISE.1 } else { INSTRUMENT_FACTOR },
            );
            let target = variances[k] * ratio;
            let l = penalised(numbers * target, numbers, middle, factor.ln(), 0.5 * target.ln());
            let least = if k == JOINT { LEAST_NOISE.0 } else { LEAST_NOISE.1 };
            next[k] = (2.0 * l).exp().max(least * least);
        }
        next
    }
}

/// Largest change of the logarithm of a standard deviation.
fn largest_change(now: &Variances, before: &Variances) -> f64 {
    let pairs = now.iter().zip(before).filter(|(_, before)| **before > 0.0);
    pairs
        .map(|(now, before)| (0.5 * (now / before).ln()).abs())
        .fold(0.0, f64::max)
}

/// What the model takes of the rows, from some of them, spread evenly.
struct Leverage {
    /// Share of each variance's numbers that the model leaves to it; 0 where no row has it.
    free: Variances,
    /// Share of its numbers that the model takes of each chosen row.
    rows: Vec<f64>,
    /// Rows that one chosen row stands for.
    every: usize,
}

impl Leverage {
    fn new(noise: &RowsNoise, seen: &Seen<'_>, rows: &[Option<Solved<'_>>]) -> Self {
        let every = seen.prepared.len().div_ceil(LEVERAGE_ROWS).max(1);
        let chosen: Vec<(&Prepared, &Solved<'_>, f64)> = seen
            .prepared
            .iter()
            .zip(rows)
            .zip(seen.shares)
            .step_by(every)
            .filter_map(|((p, row), share)| Some((p, row.as_ref()?, *share)))
            .collect();
        let rows_of: Vec<&Prepared> = chosen.iter().map(|(p, ..)| *p).collect();
        let (mut some, mut taken) = ([0.0; COUNT], [0.0; COUNT]);
        let mut of_rows = Vec::with_capacity(chosen.len());
        for ((_, solved, share), own) in chosen.iter().zip(own_covariances(seen, &rows_of)) {
            let (numbers, inverse) = (solved.row.numbers(), &solved.inverse);
            let weight = share * noise.weight(solved.d2, numbers);
            of_rows.push((inverse.dot(&own) * weight / numbers).min(1.0));
            let held = inverse * own * inverse * weight;
            let (whole, held) = (solved.traces(inverse), solved.traces(&held));
            for k in 0..COUNT {
                some[k] += whole[k];
                taken[k] += held[k];
            }
        }
        let free = |k: usize| {
            if some[k] > 0.0 {
                (1.0 - taken[k] / some[k]).max(1e-3)
            } else {
                0.0
            }
        };
        Self {
            free: std::array::from_fn(free),
            rows: of_rows,
            every,
        }
    }

    /// Of row `k`.
    fn of(&self, k: usize) -> f64 {
        let row = self.rows.get(k / self.every).or(self.rows.last());
        row.copied().unwrap_or(0.0)
    }
}
