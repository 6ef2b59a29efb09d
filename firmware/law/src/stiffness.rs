//! The stiffness of the Cartesian spring.

use nalgebra::{Matrix3, Vector3, Vector6};

/// Stiffness in F0. In translation it is a symmetric matrix, whose axes are those
/// of the approach; in rotation it is the same about all axes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Stiffness {
    /// Translational stiffness, in N/m.
    pub translation: Matrix3<f64>,
    /// Rotational stiffness, in N m/rad.
    pub rotation: f64,
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
        Vector6::new(
            t[(0, 0)] * x[0] + t[(0, 1)] * x[1] + t[(0, 2)] * x[2],
            t[(1, 0)] * x[0] + t[(1, 1)] * x[1] + t[(1, 2)] * x[2],
            t[(2, 0)] * x[0] + t[(2, 1)] * x[1] + t[(2, 2)] * x[2],
            self.rotation * x[3],
            self.rotation * x[4],
            self.rotation * x[5],
        )
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
