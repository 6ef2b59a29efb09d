//! The Cartesian spring-damper: `F = K e + D (v_d − v)` at the TCP.

use nalgebra::{Matrix3, Vector3, Vector6};

use super::damping::Damping;
use super::snapshot::Snapshot;
use super::stiffness::Stiffness;

/// Setpoint of the Cartesian spring: the pose that the TCP is pulled to, in F0.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CartesianSetpoint {
    /// Position, in m.
    pub position: Vector3<f64>,
    /// Orientation.
    pub rotation: Matrix3<f64>,
    /// Velocity: linear in m/s, angular in rad/s.
    pub velocity: Vector6<f64>,
    /// Angular acceleration, in rad/s². A tool that turns about a TCP at rest is accelerated with it
    /// ([`Impedance::seated_force`]).
    pub acceleration: Vector3<f64>,
    /// Force and torque added to those of the spring, in N and N m.
    pub feed_forward: Vector6<f64>,
}

impl CartesianSetpoint {
    /// A setpoint at rest.
    pub fn at(position: Vector3<f64>, rotation: Matrix3<f64>) -> Self {
        Self {
            position,
            rotation,
            velocity: Vector6::zeros(),
            acceleration: Vector3::zeros(),
            feed_forward: Vector6::zeros(),
        }
    }
}

/// Rotation vector from `actual` to `desired` in F0, in rad: the logarithm of
/// `R_d Rᵀ`.
#[inline]
pub fn rotation_error(desired: &Matrix3<f64>, actual: &Matrix3<f64>) -> Vector3<f64> {
    // Of R_d R^T only the skew part and the trace, which the logarithm needs.
    let mut skew = Vector3::zeros();
    let mut trace = 0.0;
    for k in 0..3 {
        let d = desired.column(k);
        let a = actual.column(k);
        skew.x += d[2] * a[1] - d[1] * a[2];
        skew.y += d[0] * a[2] - d[2] * a[0];
        skew.z += d[1] * a[0] - d[0] * a[1];
        trace += d[0] * a[0] + d[1] * a[1] + d[2] * a[2];
    }
    let sine = 0.5 * skew.norm();
    let cosine = 0.5 * (trace - 1.0);
    // angle / (2 sin angle), which tends to 1/2 for small angles (to 1e-13).
    // Near half a turn the axis is undefined; the lower bound on the sine bounds
    // the error.
    let factor = if sine < 1e-6 && cosine > 0.0 {
        0.5
    } else {
        0.5 * libm::atan2(sine, cosine) / sine.max(1e-6)
    };
    skew * factor
}

/// Rotation by `angle` (rad) about a unit axis (Rodrigues): the exponential that
/// belongs to [`rotation_error`].
#[inline]
pub fn rotation_about(axis: &Vector3<f64>, angle: f64) -> Matrix3<f64> {
    let (s, c) = libm::sincos(angle);
    let k = axis.cross_matrix();
    Matrix3::identity() + k * s + k * k * (1.0 - c)
}

/// The Cartesian impedance: the present stiffness, its ramp and the damping.
#[derive(Clone, Debug)]
pub struct Impedance {
    stiffness: Stiffness,
    from: Stiffness,
    to: Stiffness,
    share: f64,
    rate: f64,
    damping: Damping,
}

impl Impedance {
    /// An impedance with the given stiffness.
    pub fn new(stiffness: Stiffness) -> Self {
        Self {
            stiffness,
            from: stiffness,
            to: stiffness,
            share: 1.0,
            rate: 1.0,
            damping: Damping::default(),
        }
    }

    /// Starts a ramp to `stiffness` over `ramp_s` seconds, in ticks of `period_s`.
    pub fn ramp_to(&mut self, stiffness: Stiffness, ramp_s: f64, period_s: f64) {
        self.from = self.stiffness;
        self.to = stiffness;
        self.share = 0.0;
        self.rate = if ramp_s > period_s { period_s / ramp_s } else { 1.0 };
    }

    /// Whether the stiffness ramp is over.
    pub fn settled(&self) -> bool {
        self.share >= 1.0
    }

    /// The present stiffness.
    pub fn stiffness(&self) -> &Stiffness {
        &self.stiffness
    }

    /// Force of the spring-damper on the TCP, F0, in N and N m. Advances the
    /// stiffness ramp by one tick. `ratio` is Lehr's damping ratio.
    #[inline]
    pub fn force<const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        setpoint: &CartesianSetpoint,
        ratio: f64,
    ) -> Vector6<f64> {
        let (error, velocity_error) = self.errors(snapshot, setpoint);
        let damping = self
            .damping
            .force(snapshot, &self.stiffness, ratio, &error, &velocity_error);
        self.stiffness.times(&error) + damping + setpoint.feed_forward
    }

    /// As [`force`](Self::force), for a tool that may turn about a TCP at rest: the nest is on a sphere.
    ///
    /// The moment of the rotational spring alone accelerates the TCP, too, because the arm's
    /// centre of inertia is elsewhere. What holds the TCP would have to react: with
    /// visible motors 18 N were measured on the sphere, where the magnet holds 26.5 N. So the law adds the
    /// force that leaves the TCP at rest (`Snapshot::reaction`). Spring and damper of the position
    /// and those of the orientation act each for itself.
    ///
    /// Friction stops the tool a little before its orientation, so the moment stays when the turn has ended. If its
    /// reaction went away then, the sphere would have to carry it: 21 N were measured on a stretched arm with
    /// 2 N m of friction.
    #[inline]
    pub fn seated_force<const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        setpoint: &CartesianSetpoint,
        ratio: f64,
    ) -> Vector6<f64> {
        let (error, velocity_error) = self.errors(snapshot, setpoint);
        let frequency = self.damping.update(snapshot, &self.stiffness);
        let part = |first: usize| {
            let of = |all: &Vector6<f64>| Vector6::from_fn(|i, _| if i / 3 == first { all[i] } else { 0.0 });
            let (error, velocity_error) = (of(&error), of(&velocity_error));
            self.stiffness.times(&error)
                + self
                    .damping
                    .of_modes(snapshot, &frequency, ratio, &error, &velocity_error)
        };
        let (linear, angular) = (part(0), part(1));
        let spring = Vector3::new(angular[3], angular[4], angular[5]);
        let moment = spring + ahead(snapshot, &setpoint.acceleration, &self.stiffness);
        let reaction = snapshot.reaction(&moment);
        let force = Vector3::new(linear[0], linear[1], linear[2]) + reaction;
        Vector6::new(force.x, force.y, force.z, moment.x, moment.y, moment.z) + setpoint.feed_forward
    }

    /// Errors of pose and velocity, linear part first. Advances the stiffness ramp by one tick.
    #[inline]
    fn errors<const N: usize>(
        &mut self,
        snapshot: &Snapshot<N>,
        setpoint: &CartesianSetpoint,
    ) -> (Vector6<f64>, Vector6<f64>) {
        if self.share < 1.0 {
            self.share = (self.share + self.rate).min(1.0);
            self.stiffness = Stiffness::between(&self.from, &self.to, self.share);
        }
        let position = setpoint.position - snapshot.tcp.position;
        let rotation = rotation_error(&setpoint.rotation, &snapshot.tcp.rotation);
        let error = Vector6::new(position.x, position.y, position.z, rotation.x, rotation.y, rotation.z);
        (error, setpoint.velocity - snapshot.velocity)
    }
}

/// Largest moment that the law adds for the acceleration of a turn, as an angle of its rotational spring, in rad: five
/// times the tolerance at the end of a turn. Near singularities the inertia has no bound.
const MOST_AHEAD_RAD: f64 = 0.1;

/// Moment (F0, in N m) that accelerates the tool by `acceleration` (F0, in rad/s²) about a TCP at rest. The spring alone
/// would lag by `acceleration / ω²`, and swing this out when the turn has ended: 1 s of a turn of 2 s.
#[inline]
fn ahead<const N: usize>(snapshot: &Snapshot<N>, acceleration: &Vector3<f64>, stiffness: &Stiffness) -> Vector3<f64> {
    // The inertia of the rotation, with the force that leaves the TCP at rest, is the last block of the inverse mobility.
    let a = acceleration;
    let wrench = snapshot.mobility.solve(&Vector6::new(0.0, 0.0, 0.0, a.x, a.y, a.z));
    let moment = Vector3::new(wrench[3], wrench[4], wrench[5]);
    let most = MOST_AHEAD_RAD * stiffness.rotation;
    moment * (most / moment.norm().max(most))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    // Fails if an axis without stiffness has no damping: a soft arm would drift on.
    #[test]
    fn an_axis_without_stiffness_is_damped_too() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let snapshot = Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix");
        let mut impedance = Impedance::new(Stiffness::isotropic(0.0, 200.0));
        let mut setpoint = CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation);
        for _ in 0..30 {
            impedance.force(&snapshot, &setpoint, 0.7);
        }
        for axis in 0..3 {
            setpoint.velocity = Vector6::zeros();
            setpoint.velocity[axis] = 1.0;
            let force = impedance.force(&snapshot, &setpoint, 0.7);
            assert!(force[axis] > 0.3, "axis {axis}: {force:?}");
        }
    }

    // Fails if a tool that is where it should be is accelerated otherwise than its setpoint, or its TCP with it, with motors
    // or without.
    #[test]
    fn a_turn_is_accelerated_as_planned() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        for motors in [[0.0; 7], [0.46, 1.1, 0.8, 0.45, 0.35, 0.35, 0.35]] {
            let drive = crate::Actuation::new(motors, 1e-3, 0.0);
            let snapshot = Snapshot::on(&drive, &arm, &HOME, &[0.0; 7]).expect("a mass matrix");
            let mut setpoint = CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation);
            setpoint.acceleration = Vector3::new(1.1, -0.7, 1.9);
            let force = Impedance::new(Stiffness::isotropic(20.0, 200.0)).seated_force(&snapshot, &setpoint, 0.7);
            let is = snapshot.jacobian * snapshot.mass.solve(&snapshot.joint_torque(&force));
            assert!(is.fixed_rows::<3>(0).norm() < 1e-9, "{is}");
            assert!((is.fixed_rows::<3>(3) - setpoint.acceleration).norm() < 1e-9, "{is}");
            // Bounded: no more than the spring has at 0.1 rad.
            setpoint.acceleration *= 1e4;
            let force = Impedance::new(Stiffness::isotropic(20.0, 200.0)).seated_force(&snapshot, &setpoint, 0.7);
            assert!((force.fixed_rows::<3>(3).norm() - 20.0).abs() < 1e-9, "{force}");
        }
    }

    // Fails if the force of a turn accelerates the TCP, at rest or in motion, with motors or without.
    #[test]
    fn a_turn_leaves_the_tcp_at_rest() {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        for (motors, dq) in [
            ([0.0; 7], [0.0; 7]),
            (
                [0.46, 1.1, 0.8, 0.45, 0.35, 0.35, 0.35],
                [0.7, 0.1, -0.7, 0.2, 0.3, -0.2, 0.5],
            ),
        ] {
            let drive = crate::Actuation::new(motors, 1e-3, 0.0);
            let snapshot = Snapshot::on(&drive, &arm, &HOME, &dq).expect("a mass matrix");
            let mut setpoint = CartesianSetpoint::at(snapshot.tcp.position, snapshot.tcp.rotation);
            setpoint.velocity = snapshot.velocity;
            setpoint.velocity[3] += 0.3;
            setpoint.velocity[5] -= 0.2;
            // Of the acceleration J q̈ + J̇ q̇; the second by central differences of J q̇.
            let accelerated = |force: &Vector6<f64>| {
                let h = 1e-6;
                let velocity = |t: f64| {
                    let q = core::array::from_fn(|i| HOME[i] + t * dq[i]);
                    Snapshot::new(&arm, &q, &dq).expect("a mass matrix").velocity
                };
                let drift = (velocity(h) - velocity(-h)) / (2.0 * h);
                let acceleration = snapshot.jacobian * snapshot.mass.solve(&snapshot.joint_torque(force)) + drift;
                acceleration.fixed_rows::<3>(0).norm()
            };
            let mut impedance = Impedance::new(Stiffness::isotropic(20.0, 200.0));
            let plain = accelerated(&impedance.force(&snapshot, &setpoint, 0.7));
            let force = impedance.seated_force(&snapshot, &setpoint, 0.7);
            assert!(accelerated(&force) < 1e-6, "{}", accelerated(&force));
            assert!(plain > 0.1, "nothing to do: {plain} m/s²");
        }
    }
}
