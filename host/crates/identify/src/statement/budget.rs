//! The expected error by source.
//!
//! The covariance of the estimate is a sum: what each column's own prior leaves open, `P_c λ_c P_cᵀ`, and the noise of the
//! rows with the rest, which joints and instrument share as they share the rows' noise. The squares of all parts add up.

use nalgebra::Vector3;
use serde::Serialize;

use super::Statement;

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
    /// Errors of the joint angles that depend on other joints' angles, which the model leaves out.
    OtherJoints,
    /// Parameters of the robot that the data leave open, by their priors.
    OpenParameters,
    /// What the model leaves out: the distance of a file's geometry from the full model.
    ModelDiscrepancy,
}

/// What a source contributes.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct BudgetTerm {
    /// The source.
    pub source: Source,
    /// Root mean square of the TCP's displacement over the work region by it alone, in mm.
    pub rms_mm: f64,
}

/// The expected error by source.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ErrorBudget {
    /// Root mean square of the TCP's error over the work region, in mm: the standard uncertainty of a position.
    pub total_mm: f64,
    /// The sources that these data have. Their squares add up to that of the total.
    pub terms: Vec<BudgetTerm>,
}

impl Statement {
    /// The error of a model over the work region by source, as a root mean square.
    pub fn budget_of(&self, tcp_m: impl Fn(&[f64]) -> Vector3<f64> + Sync) -> ErrorBudget {
        let count = self.work.q.len().max(1) as f64;
        let share = &self.work.columns * &self.covariance;
        let whole = share.component_mul(&self.work.columns).sum() / count;
        let (mut plate, mut seating, mut open) = (0.0, 0.0, 0.0);
        for (c, name) in self.kinds.iter().enumerate() {
            let own = share.column(c).norm_squared() * self.precision[c] / count;
            *if name.starts_with("sphere") {
                &mut plate
            } else if name.starts_with("seat") {
                &mut seating
            } else {
                &mut open
            } += own;
        }
        let noise = (whole - plate - seating - open).max(0.0);
        let joints = noise * self.joint_share + self.work.joint_square;
        let rest = noise * (1.0 - self.joint_share);
        let discrepancy = self.off(&self.work, &tcp_m).norm_squared() / count;
        // The draws hold what the sum does not: the tails, the rows' own part in the fit, and errors outside of the model.
        let drawn = self.work.draws.norm_squared() / (count * self.work.draws.ncols().max(1) as f64);
        let scale = drawn / (whole + self.work.joint_square + self.work.cross_square).max(1e-300);
        let certified = self.kinds.iter().any(|name| name.starts_with("sphere"));
        let squares = [
            (certified, Source::Plate, plate * scale),
            (self.contacts, Source::Seating, (seating + rest) * scale),
            (!self.contacts, Source::Instrument, rest * scale),
            (true, Source::EncoderNoise, joints * scale),
            (true, Source::OtherJoints, self.work.cross_square * scale),
            (true, Source::OpenParameters, open * scale),
            (true, Source::ModelDiscrepancy, discrepancy),
        ];
        let there = squares.iter().filter(|s| s.0);
        ErrorBudget {
            total_mm: there.clone().map(|s| s.2).sum::<f64>().sqrt() * 1e3,
            terms: there
                .map(|&(_, source, square)| BudgetTerm {
                    source,
                    rms_mm: square.sqrt() * 1e3,
                })
                .collect(),
        }
    }
}
