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
