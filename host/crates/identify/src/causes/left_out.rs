//! What the prediction of a row is worth without the row itself.

use std::collections::BTreeMap;

use nalgebra::{Const, DMatrix, DVector, Matrix3, SymmetricEigen};

use super::extended::Extended;
use super::linear::Linear;
use crate::hierarchy::LeftOut;
use crate::hierarchy::constants::{LARGEST_LEVERAGE, POSTURES};

/// Least leverage that is told from rounding.
const LEAST_LEVERAGE: f64 = 1e-9;

/// At most [`POSTURES`] observations, spread evenly, by their indices. The leverage `H` of all targets of one, in the model with
/// everything that it says of them, is their covariance in units of the noise; without the observation it is `H (I − H)⁻¹`. The
/// factor turns the block of the first target in the one into that in the other: of one target it is `L (I − H)^(−1/2) L⁻¹`, with
/// the root `L` of its noise.
pub(super) fn left_out(linear: &Linear, model: &Extended) -> BTreeMap<usize, LeftOut> {
    let firsts: Vec<usize> = (0..linear.rows.len()).filter(|k| linear.rows[*k].leads()).collect();
    let of = |&first: &usize| {
        let row = &linear.rows[first];
        let targets = linear.rows[first..].iter().take_while(|other| other.index == row.index);
        (first, targets.count())
    };
    let step = firsts.len().div_ceil(POSTURES).max(1);
    let chosen: Vec<(usize, usize)> = firsts.iter().step_by(step).map(of).collect();
    let count: usize = chosen.iter().map(|(_, targets)| 3 * targets).sum();
    let mut own = DMatrix::zeros(model.w.ncols(), count);
    let mut at = 0;
    for (first, targets) in &chosen {
        let rows = model.w.rows(3 * first, 3 * targets);
        own.columns_mut(at, 3 * targets).copy_from(&rows.transpose());
        at += 3 * targets;
    }
    let half = model.factor().half(&own);
    at = 0;
    let each = chosen.iter().map(|&(first, targets)| {
        let own = half.columns(at, 3 * targets);
        at += 3 * targets;
        let eigen = SymmetricEigen::new(own.tr_mul(&own));
        let alone = eigen.eigenvalues.max() > LARGEST_LEVERAGE;
        let axes = eigen.eigenvectors.rows(0, 3);
        let with_it = eigen.eigenvalues.map(|h| h.clamp(LEAST_LEVERAGE, LARGEST_LEVERAGE));
        let block = |values: &DVector<f64>| {
            let all = axes * DMatrix::from_diagonal(values) * axes.transpose();
            SymmetricEigen::new(Matrix3::from_fn(|r, c| all[(r, c)]))
        };
        let power = |of: SymmetricEigen<f64, Const<3>>, power: f64| {
            let values = of.eigenvalues.map(|v| v.powf(power));
            of.eigenvectors * Matrix3::from_diagonal(&values) * of.eigenvectors.transpose()
        };
        let without_it = block(&with_it.map(|h| h / (1.0 - h)));
        let whitened = power(without_it, 0.5) * power(block(&with_it), -0.5);
        let row = &linear.rows[first];
        let l = row.root.inverse();
        let factor = l * whitened * l.try_inverse().unwrap_or_else(Matrix3::identity);
        (row.index, LeftOut { factor, alone })
    });
    each.collect()
}
