//! The stiffness of the Cartesian spring.

use core::ops::{Add, Mul, Sub};

use nalgebra::{Matrix3, Vector3, Vector6};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::procedure::{MAX_STIFFNESS_N_M, MAX_STIFFNESS_NM_RAD};

use super::error::LawError;

/// Share of the largest stiffness that rounding may add.
const SLACK: f64 = 1e-9;

/// Stiffness in F0. In translation it is a symmetric matrix, whose axes are those of the approach. In rotation it is one number for
/// all axes, as in the procedure, or a symmetric matrix, too ([`FullStiffness`]).
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiffness<R = f64> {
    /// Translational stiffness, in N/m.
    pub translation: Matrix3<f64>,
    /// Rotational stiffness, in N m/rad.
    pub rotation: R,
}

/// A stiffness with a matrix for translation and one for rotation.
pub type FullStiffness = Stiffness<Matrix3<f64>>;

/// A rotational stiffness: a number or a matrix.
pub(crate) trait Rotational: Copy + Add<Output = Self> + Sub<Output = Self> + Mul<f64, Output = Self> {
    /// Torque (N m) of a rotation vector (rad).
    fn torque(&self, x: &Vector3<f64>) -> Vector3<f64>;
}

impl Rotational for f64 {
    #[inline]
    fn torque(&self, x: &Vector3<f64>) -> Vector3<f64> {
        Vector3::new(self * x[0], self * x[1], self * x[2])
    }
}

impl Rotational for Matrix3<f64> {
    #[inline]
    fn torque(&self, x: &Vector3<f64>) -> Vector3<f64> {
        self * x
    }
}

#[expect(private_bounds, reason = "numbers and matrices are all there are")]
impl<R: Rotational> Stiffness<R> {
    /// The stiffness between two; `share` goes from 0 (`from`) to 1 (`to`).
    #[inline]
    pub fn between(from: &Self, to: &Self, share: f64) -> Self {
        Self {
            translation: from.translation + (to.translation - from.translation) * share,
            rotation: from.rotation + (to.rotation - from.rotation) * share,
        }
    }

    /// `K x`: force (N) and torque (N m) for a displacement (m) and a rotation (rad).
    #[inline]
    pub fn times(&self, x: &Vector6<f64>) -> Vector6<f64> {
        let t = &self.translation;
        let torque = self.rotation.torque(&Vector3::new(x[3], x[4], x[5]));
        Vector6::new(
            t[(0, 0)] * x[0] + t[(0, 1)] * x[1] + t[(0, 2)] * x[2],
            t[(1, 0)] * x[0] + t[(1, 1)] * x[1] + t[(1, 2)] * x[2],
            t[(2, 0)] * x[0] + t[(2, 1)] * x[1] + t[(2, 2)] * x[2],
            torque[0],
            torque[1],
            torque[2],
        )
    }
}

impl From<Stiffness> for FullStiffness {
    fn from(stiffness: Stiffness) -> Self {
        Self {
            translation: stiffness.translation,
            rotation: Matrix3::from_diagonal_element(stiffness.rotation),
        }
    }
}

impl FullStiffness {
    /// The same spring in other axes: `axes K axesᵀ`.
    #[must_use]
    pub fn turned(&self, axes: &Matrix3<f64>) -> Self {
        let turn = |k: &Matrix3<f64>| axes * k * axes.transpose();
        Self {
            translation: turn(&self.translation),
            rotation: turn(&self.rotation),
        }
    }

    /// Checks that both matrices are symmetric, and softer than nothing or stiffer than the most in no direction.
    ///
    /// # Errors
    /// [`LawError::Stiffness`].
    pub fn check(&self) -> Result<(), LawError> {
        for (field, k, most) in [
            ("translation", &self.translation, MAX_STIFFNESS_N_M),
            ("rotation", &self.rotation, MAX_STIFFNESS_NM_RAD),
        ] {
            let unit = Matrix3::from_diagonal_element(most);
            let symmetric = (k - k.transpose()).norm() <= SLACK * most;
            let within = [k + unit * SLACK, unit * (1.0 + SLACK) - k];
            if !(k.iter().all(|x| x.is_finite()) && symmetric && within.iter().all(|k| Cholesky::new(k).is_some())) {
                return Err(LawError::Stiffness { field, most });
            }
        }
        Ok(())
    }
}

impl Stiffness {
    /// The same translational stiffness (N/m) along all axes.
    pub fn isotropic(translation: f64, rotation: f64) -> Self {
        Self {
            translation: Matrix3::from_diagonal_element(translation),
            rotation,
        }
    }

    /// Stiffness `values[2]` along the unit vector `along`, `values[0]` and
    /// `values[1]` on the two axes perpendicular to it, all in N/m. The axis of
    /// `values[0]` lies in the plane of `along` and the z axis (the x axis if
    /// `along` is nearly vertical).
    pub fn about(values: [f64; 3], along: &Vector3<f64>, rotation: f64) -> Self {
        let reference = if along.z.abs() > 0.9 {
            Vector3::x()
        } else {
            Vector3::z()
        };
        let x = reference - along * along.dot(&reference);
        let x = x / x.norm();
        let y = along.cross(&x);
        let translation =
            x * x.transpose() * values[0] + y * y.transpose() * values[1] + along * along.transpose() * values[2];
        Self { translation, rotation }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if one entry of a stiffness that is not diagonal is left out or has a wrong sign,
    // or if a ramp does not go straight from one stiffness to the other.
    #[test]
    fn a_spring_is_its_matrix() {
        let along = Vector3::new(0.48, -0.6, 0.64);
        let from = Stiffness::about([50.0, 70.0, 100.0], &along, 200.0);
        let x = Vector6::new(0.01, -0.02, 0.03, 0.1, -0.2, 0.3);
        let expected = from.translation * Vector3::new(x[0], x[1], x[2]);
        let force = from.times(&x);
        for i in 0..3 {
            assert!((force[i] - expected[i]).abs() < 1e-12);
            assert!((force[i + 3] - 200.0 * x[i + 3]).abs() < 1e-12);
        }
        let to = Stiffness::isotropic(5.0, 40.0);
        for share in [0.0, 0.25, 1.0] {
            let middle = Stiffness::between(&from, &to, share);
            let expected = from.translation * (1.0 - share) + to.translation * share;
            assert!((middle.translation - expected).amax() < 1e-12);
            assert!((middle.rotation - (200.0 - 160.0 * share)).abs() < 1e-12);
        }
    }
}
