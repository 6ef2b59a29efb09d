//! Rigid transforms as the robot files write them.
//!
//! A [`Pose`] of the shared crate is at once a frame seen from its parent and
//! the transform to it; here are its product, its inverse, and the roll, pitch
//! and yaw of URDF (`R = Rz(yaw) Ry(pitch) Rx(roll)`, fixed axes).

use nalgebra::{Matrix3, Vector3};
use spherecal_shared::robot::{MdhRow, Pose};
use spherecal_shared::scalar::Real;

/// The frame `b`, given in the frame `a`, seen from where `a` is given: `a · b`.
pub fn compose(a: &Pose<f64>, b: &Pose<f64>) -> Pose<f64> {
    Pose {
        rotation: a.rotation * b.rotation,
        position: a.point(&b.position),
    }
}

/// The transform back: `a⁻¹`.
pub fn inverse(a: &Pose<f64>) -> Pose<f64> {
    let rotation = a.rotation.transpose();
    Pose {
        rotation,
        position: -(rotation * a.position),
    }
}

/// The rotation about x by `angle` (rad).
pub fn rot_x(angle: f64) -> Matrix3<f64> {
    let (s, c) = exact_sin_cos(angle);
    Matrix3::new(1.0, 0.0, 0.0, 0.0, c, -s, 0.0, s, c)
}

/// The rotation about y by `angle` (rad).
pub fn rot_y(angle: f64) -> Matrix3<f64> {
    let (s, c) = exact_sin_cos(angle);
    Matrix3::new(c, 0.0, s, 0.0, 1.0, 0.0, -s, 0.0, c)
}

/// The rotation about z by `angle` (rad).
pub fn rot_z(angle: f64) -> Matrix3<f64> {
    let (s, c) = exact_sin_cos(angle);
    Matrix3::new(c, -s, 0.0, s, c, 0.0, 0.0, 0.0, 1.0)
}

/// The same sine and cosine as the robot model's, on every machine.
fn exact_sin_cos(angle: f64) -> (f64, f64) {
    angle.sin_cos_of()
}

/// The rotation about the unit vector `axis` by `angle` (rad): Rodrigues.
pub fn rot_axis(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let (s, c) = exact_sin_cos(angle);
    let k = axis.cross_matrix();
    Matrix3::identity() + k * s + k * k * (1.0 - c)
}

/// The rotation that URDF writes as `rpy` (rad).
pub fn from_rpy(rpy: [f64; 3]) -> Matrix3<f64> {
    rot_z(rpy[2]) * rot_y(rpy[1]) * rot_x(rpy[0])
}

/// Roll, pitch and yaw (rad) of a rotation; exact to round-off also where the
/// pitch is ±90 degrees, because the yaw is read after the roll is undone.
pub fn to_rpy(r: &Matrix3<f64>) -> [f64; 3] {
    let roll = r[(2, 1)].atan2(r[(2, 2)]);
    let pitch = (-r[(2, 0)]).atan2(r[(0, 0)].hypot(r[(1, 0)]));
    let (s, c) = exact_sin_cos(roll);
    let yaw = (s * r[(0, 2)] - c * r[(0, 1)]).atan2(c * r[(1, 1)] - s * r[(1, 2)]);
    [roll, pitch, yaw]
}

/// Roll, pitch and yaw (rad) of a rotation, nearest to those of a similar one.
///
/// A rotation is written with two triples (and their full turns); a file that is
/// corrected keeps the one that it was written with.
pub fn to_rpy_near(r: &Matrix3<f64>, like: [f64; 3]) -> [f64; 3] {
    use std::f64::consts::{PI, TAU};
    let near = |angle: f64, like: f64| angle + TAU * ((like - angle) / TAU).round();
    let [roll, pitch, yaw] = to_rpy(r);
    let candidates = [[roll, pitch, yaw], [roll + PI, PI - pitch, yaw + PI]].map(|rpy| {
        let mut out = [0.0; 3];
        for ((slot, angle), like) in out.iter_mut().zip(rpy).zip(like) {
            *slot = near(angle, like);
        }
        out
    });
    let off = |rpy: &[f64; 3]| -> f64 { rpy.iter().zip(like).map(|(a, b)| (a - b).powi(2)).sum() };
    let [first, second] = candidates;
    if off(&second) < off(&first) { second } else { first }
}

/// The constant part of one modified DH row, as a transform at joint angle `q` (rad).
pub fn row_transform(row: &MdhRow<f64>, q: f64) -> Pose<f64> {
    spherecal_shared::robot::kinematics::next_frame(&Pose::identity(), &row.into(), q)
}

/// The largest difference of two frames: position in m, or an entry of the
/// rotation, whichever is larger.
pub fn distance(a: &Pose<f64>, b: &Pose<f64>) -> f64 {
    (a.position - b.position).amax().max((a.rotation - b.rotation).amax())
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        /// Fails if the extraction loses an angle, gimbal lock included.
        #[test]
        fn rpy_goes_round(roll in -3.2..3.2_f64, yaw in -3.2..3.2_f64, pitch in -1.6..1.6_f64, lock in 0..3_u8) {
            let pitch = match lock {
                0 => pitch,
                1 => std::f64::consts::FRAC_PI_2 - pitch * 1e-9,
                _ => -std::f64::consts::FRAC_PI_2,
            };
            let r = from_rpy([roll, pitch, yaw]);
            prop_assert!((from_rpy(to_rpy(&r)) - r).amax() < 4e-16 * 4.0);
        }

        /// Fails if the nearest angles are another rotation, or further away than the file's own.
        #[test]
        fn rpy_stays_near_the_file_s(
            like in proptest::array::uniform3(-3.3..3.3_f64), pitch in -3.3..3.3_f64, step in proptest::array::uniform3(-1e-3..1e-3_f64)
        ) {
            let like = [like[0], pitch, like[2]];
            let is = [like[0] + step[0], like[1] + step[1], like[2] + step[2]];
            let r = from_rpy(is);
            let found = to_rpy_near(&r, like);
            prop_assert!((from_rpy(found) - r).amax() < 1e-14);
            // At a pitch of 90 degrees roll and yaw are one angle; away from it, the triple is the same.
            if pitch.cos().abs() > 0.1 {
                for (a, b) in found.iter().zip(is) {
                    prop_assert!((a - b).abs() < 1e-12, "{found:?} {is:?}");
                }
            }
        }

        /// Fails if product and inverse do not belong together.
        #[test]
        fn a_frame_times_its_inverse_is_nothing(a in -3.0..3.0_f64, b in -3.0..3.0_f64, x in -2.0..2.0_f64) {
            let frame = Pose { rotation: from_rpy([a, b, a * b]), position: Vector3::new(x, a, b) };
            prop_assert!(distance(&compose(&frame, &inverse(&frame)), &Pose::identity()) < 1e-14);
        }
    }
}
