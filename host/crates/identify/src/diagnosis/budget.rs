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
//! tell their common size. The squares of all parts add up to the square of the whole.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use serde::Serialize;

use super::causes::Cause;
use super::dense::{Factor, transposed_product};
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

/// Which sources the data have, and how the noise of the rows is shared.
pub(crate) struct Sources {
    /// Columns of the certified coordinates.
    plate: Vec<usize>,
    /// `Wᵀ E W`, with `E` the part of the whitened noise that comes from the joints.
    joints: DMatrix<f64>,
    /// Rows on spheres and measured points.
    contacts: usize,
    points: usize,
}

impl Sources {
    /// `plate` are the columns of the certified coordinates.
    pub(crate) fn new(linear: &Linear, discrepancy: &Discrepancy, plate: Vec<usize>) -> Self {
        let w = &discrepancy.w;
        let mut shared = DMatrix::zeros(w.nrows(), w.ncols());
        for (k, row) in linear.rows.iter().enumerate() {
            // The whitener carries the root of the robust weight.
            let scale = linear.joint_variance / row.weight.max(1e-12);
            let mut share = Matrix3::zeros();
            for joint in &row.posture.joints {
                let v = row.root.times(joint);
                share += v * v.transpose() * scale;
            }
            shared.rows_mut(3 * k, 3).copy_from(&(share * w.rows(3 * k, 3)));
        }
        let contacts = linear.rows.iter().filter(|row| row.sphere.is_some()).count();
        Self {
            plate,
            joints: transposed_product(w, &shared),
            contacts,
            points: linear.rows.len() - contacts,
        }
    }
}

/// Mean squares of the TCP's displacement over the workspace by source, in m², summed over
/// sets of sizes, and what each set says that the estimate is off.
#[derive(Clone, Debug, Default)]
pub(crate) struct Parts {
    sets: f64,
    plate: f64,
    seating: f64,
    row_joints: f64,
    row_rest: f64,
    use_joints: f64,
    open: f64,
    discrepancy: f64,
    /// Displacement of the estimate from the mean of the extended model, by set, in m.
    biases: Vec<DVector<f64>>,
    plate_known: bool,
    contacts: usize,
    points: usize,
}

/// One set of sizes.
pub(crate) struct SizeSet<'a> {
    /// Sigma of each column.
    pub(crate) sigmas: &'a DVector<f64>,
    /// Amplitude of each component.
    pub(crate) amplitudes: &'a [f64],
    /// Variance of the noise.
    pub(crate) s2: f64,
    /// Factor of `A`.
    pub(crate) factor: &'a Factor,
    /// Mean square of the TCP's displacement by the joints' noise of one pose, in m².
    pub(crate) use_joints: f64,
    /// Mean of the extended model minus the estimate, over the workspace, in m.
    pub(crate) bias: DVector<f64>,
}

impl Parts {
    /// Adds a set. `g` has the columns of the workspace (3 configurations x all) and `rest`
    /// those of wide causes that the data do not tell, all aligned.
    pub(crate) fn add(
        &mut self,
        sources: &Sources,
        discrepancy: &Discrepancy,
        g: &DMatrix<f64>,
        rest: &[DMatrix<f64>],
        set: SizeSet<'_>,
    ) {
        let count = (g.nrows() / 3).max(1) as f64;
        let d = set.sigmas;
        let mut scaled = g.transpose();
        for (mut row, d) in scaled.row_iter_mut().zip(d.iter()) {
            row.scale_mut(*d);
        }
        let half = set.factor.half(&scaled);
        let all = half.norm_squared() / count;
        let mut own = half;
        set.factor.back_mut(&mut own);
        // What the prior of each column adds.
        let prior: Vec<f64> = own.row_iter().map(|row| row.norm_squared() / count).collect();
        let noise = (all - prior.iter().sum::<f64>()).max(0.0);
        for (mut row, d) in own.row_iter_mut().zip(d.iter()) {
            row.scale_mut(*d);
        }
        let joints = (&sources.joints * &own).dot(&own) / set.s2 / count;
        self.row_joints += joints.clamp(0.0, noise);
        self.row_rest += (noise - joints).max(0.0);
        self.use_joints += set.use_joints;
        for (column, value) in prior.iter().enumerate() {
            if sources.plate.contains(&column) {
                self.plate += value;
            } else if column < discrepancy.m {
                self.open += value;
            } else if discrepancy.is_seat(column) {
                self.seating += value;
            } else {
                self.discrepancy += value;
            }
        }
        for ((component, block), amplitude) in discrepancy.components.iter().zip(rest).zip(set.amplitudes) {
            let value = amplitude * amplitude * block.norm_squared() / count;
            if matches!(component.shape.cause, Cause::Seat) {
                self.seating += value;
            } else {
                self.discrepancy += value;
            }
        }
        self.biases.push(set.bias);
        self.sets += 1.0;
        self.plate_known = !sources.plate.is_empty();
        self.contacts = sources.contacts;
        self.points = sources.points;
    }

    /// The budget of a model whose TCP is `shift` (m, aligned) from the estimate's. The
    /// distance of the model from what the data say counts as discrepancy.
    pub(crate) fn budget(&self, shift: &DMatrix<f64>) -> ErrorBudget {
        let sets = self.sets.max(1.0);
        let count = (shift.nrows() / 3).max(1) as f64;
        let off = |bias: &DVector<f64>| (bias - shift.column(0)).norm_squared() / count;
        let bias: f64 = self.biases.iter().map(off).sum();
        let mut squares = Vec::with_capacity(6);
        if self.plate_known {
            squares.push((Source::Plate, self.plate));
        }
        // Rows of both kinds do not tell their scatter apart: it stands with the more frequent.
        let (at_contact, at_point) = if self.contacts >= self.points {
            (self.row_rest, 0.0)
        } else {
            (0.0, self.row_rest)
        };
        if self.contacts > 0 {
            squares.push((Source::Seating, self.seating + at_contact));
        }
        if self.points > 0 {
            squares.push((Source::Instrument, at_point));
        }
        squares.push((Source::EncoderNoise, self.row_joints + self.use_joints));
        squares.push((Source::OpenParameters, self.open));
        squares.push((Source::ModelDiscrepancy, self.discrepancy + bias));
        let millimetres = |square: f64| (square / sets).max(0.0).sqrt() * 1e3;
        ErrorBudget {
            total_mm: millimetres(squares.iter().map(|s| s.1).sum()),
            terms: squares
                .iter()
                .map(|&(source, square)| BudgetTerm {
                    source,
                    rms_mm: millimetres(square),
                })
                .collect(),
        }
    }
}

/// Mean square of the TCP's displacement by white errors of the joints with `variance`
/// (rad²), over configurations with these joint columns, in m².
pub(crate) fn by_joints<'a>(columns: impl Iterator<Item = &'a Vec<Vector3<f64>>>, variance: f64) -> f64 {
    let (mut sum, mut count) = (0.0, 0.0_f64);
    for joints in columns {
        sum += joints.iter().map(Vector3::norm_squared).sum::<f64>();
        count += 1.0;
    }
    sum / count.max(1.0) * variance
}

#[cfg(test)]
#[path = "budget_tests.rs"]
mod tests;
