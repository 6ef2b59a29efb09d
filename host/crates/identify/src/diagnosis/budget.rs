//! Where the expected error comes from: its budget by source.
//!
//! At fixed sizes of everything that is unknown, the extended model is linear, and
//! the error of its estimate is a sum of independent parts
//! ([`discrepancy`](super::discrepancy) has `y = W u + e`, `u ~ N(0, D²)`):
//!
//! ```text
//! û - u = K e - (I - K W) u        with K = P Wᵀ / s²,  P = D A⁻¹ D,  A = I + D N D / s²
//! cov   = P N P / s²  +  Σ over columns c of (D A⁻¹)_c (D A⁻¹)_cᵀ  =  P
//! ```
//!
//! So each column is charged with what its own prior adds to the error, and the noise of
//! the rows with the rest. The noise of a row is itself a sum: white errors of the joint
//! angles, turned into TCP displacements, and the scatter of the seat (or of the measured
//! point). Both parts are known in the proportion that the options give them; the data
//! tell their common size. The squares of all parts add up to the square of the whole. Where heavy
//! tails of the residuals make the whole larger ([`expected`](super::expected)), the difference is discrepancy.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use super::causes::Cause;
use super::dense::transposed_product;
use super::discrepancy::Discrepancy;
use super::linear::Linear;

/// A source of the expected error.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
pub enum Source {
    /// The certified coordinates of the spheres, by their stated uncertainty.
    Plate,
    /// Where the nest sits: scatter of each contact, and of each coupling as a whole.
    Seating,
    /// The instrument that measured points.
    Instrument,
    /// White errors of the joint angles: those of the recordings, and those of one pose in use.
    EncoderNoise,
    /// Parameters of the robot that the data leave open, by their priors.
    OpenParameters,
    /// What the model leaves out.
    ModelDiscrepancy,
}

/// What a source contributes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BudgetTerm {
    /// The source.
    pub source: Source,
    /// Root mean square of the TCP's displacement over the workspace by it alone, in mm.
    pub rms_mm: f64,
}

/// The expected error by source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorBudget {
    /// Root mean square of the TCP's error over the workspace, the base aligned, in mm: the
    /// standard uncertainty of a position.
    pub total_mm: f64,
    /// The sources that these data have. Their squares add up to that of the total.
    pub terms: Vec<BudgetTerm>,
}

/// Sets of sizes that the budget is averaged over: every second of those drawn.
const EVERY: usize = 2;

/// One set of sizes.
#[derive(Clone, Debug)]
pub(crate) struct SizeSet {
    /// Sigma of each column.
    pub(crate) sigmas: DVector<f64>,
    /// Amplitude of each component.
    pub(crate) amplitudes: Vec<f64>,
    /// Variance of the noise.
    pub(crate) s2: f64,
    /// Variance of one joint's white error in use, in rad².
    pub(crate) joint_variance: f64,
    /// Mean of all columns.
    pub(crate) mean: DVector<f64>,
}

/// What the budget is made from. It is made when somebody asks: it takes longer than the
/// expected error itself.
#[derive(Debug)]
pub(crate) struct Accounts {
    pub(crate) discrepancy: Discrepancy,
    /// Columns of the certified coordinates.
    pub(crate) plate: Vec<usize>,
    /// Of the whitened noise of each row, the part that comes from the joints.
    pub(crate) joint_shares: Vec<Matrix3<f64>>,
    /// Rows on spheres; the others are measured points.
    pub(crate) contacts: usize,
    /// Columns over the workspace, aligned: 3 configurations x all.
    pub(crate) g: DMatrix<f64>,
    /// Columns of wide causes that the data do not tell, aligned, by component.
    pub(crate) rest: Vec<DMatrix<f64>>,
    /// Displacement by the estimate over the workspace, aligned, in m.
    pub(crate) estimate: DVector<f64>,
    /// Mean over the workspace of the squared displacements by each joint, summed, in m²/rad².
    pub(crate) joints: f64,
    /// Sets of sizes.
    pub(crate) sets: Vec<SizeSet>,
    /// By how much the whole error is larger than these parts say. What it adds counts as discrepancy.
    pub(crate) factor: f64,
}

/// Mean squares of the TCP's displacement over the workspace by source, in m².
#[derive(Clone, Copy, Debug, Default)]
struct Squares {
    plate: f64,
    seating: f64,
    /// Noise of the rows that does not come from the joints.
    rest: f64,
    joints: f64,
    open: f64,
    discrepancy: f64,
}

impl Squares {
    fn sum(self) -> f64 {
        self.plate + self.seating + self.rest + self.joints + self.open + self.discrepancy
    }

    fn plus(self, other: Self) -> Self {
        Self {
            plate: self.plate + other.plate,
            seating: self.seating + other.seating,
            rest: self.rest + other.rest,
            joints: self.joints + other.joints,
            open: self.open + other.open,
            discrepancy: self.discrepancy + other.discrepancy,
        }
    }
}

/// Of the whitened noise of each row, the part that comes from the joints.
pub(crate) fn joint_shares(linear: &Linear) -> Vec<Matrix3<f64>> {
    let joints = linear.rows.first().map_or(0, |row| row.posture.joints.len());
    let mut shares = vec![Matrix3::zeros(); linear.rows.len()];
    for joint in 0..joints {
        let column = linear.column(|row| row.posture.joints[joint]);
        for ((k, share), row) in shares.iter_mut().enumerate().zip(&linear.rows) {
            // The whitener carries the root of the robust weight.
            let scale = linear.joint_variance / row.weight.max(1e-12);
            let v: Vector3<f64> = column.fixed_rows::<3>(3 * k).into();
            *share += v * v.transpose() * scale;
        }
    }
    shares
}

/// Mean over configurations with these joint columns of the squared displacements, summed.
pub(crate) fn squared_columns<'a>(columns: impl Iterator<Item = &'a Vec<Vector3<f64>>>) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for joints in columns {
        sum += joints.iter().map(Vector3::norm_squared).sum::<f64>();
        count += 1.0;
    }
    sum / count.max(1.0)
}

impl Accounts {
    /// The budget of a model whose TCP is `shift` (m, aligned) from the estimate's. The
    /// distance of the model from what the data say counts as discrepancy.
    pub(crate) fn budget(&self, shift: &DMatrix<f64>) -> Option<ErrorBudget> {
        let w = &self.discrepancy.w;
        let mut shared = DMatrix::zeros(w.nrows(), w.ncols());
        for (k, share) in self.joint_shares.iter().enumerate() {
            shared.rows_mut(3 * k, 3).copy_from(&(share * w.rows(3 * k, 3)));
        }
        let joints = transposed_product(w, &shared);
        let sets: Vec<&SizeSet> = self.sets.iter().step_by(EVERY).collect();
        let found: Vec<Option<Squares>> = sets.par_iter().map(|set| self.squares(&joints, set, shift)).collect();
        let sum = found
            .into_iter()
            .try_fold(Squares::default(), |sum, of| Some(sum.plus(of?)))?;
        Some(self.stated(sum, sets.len().max(1) as f64))
    }

    /// The squares of one set; `joints` is the part of `N` whose noise comes from the joints.
    fn squares(&self, joints: &DMatrix<f64>, set: &SizeSet, shift: &DMatrix<f64>) -> Option<Squares> {
        let count = (self.g.nrows() / 3).max(1) as f64;
        let d = &set.sigmas;
        let factor = self.discrepancy.factor(d, set.s2, 0, d.len()).ok()?;
        let mut half = self.g.transpose();
        let scale = |columns: &mut DMatrix<f64>| {
            for (mut row, d) in columns.row_iter_mut().zip(d.iter()) {
                row.scale_mut(*d);
            }
        };
        scale(&mut half);
        factor.half_mut(&mut half);
        let all = half.norm_squared() / count;
        let mut own = half;
        factor.back_mut(&mut own);
        // What the prior of each column adds.
        let prior: Vec<f64> = own.row_iter().map(|row| row.norm_squared() / count).collect();
        let noise = (all - prior.iter().sum::<f64>()).max(0.0);
        scale(&mut own);
        let by_joints = ((joints * &own).dot(&own) / set.s2 / count).clamp(0.0, noise);
        let bias = (&self.g * &set.mean - &self.estimate) * self.factor;
        let mut squares = Squares {
            rest: noise - by_joints,
            joints: by_joints + self.joints * set.joint_variance,
            ..Squares::default()
        };
        for (column, value) in prior.iter().enumerate() {
            *if self.plate.contains(&column) {
                &mut squares.plate
            } else if column < self.discrepancy.m {
                &mut squares.open
            } else if self.discrepancy.is_seat(column) {
                &mut squares.seating
            } else {
                &mut squares.discrepancy
            } += value;
        }
        let components = self.discrepancy.components.iter().zip(&self.rest);
        for ((component, block), amplitude) in components.zip(&set.amplitudes) {
            let value = amplitude * amplitude * block.norm_squared() / count;
            *if matches!(component.shape.cause, Cause::Seat | Cause::Nest) {
                &mut squares.seating
            } else {
                &mut squares.discrepancy
            } += value;
        }
        squares.discrepancy += squares.sum() * (self.factor * self.factor - 1.0);
        squares.discrepancy += (bias - shift.column(0)).norm_squared() / count;
        Some(squares)
    }

    /// The sources that the data have, from the `sum` over so many sets.
    fn stated(&self, sum: Squares, sets: f64) -> ErrorBudget {
        let points = self.joint_shares.len() - self.contacts.min(self.joint_shares.len());
        // Rows of both kinds do not tell their scatter apart: it stands with the more frequent.
        let (at_contact, at_point) = if self.contacts >= points {
            (sum.rest, 0.0)
        } else {
            (0.0, sum.rest)
        };
        let squares = [
            (!self.plate.is_empty(), Source::Plate, sum.plate),
            (self.contacts > 0, Source::Seating, sum.seating + at_contact),
            (points > 0, Source::Instrument, at_point),
            (true, Source::EncoderNoise, sum.joints),
            (true, Source::OpenParameters, sum.open),
            (true, Source::ModelDiscrepancy, sum.discrepancy),
        ];
        let millimetres = |square: f64| (square / sets).max(0.0).sqrt() * 1e3;
        let there = squares.iter().filter(|s| s.0);
        ErrorBudget {
            total_mm: millimetres(there.clone().map(|s| s.2).sum()),
            terms: there
                .map(|&(_, source, square)| BudgetTerm {
                    source,
                    rms_mm: millimetres(square),
                })
                .collect(),
        }
    }
}

#[cfg(test)]
#[path = "budget_tests.rs"]
mod tests;
