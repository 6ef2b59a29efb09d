//! The rigid motion between two sets of points.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Pose;

/// The rigid motion that takes `from` closest to `onto` in least squares.
///
/// `None` for no points. Where the points do not fix the rotation (fewer
/// than three, or on a line), the one whose z axis stays upright is taken.
pub fn fit_pose(from: &[Vector3<f64>], onto: &[Vector3<f64>]) -> Option<Pose> {
    let n = from.len().min(onto.len());
    if n == 0 {
        return None;
    }
    let mean = |v: &[Vector3<f64>]| v.iter().take(n).sum::<Vector3<f64>>() / n as f64;
    let (a, b) = (mean(from), mean(onto));
    let mut h = Matrix3::zeros();
    let mut size = 0.0;
    for (p, q) in from.iter().zip(onto) {
        h += (q - b) * (p - a).transpose();
        size += (p - a).norm_squared();
    }
    // Too weak to turn a fit that the points determine, enough to settle one that they do not.
    let mut upright = Matrix3::identity() * 0.1;
    upright[(2, 2)] = 1.0;
    h += upright * (1e-12 * (size + 1e-6));
    let svd = h.svd(true, true);
    let (u, vt) = (svd.u?, svd.v_t?);
    let mut flip = Matrix3::identity();
    flip[(2, 2)] = (u * vt).determinant().signum();
    let rotation = u * flip * vt;
    Some(Pose {
        rotation,
        position: b - rotation * a,
    })
}
