//! The null space: a spring-damper on the motion that leaves the TCP in place.
//!
//! On an arm with seven joints this motion has one coordinate, the elbow angle
//! ([`spherecal_shared::robot::elbow`]), and the spring acts on that angle. It
//! thereby follows continuous inverse kinematics at the commanded elbow angle
//! without computing any. Shoulder and wrist of the arm may be offset. An arm whose
//! elbow angle is not defined, and one with more joints, is pulled to a posture.
//!
//! The projection is dynamically consistent: with `M = L Lᵀ`, the torque direction
//! `g` becomes `L (y − W Λ Wᵀ y)`, `y = L⁻¹ g`, `W = L⁻¹ Jᵀ`, which does not
//! accelerate the TCP.

use nalgebra::SVector;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::robot::elbow::{Elbow, elbow};
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;

/// Setpoint of the null space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NullSpace<const N: usize> {
    /// None: the arm is not redundant.
    Free,
    /// An elbow angle, its rate and its acceleration.
    Elbow {
        /// Elbow angle, in rad.
        angle: f64,
        /// Rate of the elbow angle, in rad/s.
        rate: f64,
        /// Acceleration of the elbow angle, in rad/s².
        acceleration: f64,
    },
    /// Joint angles, in rad.
    Posture([f64; N]),
}

/// The difference of two angles, in (−π, π].
fn difference(a: f64, b: f64) -> f64 {
    let turn = core::f64::consts::TAU;
    let d = a - b;
    d - turn * libm::round(d / turn)
}

impl<const N: usize> NullSpace<N> {
    /// Where the arm is: its elbow angle, or its posture where that is not defined.
    pub fn at(snapshot: &Snapshot<N>) -> Self {
        match elbow(&snapshot.frames) {
            Some(now) => Self::Elbow {
                angle: now.angle,
                rate: 0.0,
                acceleration: 0.0,
            },
            None if N > 6 => Self::Posture(snapshot.q),
            None => Self::Free,
        }
    }

    /// Torque of the null-space spring-damper, in N m. `stiffness` is in N m/rad,
    /// `ratio` is Lehr's damping ratio. An elbow turns the joint nearest to its limit of `limits` away
    /// from it.
    #[inline]
    pub fn torque(
        &self,
        snapshot: &Snapshot<N>,
        limits: &[JointLimits; N],
        stiffness: f64,
        ratio: f64,
    ) -> SVector<f64, N> {
        match self {
            Self::Free => SVector::zeros(),
            Self::Elbow {
                angle,
                rate,
                acceleration,
            } => match elbow(&snapshot.frames) {
                Some(now) => elbow_torque(snapshot, limits, &now, (*angle, *rate, *acceleration), stiffness, ratio),
                None => SVector::zeros(),
            },
            Self::Posture(posture) => {
                let pull = SVector::<f64, N>::from_fn(|i, _| {
                    let damping = 2.0 * ratio * sqrt(stiffness * snapshot.inertia[i]);
                    stiffness * (posture[i] - snapshot.q[i]) - damping * snapshot.dq[i]
                });
                unwhiten(snapshot, &project(snapshot, &snapshot.mass.solve_lower(&pull)))
            }
        }
    }

    /// Error of the elbow angle, in rad; 0 without an elbow angle.
    pub fn elbow_error(&self, snapshot: &Snapshot<N>) -> f64 {
        match (self, elbow(&snapshot.frames)) {
            (Self::Elbow { angle, .. }, Some(now)) => difference(*angle, now.angle),
            _ => 0.0,
        }
    }
}

/// The whitened torque less the part that accelerates the TCP.
#[inline]
fn project<const N: usize>(snapshot: &Snapshot<N>, y: &SVector<f64, N>) -> SVector<f64, N> {
    let force = snapshot.task_force(y);
    let mut out = *y;
    for k in 0..N {
        let mut sum = 0.0;
        for axis in 0..6 {
            sum += snapshot.whitened[(k, axis)] * force[axis];
        }
        out[k] -= sum;
    }
    out
}

/// `L y`: the joint torque of a whitened torque.
#[inline]
fn unwhiten<const N: usize>(snapshot: &Snapshot<N>, y: &SVector<f64, N>) -> SVector<f64, N> {
    let lower = snapshot.mass.lower();
    SVector::from_fn(|i, _| (0..=i).map(|k| lower[(i, k)] * y[k]).sum())
}

#[inline]
fn elbow_torque<const N: usize>(
    snapshot: &Snapshot<N>,
    limits: &[JointLimits; N],
    now: &Elbow<f64>,
    (angle, rate, acceleration): (f64, f64, f64),
    stiffness: f64,
    ratio: f64,
) -> SVector<f64, N> {
    let gradient = SVector::from(now.gradient(&snapshot.frames));
    let y = project(snapshot, &snapshot.mass.solve_lower(&gradient));
    // Mobility of the elbow angle in the null space: the inverse of its inertia.
    let mobility = y.norm_squared();
    if mobility < 1e-6 {
        return SVector::zeros();
    }
    let torque = unwhiten(snapshot, &y);
    // Rate of the angle within the null space: projected gradient times q̇.
    let lower = snapshot.mass.lower();
    let mut now_rate = 0.0;
    for i in 0..N {
        for k in 0..=i {
            now_rate += y[k] * lower[(i, k)] * snapshot.dq[i];
        }
    }
    let fastest = snapshot.fastest_rad_s * snapshot.fastest_rad_s / mobility;
    let stiffness = stiffness.min(fastest);
    let damping = 2.0 * ratio * sqrt(stiffness / mobility);
    let error = difference(angle, now.angle);
    let firm = ((FAR_RAD - error.abs()) / (FAR_RAD - FIRM_RAD)).max(0.0).min(1.0);
    let bounded = |torque: f64| torque.max(-MOST_NM).min(MOST_NM);
    let spring = firm * bounded(stiffness * error);
    let mut force = spring + damping * (rate - now_rate) + bounded(acceleration / mobility);
    if let Some((joint, inwards)) = nearest_to_its_limit(snapshot, limits) {
        // How the joint turns with the elbow, and its mobility in the null space.
        let ratio_of_joint = snapshot.mass.solve_upper(&y)[joint] / mobility;
        let mobility = ratio_of_joint * ratio_of_joint * mobility;
        if mobility > 1e-6 {
            let fastest = snapshot.fastest_rad_s * snapshot.fastest_rad_s / mobility;
            let stiffness = LIMIT_NM_RAD.min(fastest);
            // The damper begins with the spring.
            let share = (inwards.abs() / NEAR_RAD).min(1.0);
            let damping = share * 2.0 * ratio * sqrt(stiffness / mobility);
            force += ratio_of_joint * (stiffness * inwards - damping * ratio_of_joint * now_rate);
        }
    }
    torque * force
}

/// Largest torque of the spring of the elbow, and of what accelerates it, in N m: 100 N at an elbow that stands 0.25 m off its axis.
const MOST_NM: f64 = 25.0;
/// The spring of the elbow is whole up to this error, in rad, and pulls no more beyond the next one.
///
/// A turn is stopped long before. But an arm that is pushed through its stretched posture has its elbow on the
/// other side, half a turn off: the spring would turn joints 3 and 5 about each other with 150 N m.
const FIRM_RAD: f64 = 0.5;
const FAR_RAD: f64 = 1.0;

/// Distance from a joint's limit, in rad, from which on the elbow turns the joint away from it. The planner
/// keeps at least as much from every limit, so that a pose as planned is not changed.
///
/// An elbow rests where friction and the error of the mass model leave it. Near a singularity of the shoulder a
/// joint moves by more than the elbow, and reached its limit although the plan kept seven degrees from it.
const NEAR_RAD: f64 = 0.034;
/// Stiffness of that spring, in N m/rad. At the margin at which the controller stops its torque at the joint is
/// 7 N m; the elbow's own spring has 5 N m at its tolerance.
const LIMIT_NM_RAD: f64 = 300.0;

/// The joint nearest to its limit, if it is too near, and how far it should turn (rad, positive towards its
/// upper limit). One joint is enough: the null space has one coordinate.
#[inline]
fn nearest_to_its_limit<const N: usize>(snapshot: &Snapshot<N>, limits: &[JointLimits; N]) -> Option<(usize, f64)> {
    let (mut nearest, mut inwards) = (0, 0.0f64);
    for i in 0..N {
        let q = snapshot.q[i];
        let own = (limits[i].min_rad + NEAR_RAD - q).max(0.0) - (q - limits[i].max_rad + NEAR_RAD).max(0.0);
        if own.abs() > inwards.abs() {
            (nearest, inwards) = (i, own);
        }
    }
    (inwards != 0.0).then_some((nearest, inwards))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::Actuation;
    use crate::testing::NO_LIMITS;
    use proptest::prelude::*;
    use spherecal_shared::robot::{Arm, Dynamics, built_in, iiwa7_tool};

    /// Four real arms, and three with random geometry.
    fn arm(which: usize) -> Arm<f64, 7> {
        let names = ["iiwa7", "iiwa14", "fr3", "panda"];
        let mut robot = built_in(names.get(which).unwrap_or(&"iiwa14")).expect("a built-in robot");
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

    /// The self-motion at `q`: a joint velocity of length 1 with the TCP at rest.
    fn self_motion(jacobian: &nalgebra::SMatrix<f64, 6, 7>) -> SVector<f64, 7> {
        // Joint k is held by the cofactor: the generalised cross product.
        let velocity = SVector::<f64, 7>::from_fn(|k, _| {
            let sign = if k % 2 == 0 { 1.0 } else { -1.0 };
            sign * jacobian.remove_column(k).determinant()
        });
        velocity / velocity.norm()
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(400))]
        // Fails if the damping of the self-motion is not that of its inertia and of
        // the true rate of the elbow angle (by central differences), or if the
        // torque accelerates the TCP: with `I = q̇ᵀ M q̇ / rate²` it is
        // `−2 ζ √(k / I) M q̇`.
        #[test]
        fn the_self_motion_is_damped_on_every_arm(which in 0usize..7, q in prop::array::uniform7(-1.8f64..1.8)) {
            let arm = arm(which);
            let snapshot = Snapshot::new(&arm, &q, &[0.0; 7]).expect("a mass matrix");
            prop_assume!(!snapshot.near_singular);
            let motion = self_motion(&snapshot.jacobian);
            let at = |h: f64| elbow(&arm.frames(&core::array::from_fn(|i| q[i] + h * motion[i]))).map(|e| e.angle);
            let h = 1e-5;
            let (Some(now), Some(after), Some(before)) = (at(0.0), at(h), at(-h)) else {
                return Ok(());
            };
            let rate = difference(after, before) / (2.0 * h);
            prop_assume!(rate.abs() > 0.05 && rate.abs() < 20.0);
            let dq: [f64; 7] = motion.into();
            let moving = Snapshot::new(&arm, &q, &dq).expect("a mass matrix");
            let (stiffness, ratio) = (8.0, 0.7);
            let torque = NullSpace::Elbow { angle: now, rate: 0.0, acceleration: 0.0 }.torque(&moving, &[NO_LIMITS; 7], stiffness, ratio);
            let mut matrix = arm.bodies(&arm.frames(&q)).mass_matrix();
            arm.add_rotors(&mut matrix);
            let momentum = matrix * motion;
            let inertia = motion.dot(&momentum) / (rate * rate);
            let expected = momentum * (-2.0 * ratio * sqrt(stiffness / inertia));
            prop_assert!((torque - expected).norm() < 1e-3 * expected.norm(), "{torque} is not {expected}");
            // The spring pulls the elbow towards its angle, not away from it.
            let pull = NullSpace::Elbow { angle: now + 0.1, rate: 0.0, acceleration: 0.0 }.torque(&snapshot, &[NO_LIMITS; 7], stiffness, ratio);
            prop_assert!(pull.dot(&motion) * rate > 0.0);
        }

        // Fails if the elbow is accelerated by another acceleration than that of its setpoint, if that moves the TCP, or if
        // the torque is more than 25 N m of the elbow.
        #[test]
        fn the_elbow_is_accelerated_as_planned(
            which in 0usize..7,
            q in prop::array::uniform7(-1.8f64..1.8),
            acceleration in -3.0f64..3.0,
        ) {
            let snapshot = Snapshot::new(&arm(which), &q, &[0.0; 7]).expect("a mass matrix");
            prop_assume!(!snapshot.near_singular);
            let Some(now) = elbow(&snapshot.frames) else { return Ok(()) };
            let asked = NullSpace::Elbow { angle: now.angle, rate: 0.0, acceleration };
            let motion = snapshot.mass.solve(&asked.torque(&snapshot, &[NO_LIMITS; 7], 50.0, 0.7));
            prop_assert!((snapshot.jacobian * motion).norm() <= 1e-6 * (1.0 + motion.norm()));
            let gradient = SVector::from(now.gradient(&snapshot.frames));
            let is = gradient.dot(&motion);
            // Of 1 rad of error; 50 N m/rad of it are 25 N m at half a radian.
            let pulled = NullSpace::Elbow { angle: now.angle + 0.1, rate: 0.0, acceleration: 0.0 };
            let unit = snapshot.mass.solve(&pulled.torque(&snapshot, &[NO_LIMITS; 7], 50.0, 0.7)) / 5.0;
            let most = MOST_NM * gradient.dot(&unit);
            let expected = acceleration.max(-most).min(most);
            prop_assert!((is - expected).abs() < 1e-6 * (1.0 + expected.abs()), "{is} is not {expected} rad/s²");
        }

        // Fails if an elbow that is on the other side is pulled round, or if the spring is not that of its error
        // up to half a radian.
        #[test]
        fn an_elbow_far_from_its_angle_is_let_be(
            which in 0usize..7,
            q in prop::array::uniform7(-1.8f64..1.8),
            error in -3.1f64..3.1,
        ) {
            let snapshot = Snapshot::new(&arm(which), &q, &[0.0; 7]).expect("a mass matrix");
            prop_assume!(!snapshot.near_singular);
            let Some(now) = elbow(&snapshot.frames) else { return Ok(()) };
            let pull = |error: f64| {
                let angle = now.angle + error;
                NullSpace::Elbow { angle, rate: 0.0, acceleration: 0.0 }.torque(&snapshot, &[NO_LIMITS; 7], 50.0, 0.7)
            };
            let (torque, unit) = (pull(error), pull(0.1) / 0.1);
            let most = unit.norm() * FIRM_RAD;
            prop_assert!(torque.norm() <= most * (1.0 + 1e-9));
            if error.abs() >= FAR_RAD {
                prop_assert!(torque.norm() <= 1e-9 * most);
            } else if error.abs() <= FIRM_RAD {
                prop_assert!((torque - unit * error).norm() <= 1e-6 * most);
            }
        }

        // Fails if a joint near its limit is not turned away from it, if that moves the TCP, if the spring is
        // faster than the drive allows, or if joints farther from their limits are disturbed.
        #[test]
        fn the_elbow_turns_joints_away_from_their_limits(
            which in 0usize..7,
            q in prop::array::uniform7(-1.8f64..1.8),
            joint in 0usize..7,
            left_rad in 0.001f64..0.05,
            upper: bool,
            latency_s in 0.0f64..5e-3,
        ) {
            let arm = arm(which);
            let drive = Actuation::new([0.0; 7], 1e-3, latency_s);
            let snapshot = Snapshot::on(&drive, &arm, &q, &[0.0; 7]).expect("a mass matrix");
            prop_assume!(!snapshot.near_singular);
            let Some(now) = elbow(&snapshot.frames) else { return Ok(()) };
            let mut limits = [NO_LIMITS; 7];
            if upper {
                limits[joint].max_rad = q[joint] + left_rad;
            } else {
                limits[joint].min_rad = q[joint] - left_rad;
            }
            // At its angle the elbow's own spring is at rest.
            let rests = NullSpace::Elbow { angle: now.angle, rate: 0.0, acceleration: 0.0 };
            let torque = rests.torque(&snapshot, &limits, 50.0, 0.7);
            if left_rad >= NEAR_RAD {
                prop_assert!(torque.norm() == 0.0);
                return Ok(());
            }
            let acceleration = snapshot.mass.solve(&torque);
            let tcp = snapshot.jacobian * acceleration;
            prop_assert!(tcp.norm() <= 1e-6 * (1.0 + acceleration.norm()), "{tcp}");
            let inwards = if upper { -acceleration[joint] } else { acceleration[joint] };
            let depth = NEAR_RAD - left_rad;
            let most = drive.fastest_rad_s * drive.fastest_rad_s * depth;
            prop_assert!(inwards >= 0.0 && inwards <= most * (1.0 + 1e-9), "{inwards} of {most}");
            let motion = self_motion(&snapshot.jacobian);
            let moves = motion[joint].abs() > 0.05;
            prop_assert!(!moves || inwards > 0.0);
            if !moves {
                return Ok(());
            }
            // The spring and the damper by the joint's own mobility on the self-motion, at rest and turning.
            let mut matrix = arm.bodies(&arm.frames(&q)).mass_matrix();
            arm.add_rotors(&mut matrix);
            let mobility = motion[joint] * motion[joint] / motion.dot(&(matrix * motion));
            let stiffness = LIMIT_NM_RAD.min(drive.fastest_rad_s * drive.fastest_rad_s / mobility);
            let damping = (depth / NEAR_RAD).min(1.0) * 2.0 * 0.7 * sqrt(stiffness / mobility);
            let outwards = if upper { 1.0 } else { -1.0 };
            for speed in [0.0, 0.3, -0.3] {
                let dq = motion * speed;
                let moving = Snapshot::on(&drive, &arm, &q, &dq.into()).expect("a mass matrix");
                let own = rests.torque(&moving, &limits, 50.0, 0.7) - rests.torque(&moving, &[NO_LIMITS; 7], 50.0, 0.7);
                let is = moving.mass.solve(&own)[joint];
                let expected = -mobility * (stiffness * depth * outwards + damping * dq[joint]);
                prop_assert!((is - expected).abs() < 1e-5 * (1.0 + expected.abs()), "{is} is not {expected}");
            }
        }
    }
}
