//! How large the effect of a cause is, and how certain: [`selection`](super::selection) chooses the causes,
//! [`words`](super::words) tells the size.

use nalgebra::{DMatrix, DVector};

use super::linear::Linear;

/// Standard deviations beyond which a part of an effect is told.
const TOLD: f64 = 2.0;

/// Root mean square displacement of the TCP by an effect.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Displaced {
    /// The displacement, in mm.
    pub(crate) mm: f64,
    /// That by one standard deviation of the effect, in mm.
    pub(crate) sigma_mm: f64,
    /// Whether these are only the directions that the data tell.
    pub(crate) in_part: bool,
}

/// Mean of `Bᵀ B` over the rows that an effect of whitened columns concerns, where `B` is what it displaces
/// the TCP by, in m.
pub(super) fn displacement(linear: &Linear, columns: &DMatrix<f64>) -> DMatrix<f64> {
    let mut mean = DMatrix::zeros(columns.ncols(), columns.ncols());
    let mut n = 0.0_f64;
    for (k, row) in linear.rows.iter().enumerate() {
        let own = columns.rows(3 * k, 3);
        if row.leads() && own.norm_squared() > 0.0 {
            let own = DMatrix::from_iterator(3, 3, row.root.inverse().iter().copied()) * own;
            mean += own.tr_mul(&own);
            n += 1.0;
        }
    }
    mean / n.max(1.0)
}

/// Root mean square displacement by an effect; `displacement` is what the function of that name gives.
///
/// An effect of several columns may be certain in some directions and unknown in others. If it is uncertain as a
/// whole, only the directions count in which it is more than [`TOLD`] standard deviations.
pub(super) fn displaced(displacement: DMatrix<f64>, effect: &DVector<f64>, covariance: &DMatrix<f64>) -> Displaced {
    let eigen = displacement.symmetric_eigen();
    let mut root = eigen.eigenvectors.transpose();
    for (mut row, square) in root.row_iter_mut().zip(eigen.eigenvalues.iter()) {
        row.scale_mut(square.max(0.0).sqrt());
    }
    let moved = &root * effect;
    let spread = (&root * covariance * root.transpose()).symmetric_eigen();
    let along = spread.eigenvectors.tr_mul(&moved);
    let directions = || {
        along
            .iter()
            .map(|m| m * m)
            .zip(spread.eigenvalues.iter().map(|v| v.max(0.0)))
    };
    let sum = |(m, v): (f64, f64), (square, variance): (f64, f64)| (m + square, v + variance);
    let told = |(square, variance): &(f64, f64)| *square > TOLD * TOLD * variance;
    let whole = directions().fold((0.0, 0.0), sum);
    let part = directions().filter(told).fold((0.0, 0.0), sum);
    let in_part = !told(&whole) && part.0 > 0.0;
    let (square, variance) = if in_part { part } else { whole };
    Displaced {
        mm: square.sqrt() * 1e3,
        sigma_mm: variance.sqrt() * 1e3,
        in_part,
    }
}

/// Length of the vector that an effect begins with, and its standard deviation along itself, in thousandths of
/// the unit.
pub(super) fn length(effect: &DVector<f64>, covariance: &DMatrix<f64>) -> (f64, f64) {
    let k = effect.len().min(3);
    let vector = effect.rows(0, k).into_owned();
    let size = vector.norm();
    let along = if size > 0.0 { vector / size } else { vector };
    let variance = along.dot(&(covariance.view((0, 0), (k, k)) * &along));
    (size * 1e3, variance.max(0.0).sqrt() * 1e3)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if what the data do not tell of an effect hides what they tell, or if a certain effect is told in part.
    #[test]
    fn an_effect_is_told_as_far_as_the_data_tell_it() {
        let unit = DMatrix::identity(2, 2);
        let effect = DVector::from_row_slice(&[3e-4, 4e-4]);
        let spread = |a: f64, b: f64| DMatrix::from_diagonal(&DVector::from_row_slice(&[a * a, b * b]));
        let near = |found: Displaced, (mm, sigma_mm, in_part): (f64, f64, bool)| {
            let same = (found.mm - mm).abs() < 1e-9 && (found.sigma_mm - sigma_mm).abs() < 1e-9;
            assert!(same && found.in_part == in_part, "{found:?}");
        };
        near(
            displaced(unit.clone(), &effect, &spread(3e-5, 4e-5)),
            (0.5, 0.05, false),
        );
        near(displaced(unit.clone(), &effect, &spread(1e-5, 8e-4)), (0.3, 0.01, true));
        // The second column moves nothing that was touched.
        let first = DMatrix::from_diagonal(&DVector::from_row_slice(&[1.0, 0.0]));
        near(displaced(first, &effect, &spread(1e-5, 8e-4)), (0.3, 0.01, false));
        let uncertain = displaced(unit, &effect, &spread(1e-3, 1e-3));
        assert!(!uncertain.in_part, "{uncertain:?}");
    }
}
