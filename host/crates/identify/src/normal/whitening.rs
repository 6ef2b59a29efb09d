//! Whitening: the covariance of a residual and the inverse of its Cholesky factor.

use nalgebra::{Matrix3, Vector3};

/// Standard deviations that whiten the residuals.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Whitening {
    /// Variance of the joint noise, in rad².
    pub(crate) joint: f64,
    /// Variance of seating on a sphere, in m².
    pub(crate) seating: f64,
    /// Variance of a measured point, in m².
    pub(crate) point: f64,
}

impl Whitening {
    /// `C` at a pose, in m².
    #[inline]
    pub(crate) fn covariance(&self, joints: &[Vector3<f64>], on_sphere: bool) -> Matrix3<f64> {
        let floor = if on_sphere { self.seating } else { self.point };
        let (mut xx, mut yy, mut zz, mut xy, mut xz, mut yz) = (0.0, 0.0, 0.0, 0.0, 0.0, 0.0);
        for j in joints {
            xx += j.x * j.x;
            yy += j.y * j.y;
            zz += j.z * j.z;
            xy += j.x * j.y;
            xz += j.x * j.z;
            yz += j.y * j.z;
        }
        let v = self.joint;
        Matrix3::new(
            v * xx + floor,
            v * xy,
            v * xz,
            v * xy,
            v * yy + floor,
            v * yz,
            v * xz,
            v * yz,
            v * zz + floor,
        )
    }
}

/// `L⁻¹` of a 3 x 3 covariance, as its six numbers.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Root([f64; 6]);

impl Root {
    #[inline]
    pub(crate) fn new(c: &Matrix3<f64>) -> Self {
        let a = 1.0 / c[(0, 0)].sqrt();
        let (l10, l20) = (c[(1, 0)] * a, c[(2, 0)] * a);
        let b = 1.0 / (c[(1, 1)] - l10 * l10).max(1e-30).sqrt();
        let l21 = (c[(2, 1)] - l20 * l10) * b;
        let d = 1.0 / (c[(2, 2)] - l20 * l20 - l21 * l21).max(1e-30).sqrt();
        Self([a, b, d, -l10 * a * b, (l10 * b * l21 - l20) * a * d, -l21 * b * d])
    }

    /// The same times a factor.
    #[inline]
    pub(super) fn scaled(self, factor: f64) -> Self {
        Self(self.0.map(|x| x * factor))
    }

    /// `L`, 3 x 3 lower triangular.
    pub(crate) fn inverse(&self) -> Matrix3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        let (x, y, z) = (1.0 / a, 1.0 / b, 1.0 / d);
        let yx = -ba * x * y;
        let zy = -db * y * z;
        let zx = -(da * x + db * yx) * z;
        Matrix3::new(x, 0.0, 0.0, yx, y, 0.0, zx, zy, z)
    }

    /// `ln |L⁻¹|`.
    pub(crate) fn log_determinant(&self) -> f64 {
        let [a, b, d, ..] = self.0;
        (a * b * d).ln()
    }

    #[inline]
    pub(crate) fn times(&self, v: &Vector3<f64>) -> Vector3<f64> {
        let [a, b, d, ba, da, db] = self.0;
        Vector3::new(a * v.x, ba * v.x + b * v.y, da * v.x + db * v.y + d * v.z)
    }
}
