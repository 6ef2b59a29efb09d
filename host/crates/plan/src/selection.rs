//! The predictions and the possible measurements of a choice of poses, and the products that rank them.

use std::ops::{AddAssign, Mul};

use nalgebra::{DMatrix, Matrix3, Matrix6, Matrix6xX, SMatrix, Vector3};
use wide::{f32x4, f64x2};

/// The predictions, and the possible measurements.
pub(super) struct SelectionProblem {
    /// Rows of candidate c are the columns 3c, 3c+1, 3c+2; m x 3N.
    pub(super) rows: DMatrix<f64>,
    /// The same, as the gains of all candidates are updated with it: in single and in double precision.
    pub(super) single: Vec<f32x4>,
    pub(super) double: Vec<f64x2>,
    /// `W`, m x m.
    pub(super) weight: DMatrix<f64>,
    /// `G_vᵀ` of each validation configuration, base aligned, m x 3, in m.
    pub(super) predictions: Vec<DMatrix<f64>>,
    /// Variance (trace) of the unmodelled joint noise at each of them, in m².
    pub(super) noise: Vec<f64>,
}

impl SelectionProblem {
    /// From the candidates' rows (3 x m each, row by row) and from rows, place
    /// and noise of the predictions ([`spherecal_identify::DesignModel`]).
    pub(super) fn new(m: usize, candidates: &[Vec<f64>], predictions: &[(Vec<f64>, Vector3<f64>, f64)]) -> Self {
        let mut rows = DMatrix::zeros(m, 3 * candidates.len());
        for (target, source) in rows.as_mut_slice().chunks_mut((3 * m).max(1)).zip(candidates) {
            target.copy_from_slice(&source[..3 * m]);
        }
        let noise: Vec<f64> = predictions.iter().map(|p| p.2).collect();
        let points: Vec<Vector3<f64>> = predictions.iter().map(|p| p.1).collect();
        let mut blocks: Vec<DMatrix<f64>> = predictions
            .iter()
            .map(|p| DMatrix::from_column_slice(m, 3, &p.0[..3 * m]))
            .collect();
        align(&mut blocks, &points);
        let mut weight = DMatrix::zeros(m, m);
        for block in &blocks {
            weight.gemm(1.0 / blocks.len().max(1) as f64, block, &block.transpose(), 1.0);
        }
        Self {
            single: Lanes::columns(&rows),
            double: Lanes::columns(&rows),
            rows,
            weight,
            predictions: blocks,
            noise,
        }
    }

    pub(super) fn candidate(&self, c: usize) -> DMatrix<f64> {
        self.rows.columns(3 * c, 3).into_owned()
    }

    pub(super) fn count(&self) -> usize {
        self.rows.ncols() / 3
    }

    /// The same with only these candidates.
    pub(super) fn only(&self, candidates: &[usize]) -> Self {
        let m = self.rows.nrows();
        let mut rows = DMatrix::zeros(m, 3 * candidates.len());
        for (k, c) in candidates.iter().enumerate() {
            rows.columns_mut(3 * k, 3).copy_from(&self.rows.columns(3 * c, 3));
        }
        Self {
            single: Lanes::columns(&rows),
            double: Lanes::columns(&rows),
            rows,
            weight: self.weight.clone(),
            predictions: self.predictions.clone(),
            noise: self.noise.clone(),
        }
    }
}

/// Numbers that are multiplied at once, in one of two precisions.
pub(super) trait Lanes: Copy + AddAssign + Mul<Output = Self> + Send + Sync {
    /// How many.
    const COUNT: usize;
    const ZERO: Self;
    /// At most [`Self::COUNT`] numbers; zeros fill the rest.
    fn of(numbers: &[f64]) -> Self;
    fn sum(self) -> f64;

    /// The columns of a matrix, one after the other, each filled up with zeros.
    fn columns(matrix: &DMatrix<f64>) -> Vec<Self> {
        let all = matrix.as_slice().chunks(matrix.nrows().max(1));
        all.flat_map(|column| column.chunks(Self::COUNT).map(Self::of))
            .collect()
    }
}

impl Lanes for f32x4 {
    const COUNT: usize = 4;
    const ZERO: Self = Self::ZERO;

    fn of(numbers: &[f64]) -> Self {
        std::array::from_fn(|k| numbers.get(k).map_or(0.0, |x| *x as f32)).into()
    }

    fn sum(self) -> f64 {
        self.reduce_add().into()
    }
}

impl Lanes for f64x2 {
    const COUNT: usize = 2;
    const ZERO: Self = Self::ZERO;

    fn of(numbers: &[f64]) -> Self {
        std::array::from_fn(|k| numbers.get(k).copied().unwrap_or_default()).into()
    }

    fn sum(self) -> f64 {
        self.reduce_add()
    }
}

/// `Xᵀ A` of two matrices of three [columns](Lanes::columns) each.
pub(super) fn product<T: Lanes>(x: &[T], a: &[T]) -> Matrix3<f64> {
    let (x0, rest) = x.split_at(x.len() / 3);
    let (x1, x2) = rest.split_at(x0.len());
    let (a0, rest) = a.split_at(x0.len());
    let (a1, a2) = rest.split_at(x0.len());
    let mut sums = [[T::ZERO; 3]; 3];
    for ((((x0, x1), x2), a0), (a1, a2)) in x0.iter().zip(x1).zip(x2).zip(a0).zip(a1.iter().zip(a2)) {
        for (sums, x) in sums.iter_mut().zip([x0, x1, x2]) {
            sums[0] += *x * *a0;
            sums[1] += *x * *a1;
            sums[2] += *x * *a2;
        }
    }
    Matrix3::from_fn(|i, j| sums[i][j].sum())
}

/// Removes the best-fitting rigid motion of all points from every column.
pub(super) fn align(blocks: &mut [DMatrix<f64>], points: &[Vector3<f64>]) {
    let m = blocks.first().map_or(0, DMatrix::nrows);
    let mut normal = Matrix6::zeros();
    let mut moments = Matrix6xX::<f64>::zeros(m);
    let motion = |p: &Vector3<f64>| -> SMatrix<f64, 3, 6> {
        let mut b = SMatrix::<f64, 3, 6>::zeros();
        for axis in 0..3 {
            let e: Vector3<f64> = Vector3::ith(axis, 1.0);
            b.fixed_view_mut::<3, 1>(0, axis).copy_from(&e);
            b.fixed_view_mut::<3, 1>(0, axis + 3).copy_from(&e.cross(p));
        }
        b
    };
    for (block, p) in blocks.iter().zip(points) {
        let b = motion(p);
        normal += b.transpose() * b;
        moments += b.transpose() * block.transpose();
    }
    let Some(factor) = normal.cholesky() else {
        return;
    };
    let fitted = factor.solve(&moments);
    for (block, p) in blocks.iter_mut().zip(points) {
        *block -= (motion(p) * &fitted).transpose();
    }
}
