//! Order statistics, and the rigid motion between two sets of points.

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::Pose;

/// The median: the mean of the middle two for an even number; 0 for an empty list.
pub fn median(mut values: Vec<f64>) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => 0.0,
        _ if n % 2 == 1 => values[n / 2],
        _ => f64::midpoint(values[n / 2 - 1], values[n / 2]),
    }
}

/// The value below which a `share` (0 to 1) of sorted values is, between neighbours in proportion; 0 for an empty list.
pub fn quantile(sorted: &[f64], share: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else {
        return 0.0;
    };
    let place = share.clamp(0.0, 1.0) * last as f64;
    let (low, part) = (place.floor() as usize, place.fract());
    sorted[low] + part * (sorted[(low + 1).min(last)] - sorted[low])
}

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

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the middle is taken wrongly for an odd, an even or no number of values, or a share between two values.
    #[test]
    fn the_middle_and_the_shares() {
        assert_eq!(median(vec![3.0, 1.0, 2.0]), 2.0);
        assert_eq!(median(vec![4.0, 1.0, 3.0, 2.0]), 2.5);
        assert_eq!((median(Vec::new()), quantile(&[], 0.5)), (0.0, 0.0));
        let sorted = [1.0, 2.0, 4.0];
        assert_eq!(
            [0.0, 0.25, 0.5, 0.75, 1.0].map(|share| quantile(&sorted, share)),
            [1.0, 1.5, 2.0, 3.0, 4.0]
        );
    }
}
