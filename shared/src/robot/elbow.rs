//! The elbow angle (swivel angle) of an arm with seven joints: the "redundant alpha
//! angle" of Section 4.2 and Figure 8 of the paper.
//!
//! Shoulder S, elbow E and wrist W are the origins of F2, F4 and F6. The elbow
//! angle is the angle of E about the line from S to W. It is zero with the elbow
//! up, that is in the half-plane of the vertical base axis, and grows by the
//! right-hand rule about S→W. Planner and controller use this one definition.

use nalgebra::Vector3;

use super::pose::Pose;
use crate::scalar::{Real, lit};

/// The elbow angle and how it changes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Elbow<T: Real> {
    /// Elbow angle, in rad, in (−π, π].
    pub angle: T,
    /// Shoulder S, elbow E and wrist W in F0, in m.
    points: [Vector3<T>; 3],
    /// Derivative of the angle by the position of E relative to S, F0, in rad/m.
    rate_by_e: Vector3<T>,
    /// Derivative of the angle by the position of W relative to S, F0, in rad/m.
    rate_by_w: Vector3<T>,
}

impl<T: Real> Elbow<T> {
    /// Derivative of the elbow angle by the angle of each joint, in rad/rad, from
    /// the frames that the elbow was computed from.
    ///
    /// It holds for every arm with seven joints: shoulder and wrist may be offset,
    /// so that all three points move. On the self-motion of the arm its product with
    /// the joint velocities is the rate of the elbow angle.
    #[inline]
    pub fn gradient<const N: usize>(&self, frames: &[Pose<T>; N]) -> [T; N] {
        let [shoulder, elbow, wrist] = &self.points;
        let mut gradient = [T::zero(); N];
        // Each joint turns the points beyond it: F2 is beyond 1, F4 beyond 3, F6
        // beyond 5. The origin of a frame lies on its own axis.
        for (i, (slot, frame)) in gradient.iter_mut().zip(frames).enumerate().take(5) {
            let axis = frame.z();
            let moved = |point: &Vector3<T>| axis.cross(&(point - frame.position));
            let base = if i < 1 { moved(shoulder) } else { Vector3::zeros() };
            let mut rate = self.rate_by_w.dot(&(moved(wrist) - base));
            let elbow = if i < 3 { moved(elbow) } else { Vector3::zeros() };
            rate += self.rate_by_e.dot(&(elbow - base));
            *slot = rate;
        }
        gradient
    }
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
    let length = length2.sqrt_of();
    let n = line / length;
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
    // A motion of W turns the line S-W, and with it the elbow (which stays in place)
    // and the reference: the angle changes by the difference of the two turns.
    let tangent_up = n.cross(&up) / up.norm_squared();
    let rate_by_e = tangent / radius;
    let rate_by_w = (tangent_up * n.z - rate_by_e * n.dot(&arm)) / length;
    Some(Elbow {
        angle,
        points: [shoulder.position, elbow.position, wrist.position],
        rate_by_e,
        rate_by_w,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::robot::{Arm, built_in, iiwa7_tool};
    use proptest::prelude::*;

    /// The arms of the tests: four real ones, and three with random geometry.
    fn arm(which: usize) -> Arm<f64, 7> {
        let names = ["iiwa7", "iiwa14", "fr3", "panda"];
        let mut robot = built_in(names.get(which).unwrap_or(&"iiwa7")).expect("a built-in robot");
        if which >= names.len() {
            for (i, joint) in robot.joints.iter_mut().enumerate() {
                let random = |k: usize| libm::sin((1 + which * 31 + i * 7 + k * 3) as f64 * 12.9898);
                joint.mdh.alpha += 0.3 * random(0);
                joint.mdh.a += 0.1 * random(1);
                joint.mdh.d += 0.1 * random(2);
            }
        }
        Arm::new(&robot, &iiwa7_tool()).expect("an arm")
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]
        // Against central differences of the angle. Fails if the gradient takes
        // shoulder or wrist of an arm for fixed, or the reference plane.
        #[test]
        fn the_gradient_is_the_derivative_of_the_angle(which in 0usize..7, q in prop::array::uniform7(-2.0f64..2.0)) {
            let arm = arm(which);
            let frames = arm.frames(&q);
            let now = elbow(&frames);
            let far = now.is_some_and(|e| e.rate_by_e.norm() < 20.0 && e.rate_by_w.norm() < 20.0);
            prop_assume!(far);
            let gradient = now.map(|e| e.gradient(&frames)).unwrap_or_default();
            for i in 0..7 {
                let h = 1e-5;
                let at = |step: f64| {
                    let mut q = q;
                    q[i] += step;
                    elbow(&arm.frames(&q)).map(|e| e.angle)
                };
                let (Some(after), Some(before)) = (at(h), at(-h)) else { continue };
                let turn = core::f64::consts::TAU;
                let change = after - before;
                let rate = (change - turn * libm::round(change / turn)) / (2.0 * h);
                prop_assert!((rate - gradient[i]).abs() < 1e-4, "joint {}: {rate} is not {}", i + 1, gradient[i]);
            }
        }
    }
}
