//! What no model of single joints holds: errors of a joint that depend on the angles of the others.
//!
//! Friction, loads that couple through the links and errors of assembly make the residuals of postures that are alike
//! alike. Where they are taken for white noise, a slow course of them passes for a plate that slipped or an encoder that
//! jumped, and what is stated is too good. So each joint has an error that is a smooth function of each other joint's angle:
//! its first orders, with one size for all, beside the white noise. They are no part of the result, because a table hardly
//! determines them one by one: they are integrated out of the estimate, of the tests of causes and of the statement.

use nalgebra::{DMatrix, DVector, Vector3};

use super::extended::Extended;
use super::linear::Linear;
use crate::hierarchy::constants::{CROSS_JOINTS, CROSS_RAD, CROSS_WEIGHTS, FACTORS};

/// Rounds of the search for the size and the rest of the noise.
const ROUNDS: usize = 3;
/// Steps by the golden ratio: to 1 % of an interval.
const STEPS: usize = 9;
/// Logarithms of the size, by the ordinary one, that are searched; of the white noise that is left.
const RANGES: [(f64, f64); 2] = [(-3.0, 3.5), (-2.0, 0.1)];

/// Displacements by unit errors: `joints` are the columns of the joints' angles.
pub(crate) fn columns<'a>(q: &'a [f64], joints: &'a [Vector3<f64>]) -> impl Iterator<Item = Vector3<f64>> + 'a {
    let few = joints.len() <= CROSS_JOINTS;
    joints
        .iter()
        .take(if few { joints.len() } else { 0 })
        .enumerate()
        .flat_map(move |(joint, column)| {
            q.iter()
                .take(joints.len())
                .enumerate()
                .filter(move |(other, _)| *other != joint)
                .flat_map(move |(_, angle)| {
                    CROSS_WEIGHTS.iter().zip(1..).flat_map(move |(weight, order)| {
                        let (sin, cos) = (f64::from(order) * angle).sin_cos();
                        [column * (weight * cos), column * (weight * sin)]
                    })
                })
        })
}

/// The errors in the linear model of a fit.
pub(super) struct Cross {
    /// Whitened columns and the sigmas of their priors.
    pub(super) columns: Vec<(DVector<f64>, f64)>,
    /// Size of an error, 1 sigma, in rad.
    pub(super) size_rad: f64,
    /// White noise that is left, by that of the fit.
    pub(super) white: f64,
}

impl Cross {
    /// The size and the rest of the white noise that explain the rows best, which count as so many `numbers`.
    pub(super) fn new(linear: &Linear, numbers: f64) -> Self {
        let count = linear
            .rows
            .first()
            .map_or(0, |row| columns(&row.posture.q, &row.posture.joints).count());
        let mut all = vec![DVector::zeros(3 * linear.rows.len()); count];
        let displacements: Vec<Vec<Vector3<f64>>> = linear
            .rows
            .iter()
            .map(|row| columns(&row.posture.q, &row.posture.joints).collect())
            .collect();
        for (c, column) in all.iter_mut().enumerate() {
            let mut rows = displacements.iter();
            *column = linear.column(|_| rows.next().map_or_else(Vector3::zeros, |row| row[c]));
        }
        let columns: Vec<(DVector<f64>, f64)> = all.into_iter().map(|column| (column, CROSS_RAD)).collect();
        let model = Extended::new(linear).with(linear, &columns);
        let mut at = [0.0, 0.0];
        if count > 0 {
            for _ in 0..ROUNDS {
                for k in 0..at.len() {
                    let evidence = |x: f64| {
                        let mut at = at;
                        at[k] = x;
                        model.evidence_with(linear, numbers, at[0].exp(), at[1].exp())
                            - 0.5 * (at[0] / FACTORS.made.ln()).powi(2)
                    };
                    at[k] = highest(RANGES[k], evidence);
                }
            }
        }
        let (size, white) = (at[0].exp(), at[1].exp());
        Self {
            columns: columns.into_iter().map(|(c, s)| (c / white, s * size)).collect(),
            size_rad: CROSS_RAD * size,
            white,
        }
    }
}

/// Where a function with one maximum is highest, by the golden ratio.
fn highest((mut low, mut high): (f64, f64), of: impl Fn(f64) -> f64) -> f64 {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let mut left = high - GOLDEN * (high - low);
    let mut right = low + GOLDEN * (high - low);
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..STEPS {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - GOLDEN * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + GOLDEN * (high - low);
            at_right = of(right);
        }
    }
    0.5 * (low + high)
}

/// What is stated of the errors: the unknowns and they together.
#[derive(Clone, Debug)]
pub(crate) struct CrossEffects {
    /// Covariance of the free unknowns, in their units, and of the errors, in their sizes.
    pub(crate) covariance: DMatrix<f64>,
    /// Mean of the unknowns, beyond the estimate, and of the errors.
    pub(crate) mean: DVector<f64>,
    /// Size of an error, in rad.
    pub(crate) size_rad: f64,
}

impl CrossEffects {
    /// No errors beside unknowns with a covariance.
    pub(crate) fn none(covariance: &DMatrix<f64>) -> Self {
        Self {
            covariance: covariance.clone(),
            mean: DVector::zeros(covariance.nrows()),
            size_rad: 0.0,
        }
    }

    /// Displacements (3 x errors) at joint angles `q`.
    pub(crate) fn at(&self, q: &[f64], joints: &[Vector3<f64>]) -> DMatrix<f64> {
        let all: Vec<Vector3<f64>> = columns(q, joints).map(|v| v * self.size_rad).collect();
        DMatrix::from_fn(3, all.len(), |axis, c| all[c][axis])
    }

    /// Adds to draws of displacements (3n a column) at `postures` what the errors do, and by how much the estimate is off
    /// because of them. `unknowns` are the draws of all unknowns, `free` the columns (3n) of those that are no such errors.
    pub(crate) fn add_to<'a>(
        &self,
        draws: &mut DMatrix<f64>,
        unknowns: &DMatrix<f64>,
        free: &DMatrix<f64>,
        postures: impl Iterator<Item = (&'a [f64], &'a [Vector3<f64>])>,
    ) {
        let (first, count) = (free.ncols(), self.mean.len() - free.ncols());
        let mut mean = free * self.mean.rows(0, first);
        if count > 0 {
            let mut all = DMatrix::zeros(draws.nrows(), count);
            for (k, (q, joints)) in postures.enumerate() {
                all.rows_mut(3 * k, 3).copy_from(&self.at(q, joints));
            }
            mean += &all * self.mean.rows(first, count);
            *draws += all * unknowns.rows(first, count);
        }
        draws.column_iter_mut().for_each(|mut column| column += &mean);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a joint has an error by its own angle (that is what harmonics are), if an order or a pair is missing, or if
    // chains of more joints than an arm has get any.
    #[test]
    fn every_joint_errs_with_every_other() {
        let q = [0.3, -1.0, 2.0];
        let joints = [Vector3::x(), Vector3::y(), Vector3::z()];
        let all: Vec<_> = columns(&q, &joints).collect();
        assert_eq!(all.len(), 3 * 2 * 2 * CROSS_WEIGHTS.len());
        let (sin, cos) = q[1].sin_cos();
        assert!(
            (all[0] - Vector3::x() * CROSS_WEIGHTS[0] * cos).norm() < 1e-15,
            "{}",
            all[0]
        );
        assert!(
            (all[1] - Vector3::x() * CROSS_WEIGHTS[0] * sin).norm() < 1e-15,
            "{}",
            all[1]
        );
        assert_eq!(columns(&[0.0; 9], &[Vector3::x(); 9]).count(), 0);
    }

    // Fails if the search misses the top of a hill, also beside the middle or at an end.
    #[test]
    fn the_highest_point_is_found() {
        for top in [-2.9, -0.2, 1.7, 3.5] {
            let found = highest((-3.0, 3.5), |x| -(x - top) * (x - top));
            assert!((found - top).abs() < 0.06, "{found}, {top}");
        }
    }
}
