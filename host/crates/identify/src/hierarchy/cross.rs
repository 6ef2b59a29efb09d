//! Errors of joints that depend on the angles of the other joints: the columns, and what is stated of them. See
//! [`causes::cross`](crate::causes).

use nalgebra::{DMatrix, DVector, Vector3};

use super::constants::{CROSS_JOINTS, CROSS_WEIGHTS};

/// Displacements by unit errors at joint angles `q`: `joints` are the columns of the joints' angles. Of a chain of more joints
/// than an arm has there are none.
pub(crate) fn columns(q: &[f64], joints: &[Vector3<f64>]) -> Vec<Vector3<f64>> {
    let mut all = Vec::new();
    if joints.len() > CROSS_JOINTS {
        return all;
    }
    for (joint, column) in joints.iter().enumerate() {
        for other in (0..joints.len()).filter(|other| *other != joint) {
            let angle = q.get(other).copied().unwrap_or(0.0);
            for (weight, order) in CROSS_WEIGHTS.iter().zip(1..) {
                let (sin, cos) = (f64::from(order) * angle).sin_cos();
                all.extend([cos, sin].map(|wave| column * (weight * wave)));
            }
        }
    }
    all
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
    /// White noise that they leave, as a share of that of the fit without them.
    pub(crate) white: f64,
}

impl CrossEffects {
    /// No errors beside unknowns with a covariance.
    pub(crate) fn none(covariance: &DMatrix<f64>) -> Self {
        Self {
            covariance: covariance.clone(),
            mean: DVector::zeros(covariance.nrows()),
            size_rad: 0.0,
            white: 1.0,
        }
    }

    /// Displacements (3 x errors) at joint angles `q`.
    pub(crate) fn at(&self, q: &[f64], joints: &[Vector3<f64>]) -> DMatrix<f64> {
        let all = columns(q, joints);
        DMatrix::from_fn(3, all.len(), |axis, c| all[c][axis] * self.size_rad)
    }

    /// Draws of the displacements (3n a column) at `postures` by the errors about their mean; and that mean, with that by which
    /// the estimate is off because of them. `unknowns` are the draws of all unknowns, `free` the columns (3n) of those that are no
    /// such errors.
    pub(crate) fn draws<'a>(
        &self,
        unknowns: &DMatrix<f64>,
        free: &DMatrix<f64>,
        postures: impl Iterator<Item = (&'a [f64], &'a [Vector3<f64>])>,
    ) -> (DMatrix<f64>, DVector<f64>) {
        let (first, count) = (free.ncols(), self.mean.len() - free.ncols());
        let mut mean = free * self.mean.rows(0, first);
        let mut draws = DMatrix::zeros(free.nrows(), unknowns.ncols());
        if count > 0 {
            let mut all = DMatrix::zeros(free.nrows(), count);
            for (k, (q, joints)) in postures.enumerate() {
                all.rows_mut(3 * k, 3).copy_from(&self.at(q, joints));
            }
            mean += &all * self.mean.rows(first, count);
            draws = all * unknowns.rows(first, count);
        }
        (draws, mean)
    }
}

#[cfg(test)]
mod tests {
    use nalgebra::Vector3;

    use super::{CROSS_WEIGHTS, columns};

    // Fails if a joint has an error by its own angle (that is what harmonics are), if an order or a pair is missing, or if
    // chains of more joints than an arm has get any.
    #[test]
    fn every_joint_errs_with_every_other() {
        let q = [0.3, -1.0, 2.0];
        let joints = [Vector3::x(), Vector3::y(), Vector3::z()];
        let all = columns(&q, &joints);
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
        assert!(columns(&[0.0; 9], &[Vector3::x(); 9]).is_empty());
    }
}
