//! Cholesky factors of matrices with some hundreds of columns, in blocks.
//!
//! nalgebra factorises column by column; in blocks nearly all work is a product
//! of matrices, which is several times as fast.

use nalgebra::{DMatrix, DMatrixView, DVector};

/// Columns of a block.
const BLOCK: usize = 48;

/// `aᵀ b`. nalgebra's own is a dot product for each entry; a transposed copy and a
/// product in blocks take a fraction of its time.
pub(crate) fn transposed_product(a: &DMatrix<f64>, b: &DMatrix<f64>) -> DMatrix<f64> {
    a.transpose() * b
}

/// `Rᵀ R` of a lower triangular `R`.
pub(crate) fn gram_of_lower(r: &DMatrix<f64>) -> DMatrix<f64> {
    let n = r.nrows();
    let mut out = DMatrix::zeros(n, n);
    for from in (0..n).step_by(BLOCK) {
        let end = n.min(from + BLOCK);
        let rows = r.view((from, 0), (end - from, end));
        let turned = rows.transpose();
        out.view_mut((0, 0), (end, end)).gemm(1.0, &turned, &rows, 1.0);
    }
    out
}

/// Inverse of a lower triangular block: a product with it is several times as fast as a substitution.
fn inverse_of(root: &DMatrixView<'_, f64>) -> DMatrix<f64> {
    let mut inverse = DMatrix::identity(root.nrows(), root.nrows());
    root.solve_lower_triangular_unchecked_mut(&mut inverse);
    inverse
}

/// `A = L Lᵀ` with `L` lower triangular; the upper triangle of the storage is zero.
#[derive(Clone, Debug)]
pub(crate) struct Factor {
    l: DMatrix<f64>,
}

impl Factor {
    /// Factorises a symmetric matrix by its lower triangle. `None` if it is not
    /// positive definite.
    pub(crate) fn new(mut a: DMatrix<f64>) -> Option<Self> {
        let n = a.nrows();
        for from in (0..n).step_by(BLOCK) {
            let width = BLOCK.min(n - from);
            let diagonal = a.view((from, from), (width, width)).into_owned();
            let root = nalgebra::Cholesky::new(diagonal)?.l();
            a.view_mut((from, from), (width, width)).copy_from(&root);
            let below = n - from - width;
            if below > 0 {
                // Rows below: B := B root⁻ᵀ, as (root⁻¹ Bᵀ)ᵀ.
                let turned = inverse_of(&root.as_view()) * a.view((from + width, from), (below, width)).transpose();
                let panel = turned.transpose();
                a.view_mut((from + width, from), (below, width)).copy_from(&panel);
                for to in (from + width..n).step_by(BLOCK) {
                    let wide = BLOCK.min(n - to);
                    let right = turned.columns(to - from - width, wide).into_owned();
                    let left = panel.rows(to - from - width, n - to).into_owned();
                    a.view_mut((to, to), (n - to, wide)).gemm(-1.0, &left, &right, 1.0);
                }
            }
        }
        a.fill_upper_triangle(0.0, 1);
        Some(Self { l: a })
    }

    /// `b := L⁻¹ b`.
    pub(crate) fn half_mut(&self, b: &mut DMatrix<f64>) {
        let n = self.l.nrows();
        for from in (0..n).step_by(BLOCK) {
            let width = BLOCK.min(n - from);
            let root = self.l.view((from, from), (width, width));
            let own = inverse_of(&root) * b.rows(from, width);
            b.rows_mut(from, width).copy_from(&own);
            let below = n - from - width;
            if below > 0 {
                let panel = self.l.view((from + width, from), (below, width));
                b.rows_mut(from + width, below).gemm(-1.0, &panel, &own, 1.0);
            }
        }
    }

    /// `L⁻¹ b`.
    pub(crate) fn half(&self, b: &DMatrix<f64>) -> DMatrix<f64> {
        let mut out = b.clone();
        self.half_mut(&mut out);
        out
    }

    /// `L⁻¹`, lower triangular.
    pub(crate) fn inverse_root(&self) -> DMatrix<f64> {
        let n = self.l.nrows();
        let mut out = DMatrix::identity(n, n);
        for from in (0..n).step_by(BLOCK) {
            // Columns beyond the block are still zero.
            let (width, end) = (BLOCK.min(n - from), n.min(from + BLOCK));
            let root = self.l.view((from, from), (width, width));
            let own = inverse_of(&root) * out.view((from, 0), (width, end));
            out.view_mut((from, 0), (width, end)).copy_from(&own);
            if end < n {
                let panel = self.l.view((end, from), (n - end, width));
                out.view_mut((end, 0), (n - end, end)).gemm(-1.0, &panel, &own, 1.0);
            }
        }
        out
    }

    /// Factor of a matrix with more rows and columns: `cross` (before x new) and `corner` (new x new) are added.
    /// `None` if it is not positive definite.
    pub(crate) fn extended(&self, cross: &DMatrix<f64>, corner: DMatrix<f64>) -> Option<Self> {
        let (before, new) = cross.shape();
        let half = self.half(cross);
        let below = half.transpose();
        let own = Self::new(corner - &below * half)?;
        let mut l = self.l.clone().resize(before + new, before + new, 0.0);
        l.view_mut((before, 0), (new, before)).copy_from(&below);
        l.view_mut((before, before), (new, new)).copy_from(&own.l);
        Some(Self { l })
    }

    /// `L⁻¹ b` of one column.
    pub(crate) fn half_vector(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut out = b.clone();
        self.l.solve_lower_triangular_unchecked_mut(&mut out);
        out
    }

    /// `L⁻ᵀ b` of one column: a vector with covariance `A⁻¹` if `b` is white.
    pub(crate) fn draw(&self, b: &DVector<f64>) -> DVector<f64> {
        let mut out = b.clone();
        self.l.tr_solve_lower_triangular_mut(&mut out);
        out
    }

    /// `A⁻¹ b` of one column.
    pub(crate) fn solve_vector(&self, b: &DVector<f64>) -> DVector<f64> {
        self.draw(&self.half_vector(b))
    }

    /// `L b`.
    pub(crate) fn times(&self, b: &DMatrix<f64>) -> DMatrix<f64> {
        &self.l * b
    }

    /// `ln |A|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        (0..self.l.nrows()).map(|i| 2.0 * self.l[(i, i)].ln()).sum()
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a block is left out of the factor, of the substitution, of the inverse or of an extended factor: sizes below, at
    // and above the block's width.
    #[test]
    fn factor_and_substitution_agree_with_the_plain_ones() {
        for n in [1, 47, 48, 49, 96, 131] {
            let root = DMatrix::from_fn(n, n, |i, j| ((i * 31 + j * 17) % 23) as f64 / 23.0 - 0.4);
            let a = &root * root.transpose() + DMatrix::identity(n, n);
            let factor = Factor::new(a.clone()).expect("positive definite");
            let plain = nalgebra::Cholesky::new(a.clone()).expect("positive definite");
            assert!((&factor.l - plain.l()).amax() < 1e-10, "{n}");
            let b = DMatrix::from_fn(n, 3, |i, j| (i + 2 * j) as f64 / n as f64 - 0.3);
            let column = b.column(1).into_owned();
            let solved = factor.solve_vector(&column);
            assert!((&a * &solved - &column).amax() < 1e-9, "{n}");
            assert!((factor.half(&b).tr_mul(&factor.half(&b)) - b.tr_mul(&plain.solve(&b))).amax() < 1e-9);
            assert!((factor.log_determinant() - plain.ln_determinant()).abs() < 1e-8);
            let inverse = gram_of_lower(&factor.inverse_root());
            assert!((&a * inverse - DMatrix::identity(n, n)).amax() < 1e-9, "{n}");
            for first in [n / 3, n - 1].into_iter().filter(|first| *first > 0) {
                let new = n - first;
                let part = Factor::new(a.view((0, 0), (first, first)).into_owned()).expect("positive definite");
                let cross = a.view((0, first), (first, new)).into_owned();
                let whole = part.extended(&cross, a.view((first, first), (new, new)).into_owned());
                assert!((&whole.expect("positive definite").l - &factor.l).amax() < 1e-10, "{n}");
            }
        }
        assert!(Factor::new(-DMatrix::<f64>::identity(60, 60)).is_none());
    }
}
