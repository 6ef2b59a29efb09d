//! The elbow angle (swivel angle) of a spherical-rotational-spherical arm: the
//! "redundant alpha angle" of Section 4.2 and Figure 8 of the paper.
//!
//! Shoulder S, elbow E and wrist W are the origins of F2, F4 and F6. The elbow
//! angle is the angle of E about the line from S to W. It is zero with the elbow
//! up, that is in the half-plane of the vertical base axis, and grows by the
//! right-hand rule about S→W. Planner and controller use this one definition.

use nalgebra::Vector3;

use super::pose::Pose;
use crate::scalar::{Real, lit};

/// Position of the elbow on its circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elbow<T: Real> {
    /// Elbow angle, in rad, in (−π, π].
    pub angle: T,
    /// Radius of the elbow's circle, in m.
    pub radius: T,
    /// Unit tangent of the circle at the elbow, in F0, in the direction of growing
    /// angle.
    pub tangent: Vector3<T>,
    /// The elbow point E in F0, in m.
    pub point: Vector3<T>,
}

/// The elbow, from the poses of frames F1..F7 in F0.
///
/// `None` for an arm without seven joints, for a stretched arm (the radius of the
/// circle is below 1 mm) and if S-W is vertical (no reference plane).
#[inline]
pub fn elbow<T: Real>(frames: &[Pose<T>]) -> Option<Elbow<T>> {
    let [_, shoulder, _, elbow, _, wrist, _] = frames else {
        return None;
    };
    let tiny = lit::<T>(1e-6);
    let line = wrist.position - shoulder.position;
    let length2 = line.norm_squared();
    if !(length2 > tiny) {
        return None;
    }
    let n = line / length2.sqrt_of();
    // The base axis without its component along S-W: z − n n_z.
    let up = Vector3::new(-n.x * n.z, -n.y * n.z, T::one() - n.z * n.z);
    let arm = elbow.position - shoulder.position;
    let out = arm - n * n.dot(&arm);
    let radius2 = out.norm_squared();
    if !(radius2 > tiny) || !(up.norm_squared() > tiny) {
        return None;
    }
    let radius = radius2.sqrt_of();
    let tangent = n.cross(&out) / radius;
    let angle = n.dot(&up.cross(&out)).atan2(up.dot(&out));
    Some(Elbow {
        angle,
        radius,
        tangent,
        point: elbow.position,
    })
}
