//! The elbow (swivel) angle of a spherical-rotational-spherical arm: the
//! "redundant alpha angle" of Section 4.2 and Figure 8 of the paper.
//!
//! Shoulder S, elbow E and wrist W are the origins of F2, F4 and F6. The angle
//! is that of E about the line S-W, from the half-plane that holds the vertical
//! base axis: zero with the elbow up, positive by the right-hand rule about
//! S→W. Planner and controller share this definition.

use nalgebra::Vector3;

use super::kinematics::Frame;
use crate::scalar::{Real, lit};

/// The elbow's place on its circle.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elbow<T: Real> {
    /// Elbow angle, in rad, in (−π, π].
    pub angle: T,
    /// Radius of the elbow's circle, in m.
    pub radius: T,
    /// Unit tangent of the circle at the elbow, in F0, towards growing angle.
    pub tangent: Vector3<T>,
    /// The elbow point E in F0, in m.
    pub point: Vector3<T>,
}

/// Elbow angle from the frames F1..F7.
///
/// `None` for an arm without seven joints, with the arm stretched (the circle
/// has no radius: under 1 mm) or with S-W vertical (no reference plane).
#[inline]
pub fn elbow<T: Real>(frames: &[Frame<T>]) -> Option<Elbow<T>> {
    let [_, shoulder, _, elbow, _, wrist, _] = frames else {
        return None;
    };
    let tiny = lit::<T>(1e-6);
    let line = wrist.origin - shoulder.origin;
    let length2 = line.norm_squared();
    if !(length2 > tiny) {
        return None;
    }
    let n = line / length2.sqrt_of();
    // The base axis without its part along S-W: (z − n n_z).
    let up = Vector3::new(-n.x * n.z, -n.y * n.z, T::one() - n.z * n.z);
    let arm = elbow.origin - shoulder.origin;
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
        point: elbow.origin,
    })
}
