//! The rigid motion that brings one set of points best onto another.

use nalgebra::{Isometry3, Matrix3, Rotation3, Translation3, UnitQuaternion, Vector3};

/// The motion `g` that minimises `Σ |to_i − g from_i|²` (Kabsch's algorithm).
///
/// Points in any one unit; the translation comes in the same. With fewer than
/// three points, or points on a line, the rotation about it is arbitrary.
/// The shorter set rules; empty sets give the identity.
pub fn best_fit(from: &[[f64; 3]], to: &[[f64; 3]]) -> Isometry3<f64> {
    let n = from.len().min(to.len());
    if n == 0 {
        return Isometry3::identity();
    }
    let mean = |points: &[[f64; 3]]| points[..n].iter().map(|p| Vector3::from(*p)).sum::<Vector3<f64>>() / n as f64;
    let (a, b) = (mean(from), mean(to));
    let cross = from.iter().zip(to).fold(Matrix3::zeros(), |h: Matrix3<f64>, (p, q)| {
        h + (Vector3::from(*p) - a) * (Vector3::from(*q) - b).transpose()
    });
    let svd = cross.svd(true, true);
    let (Some(u), Some(v_t)) = (svd.u, svd.v_t) else {
        return Isometry3::from_parts(Translation3::from(b - a), UnitQuaternion::identity());
    };
    let turn = (v_t.transpose() * u.transpose()).determinant().signum();
    let rotation = v_t.transpose() * Matrix3::from_diagonal(&Vector3::new(1.0, 1.0, turn)) * u.transpose();
    let rotation = Rotation3::from_matrix_unchecked(rotation);
    Isometry3::from_parts(
        Translation3::from(b - rotation * a),
        UnitQuaternion::from_rotation_matrix(&rotation),
    )
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        // Fails if a motion is not recovered from the points that it moved.
        #[test]
        fn a_motion_is_recovered(axis in prop::array::uniform3(-3.0f64..3.0), shift in prop::array::uniform3(-2.0f64..2.0)) {
            let g = Isometry3::new(shift.into(), axis.into());
            let from = [[0.0, 0.0, 0.0], [0.3, 0.0, 0.1], [0.1, 0.4, 0.0], [0.2, -0.1, 0.5], [-0.3, 0.2, 0.2]];
            let to = from.map(|p| <[f64; 3]>::from((g * nalgebra::Point3::from(p)).coords));
            let found = best_fit(&from, &to);
            prop_assert!((found.to_homogeneous() - g.to_homogeneous()).norm() < 1e-12);
        }
    }
}
