//! Nominal kinematics of Panda and FR3: the robot computes `O_T_EE` with them from its measured joints.

use crate::JOINTS;
use crate::wire::IDENTITY;

/// Modified DH parameters after Craig: a (m), d (m), alpha (rad) of each joint. Both arms have the same.
const MDH: [(f64, f64, f64); JOINTS] = {
    use std::f64::consts::FRAC_PI_2;
    [
        (0.0, 0.333, 0.0),
        (0.0, 0.0, -FRAC_PI_2),
        (0.0, 0.316, FRAC_PI_2),
        (0.0825, 0.0, FRAC_PI_2),
        (-0.0825, 0.384, -FRAC_PI_2),
        (0.0, 0.0, FRAC_PI_2),
        (0.088, 0.0, FRAC_PI_2),
    ]
};
/// From joint 7 to the flange along its axis, m.
const FLANGE_M: f64 = 0.107;

/// The flange in the base frame, a column-major 4 x 4 matrix.
pub(super) fn flange(q: &[f64; JOINTS]) -> [f64; 16] {
    let mut pose = IDENTITY;
    for ((a, d, alpha), q) in MDH.iter().zip(q) {
        let ((sa, ca), (sq, cq)) = (alpha.sin_cos(), q.sin_cos());
        let link = [
            cq,
            sq * ca,
            sq * sa,
            0.0,
            -sq,
            cq * ca,
            cq * sa,
            0.0,
            0.0,
            -sa,
            ca,
            0.0,
            *a,
            -d * sa,
            d * ca,
            1.0,
        ];
        pose = product(&pose, &link);
    }
    for row in 0..3 {
        pose[12 + row] += FLANGE_M * pose[8 + row];
    }
    pose
}

pub(super) fn product(left: &[f64; 16], right: &[f64; 16]) -> [f64; 16] {
    let mut out = [0.0; 16];
    for column in 0..4 {
        for row in 0..4 {
            out[4 * column + row] = (0..4).map(|k| left[4 * k + row] * right[4 * column + k]).sum();
        }
    }
    out
}

pub(super) fn inverted(pose: &[f64; 16]) -> [f64; 16] {
    let mut out = [0.0; 16];
    for row in 0..3 {
        for column in 0..3 {
            out[4 * column + row] = pose[4 * row + column];
        }
        out[12 + row] = -(0..3).map(|k| pose[4 * row + k] * pose[12 + k]).sum::<f64>();
    }
    out[15] = 1.0;
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the kinematics disagree with the arm's known poses: stretched upwards, and the maker's ready pose.
    #[test]
    fn the_flange_is_where_it_is_known_to_be() {
        let pose = flange(&[0.0; 7]);
        let height = 0.333 + 0.316 + 0.384 - 0.107;
        assert!((pose[12] - 0.088).abs() < 1e-12 && pose[13].abs() < 1e-12 && (pose[14] - height).abs() < 1e-12);
        use std::f64::consts::{FRAC_PI_2, FRAC_PI_4};
        let ready = flange(&[0.0, -FRAC_PI_4, 0.0, -3.0 * FRAC_PI_4, 0.0, FRAC_PI_2, FRAC_PI_4]);
        assert!((ready[12] - 0.3069).abs() < 1e-3 && ready[13].abs() < 1e-12 && (ready[14] - 0.5903).abs() < 1e-3);
        // The flange looks down.
        assert!((ready[10] + 1.0).abs() < 1e-12);
    }
}
