//! The workspace of a robot, and displacements over it.

use nalgebra::{DMatrix, Vector3};
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{Robot, Tool};

use crate::dense::transposed_product;

/// Configurations of a workspace.
pub const WORKSPACE: usize = 200;

/// The workspace of a robot with its tool: joint angles (rad) of [`WORKSPACE`] configurations.
pub fn workspace(robot: &Robot, tool: &Tool) -> Vec<Vec<f64>> {
    spherecal_model::workspace(&Chain::unchecked(robot, tool), WORKSPACE)
}

/// Takes the best-fitting rigid motion of all points out of displacements.
#[derive(Clone, Debug)]
pub(crate) struct Rigid {
    basis: DMatrix<f64>,
}

impl Rigid {
    pub(crate) fn new(points: &[Vector3<f64>]) -> Self {
        let mut b = DMatrix::zeros(3 * points.len(), 6);
        let middle = points.iter().sum::<Vector3<f64>>() / points.len().max(1) as f64;
        for (k, p) in points.iter().enumerate() {
            for axis in 0..3 {
                let e: Vector3<f64> = Vector3::ith(axis, 1.0);
                b[(3 * k + axis, axis)] = 1.0;
                let turn = e.cross(&(p - middle));
                for i in 0..3 {
                    b[(3 * k + i, 3 + axis)] = turn[i];
                }
            }
        }
        Self { basis: b.qr().q() }
    }

    /// Mean length of displacements (m) without the motion.
    pub(crate) fn mean_without(&self, moved: &[Vector3<f64>]) -> f64 {
        let mut columns = stacked(moved);
        self.remove(&mut columns);
        let lengths = columns
            .as_slice()
            .chunks_exact(3)
            .map(|v| Vector3::from_column_slice(v).norm());
        lengths.sum::<f64>() / moved.len().max(1) as f64
    }

    /// Removes the motion from each column.
    pub(crate) fn remove(&self, columns: &mut DMatrix<f64>) {
        let share = transposed_product(&self.basis, columns);
        columns.gemm(-1.0, &self.basis, &share, 1.0);
    }
}

/// Displacements as one column, 3n.
pub(crate) fn stacked(moved: &[Vector3<f64>]) -> DMatrix<f64> {
    DMatrix::from_fn(3 * moved.len(), 1, |r, _| moved[r / 3][r % 3])
}
