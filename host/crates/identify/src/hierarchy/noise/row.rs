//! A row as the variances of the noise see it.

use nalgebra::{DMatrix, DVector, Matrix3, Vector3};
use spherecal_model::input::MOST_TARGETS;

use super::{ALONG, BODY, COUNT, JOINT, SEATING, SHIFT, TURN, Variances};
use crate::chain::Prepared;
use crate::parts::{Block, tool_columns};
use crate::seen::RowPart;

fn slot(observation: &Prepared, part: RowPart) -> usize {
    match part {
        RowPart::Target(0) if observation.sphere.is_some() => SEATING,
        RowPart::Target(number) => 2 + number.min(MOST_TARGETS - 1),
        RowPart::Body => BODY,
    }
}

/// The variances of a part's three numbers.
pub(super) struct PartAxes {
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
    pub(super) fn share(&self, m: &Matrix3<f64>, to: &mut Variances) {
        let along = self.along.map_or(0.0, |(slot, sight)| {
            let along = sight.dot(&(m * sight));
            to[slot] += along;
            along
        });
        to[self.across] += m.trace() - along;
    }
}

/// One row as the variances see it: its residual and, of each variance that all its parts share, `Q Qᵀ` (3K x 3K).
pub(super) struct Row {
    /// Number of the variance, and the product.
    shared: Vec<(usize, DMatrix<f64>)>,
    residual: DVector<f64>,
    pub(super) axes: Vec<PartAxes>,
}

impl Row {
    pub(super) fn new(n: usize, observation: &Prepared, blocks: &[Block]) -> Self {
        let rows = 3 * blocks.len();
        let joints = DMatrix::from_fn(rows, n, |r, c| blocks[r / 3].joints[c][r % 3]);
        let tool = tool_columns(blocks).into_iter().flatten();
        let shared = std::iter::once((JOINT, joints)).chain([SHIFT, TURN].into_iter().zip(tool));
        Self {
            shared: shared.map(|(slot, q)| (slot, &q * q.transpose())).collect(),
            residual: DVector::from_fn(rows, |r, _| blocks[r / 3].residual[r % 3]),
            axes: blocks.iter().map(|b| PartAxes::new(observation, b)).collect(),
        }
    }

    pub(super) fn numbers(&self) -> f64 {
        self.residual.len() as f64
    }

    /// The row with its covariance `C` by the variances.
    pub(super) fn solved(&self, variances: &Variances) -> Option<Solved<'_>> {
        let rows = self.residual.len();
        let mut covariance = DMatrix::zeros(rows, rows);
        for (slot, product) in &self.shared {
            covariance.zip_apply(product, |c, q| *c += variances[*slot] * q);
        }
        for (k, part) in self.axes.iter().enumerate() {
            let mut own = covariance.fixed_view_mut::<3, 3>(3 * k, 3 * k);
            own += Matrix3::from_diagonal_element(variances[part.across]);
            if let Some((slot, sight)) = part.along {
                own += sight * sight.transpose() * (variances[slot] - variances[part.across]);
            }
        }
        let factor = covariance.cholesky()?;
        let weighted = factor.solve(&self.residual);
        Some(Solved {
            d2: self.residual.dot(&weighted),
            inverse: factor.inverse(),
            weighted,
            row: self,
        })
    }
}

/// A row with its covariance.
pub(super) struct Solved<'a> {
    pub(super) row: &'a Row,
    pub(super) inverse: DMatrix<f64>,
    /// `C⁻¹ r`.
    weighted: DVector<f64>,
    pub(super) d2: f64,
}

impl Solved<'_> {
    /// `|Qᵀ C⁻¹ r|²` of every variance.
    pub(super) fn found(&self) -> Variances {
        let mut found = [0.0; COUNT];
        for (slot, product) in &self.row.shared {
            found[*slot] = self.weighted.dot(&(product * &self.weighted));
        }
        for (k, part) in self.row.axes.iter().enumerate() {
            let weighted = self.weighted.fixed_rows::<3>(3 * k);
            part.share(&(weighted * weighted.transpose()), &mut found);
        }
        found
    }

    /// `tr(Qᵀ M Q)` of every variance.
    pub(super) fn traces(&self, m: &DMatrix<f64>) -> Variances {
        let mut traces = [0.0; COUNT];
        for (slot, product) in &self.row.shared {
            traces[*slot] = m.dot(product);
        }
        for (k, part) in self.row.axes.iter().enumerate() {
            part.share(&m.fixed_view::<3, 3>(3 * k, 3 * k).into_owned(), &mut traces);
        }
        traces
    }
}
