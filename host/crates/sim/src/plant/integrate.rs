//! Advances the plant's state by one sub-step.
//!
//! **Free space**: classic Runge-Kutta of order 4 on `M q̈ = tau − c − g − b q̇`. The motion is
//! smooth, so one step per control tick conserves energy to far better than 1e-6 over a second.
//!
//! **Contact, or dry joint friction**: linearly implicit (semi-implicit Euler with the stiff forces
//! at the end of the step):
//!
//! `(M + h D + h² K) Δv = h (tau − c − g + f − h K v)`, then `q += h (v + Δv)`
//!
//! with `K`, `D` of the pads, of regularised friction and of the joint springs. It is stable for
//! any pad stiffness, friction slope and sub-step, and only ever damps the stiff parts. Dry joint
//! friction follows Coulomb's law exactly, except for a creep of 1 µrad/s: each joint either sticks
//! (a very steep viscous law) or slips (constant torque). A small active-set iteration on the
//! velocity at the end of the step decides which.
//!
//! With joint elasticity the motors are eliminated joint by joint (a Schur
//! complement on the diagonal), so the system stays N by N.

use nalgebra::{SMatrix, SVector, Vector3};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Bodies, Dynamics, Pose};

use super::contact::{ContactPoint, Touches};
use super::dry_friction::{Slip, friction_terms, settle_modes};

/// Stiffness and damping of the mechanical end stops, N m/rad and N m s/rad.
const STOP: (f64, f64) = (2e4, 200.0);

/// Travel beyond the joint limit before the end stop, in rad.
pub(super) const STOP_MARGIN_RAD: f64 = 0.035;

/// Positions and velocities.
#[derive(Clone, Debug)]
pub(super) struct MotionState<const N: usize> {
    /// Link angles, in rad.
    pub(super) q: SVector<f64, N>,
    /// Link velocities, in rad/s.
    pub(super) v: SVector<f64, N>,
    /// Motor angles reflected to the link, in rad (equal to `q` without elasticity).
    pub(super) motor: SVector<f64, N>,
    /// Motor velocities, in rad/s.
    pub(super) motor_v: SVector<f64, N>,
    /// How each joint slips.
    pub(super) slip: Slip<N>,
    /// Mass matrix and bias of the previous sub-step, if it was a stiff one.
    before: Option<(SMatrix<f64, N, N>, SVector<f64, N>)>,
}

/// What a joint is made of besides its link.
#[derive(Clone, Debug)]
pub(super) struct JointMechanics<const N: usize> {
    pub(super) coulomb: [f64; N],
    pub(super) viscous: [f64; N],
    /// Share of friction beyond the torque sensor.
    pub(super) beyond_sensor: f64,
    pub(super) rotor: [f64; N],
    pub(super) elastic: Option<Elastic<N>>,
    /// End stops, in rad.
    pub(super) stops: [(f64, f64); N],
}

/// Joint elasticity.
#[derive(Clone, Debug)]
pub(super) struct Elastic<const N: usize> {
    /// Stiffness of each joint, in N m/rad.
    pub(super) stiffness: [f64; N],
    /// Damping of the springs, in N m s/rad.
    pub(super) damping: [f64; N],
    pub(super) motor: [f64; N],
}

/// External forces on the arm during one sub-step.
pub(super) struct ExternalForces<'a, const N: usize> {
    /// Actuator torque, in N m.
    pub(super) tau: &'a SVector<f64, N>,
    /// External torque on the links (disturbance), in N m.
    pub(super) extra: &'a SVector<f64, N>,
    /// Forces at points: point in F0 (m), force (N).
    pub(super) pulls: &'a [(Vector3<f64>, Vector3<f64>)],
    /// Free moment on the last link, in N m, F0.
    pub(super) moment: Vector3<f64>,
    /// Contact points.
    pub(super) touches: &'a Touches,
}

impl<const N: usize> MotionState<N> {
    pub(super) fn at_rest(q: &[f64; N]) -> Self {
        Self {
            q: SVector::from(*q),
            v: SVector::zeros(),
            motor: SVector::from(*q),
            motor_v: SVector::zeros(),
            slip: Slip([0.0; N]),
            before: None,
        }
    }

    /// Stops all motion at once.
    pub(super) fn brake(&mut self) {
        self.v = SVector::zeros();
        self.motor_v = SVector::zeros();
        self.slip = Slip([0.0; N]);
        self.before = None;
    }

    /// One explicit step in free space from the frames `start` of the present angles, under the
    /// torque `tau`. Returns the mean torque that the sensors see; `None` if the mass matrix is not
    /// positive definite.
    pub(super) fn step_free(
        &mut self,
        arm: &Arm<f64, N>,
        start: &[Pose<f64>; N],
        joints: &JointMechanics<N>,
        tau: &SVector<f64, N>,
        h: f64,
    ) -> Option<SVector<f64, N>> {
        let rate = |frames: &[Pose<f64>; N], v: &SVector<f64, N>| -> Option<SVector<f64, N>> {
            let bodies = arm.bodies(frames);
            let mut mass = bodies.mass_matrix();
            for i in 0..N {
                mass[(i, i)] += joints.rotor[i];
            }
            let mut torque = tau - bodies.coriolis(&v.data.0[0]) - bodies.gravity();
            for i in 0..N {
                torque[i] -= joints.viscous[i] * v[i];
            }
            Some(Cholesky::new(&mass)?.solve(&torque))
        };
        let (q0, v0) = (self.q, self.v);
        let a1 = rate(start, &v0)?;
        let (q2, v2) = (q0 + v0 * (h / 2.0), v0 + a1 * (h / 2.0));
        let a2 = rate(&arm.frames(&q2.data.0[0]), &v2)?;
        let (q3, v3) = (q0 + v2 * (h / 2.0), v0 + a2 * (h / 2.0));
        let a3 = rate(&arm.frames(&q3.data.0[0]), &v3)?;
        let (q4, v4) = (q0 + v3 * h, v0 + a3 * h);
        let a4 = rate(&arm.frames(&q4.data.0[0]), &v4)?;
        let travel = (v0 + (v2 + v3) * 2.0 + v4) * (h / 6.0);
        let change = (a1 + (a2 + a3) * 2.0 + a4) * (h / 6.0);
        self.q = q0 + travel;
        self.v = v0 + change;
        self.motor = self.q;
        self.motor_v = self.v;
        self.before = None;
        let gear = 1.0 - joints.beyond_sensor;
        Some(SVector::from_fn(|i, _| {
            tau[i] - (joints.rotor[i] * change[i] + gear * joints.viscous[i] * travel[i]) / h
        }))
    }

    /// One linearly implicit step. Returns the torque that the sensors see; `None` if the system is
    /// not positive definite.
    pub(super) fn step_stiff(
        &mut self,
        frames: &[Pose<f64>; N],
        bodies: &Bodies<f64, N>,
        joints: &JointMechanics<N>,
        load: &ExternalForces<'_, N>,
        h: f64,
    ) -> Option<SVector<f64, N>> {
        let (mass, bias) = (
            bodies.mass_matrix(),
            bodies.coriolis(&self.v.data.0[0]) + bodies.gravity(),
        );
        // Extrapolated to the middle of the step: second order for the smooth parts.
        let (mut system, middle) = match &self.before {
            Some((mass_before, bias_before)) => (mass * 1.5 - mass_before * 0.5, bias * 1.5 - bias_before * 0.5),
            None => (mass, bias),
        };
        self.before = Some((mass, bias));
        let mut impulse = (load.extra - middle) * h;
        for (point, force) in load.pulls {
            for i in 0..N {
                impulse[i] += h * frames[i].z().dot(&(point - frames[i].position).cross(force));
            }
        }
        if load.moment != Vector3::zeros() {
            for i in 0..N {
                impulse[i] += h * frames[i].z().dot(&load.moment);
            }
        }
        let mut pressed = false;
        for touch in load.touches {
            pressed |= add_touch(touch, frames, &self.v, h, &mut system, &mut impulse);
        }
        for i in 0..N {
            let (low, high) = joints.stops[i];
            let beyond = (self.q[i] - high).max(0.0) + (self.q[i] - low).min(0.0);
            if beyond != 0.0 {
                let (k, d) = STOP;
                impulse[i] -= h * (k * (beyond + h * self.v[i]) + d * self.v[i]);
                system[(i, i)] += h * d + h * h * k;
            }
        }
        match &joints.elastic {
            None => self.advance_rigid(joints, load.tau, system, impulse, pressed, h),
            Some(elastic) => self.advance_elastic(joints, elastic, load.tau, system, impulse, h),
        }
    }

    /// Joint friction and rotors on the links themselves.
    fn advance_rigid(
        &mut self,
        joints: &JointMechanics<N>,
        tau: &SVector<f64, N>,
        mut system: SMatrix<f64, N, N>,
        mut impulse: SVector<f64, N>,
        pressed: bool,
        h: f64,
    ) -> Option<SVector<f64, N>> {
        impulse += tau * h;
        for i in 0..N {
            let b = joints.viscous[i];
            system[(i, i)] += joints.rotor[i] + h * b;
            impulse[i] -= h * b * self.v[i];
        }
        let before = self.v;
        let change = self.slip.solve(&joints.coulomb, &system, &impulse, &before, h)?;
        self.v += change;
        // With contact, the end velocity, for which the implicit forces are written. Without
        // contact, the mean of both ends, which is of second order.
        self.q += if pressed {
            self.v * h
        } else {
            (before + self.v) * (h / 2.0)
        };
        self.motor = self.q;
        self.motor_v = self.v;
        let gear = 1.0 - joints.beyond_sensor;
        Some(SVector::from_fn(|i, _| {
            let friction = joints.viscous[i] * self.v[i] + self.slip.dry(joints.coulomb[i], i, self.v[i]);
            tau[i] - joints.rotor[i] * change[i] / h - gear * friction
        }))
    }

    /// Friction and rotors on the motors, springs to the links.
    fn advance_elastic(
        &mut self,
        joints: &JointMechanics<N>,
        elastic: &Elastic<N>,
        tau: &SVector<f64, N>,
        mut system: SMatrix<f64, N, N>,
        mut impulse: SVector<f64, N>,
        h: f64,
    ) -> Option<SVector<f64, N>> {
        let slopes: [f64; N] = core::array::from_fn(|i| h * (h * elastic.stiffness[i] + elastic.damping[i]));
        let wind = |s: &Self, i: usize| {
            elastic.stiffness[i] * (s.motor[i] - s.q[i] + h * (s.motor_v[i] - s.v[i]))
                + elastic.damping[i] * (s.motor_v[i] - s.v[i])
        };
        let base = system;
        let impulse_base = impulse;
        let mut modes = self.slip.0;
        for _ in 0..6 {
            system = base;
            impulse = impulse_base;
            let mut motor_inertia = [0.0; N];
            let mut motor_impulse = [0.0; N];
            for i in 0..N {
                let (spring, slope) = (wind(self, i), slopes[i]);
                let (stick, drag) = friction_terms(joints.coulomb[i], modes[i], self.motor_v[i]);
                motor_inertia[i] = elastic.motor[i] + slope + h * (joints.viscous[i] + stick);
                motor_impulse[i] = h * (tau[i] - spring - joints.viscous[i] * self.motor_v[i] - drag);
                system[(i, i)] += slope - slope * slope / motor_inertia[i];
                impulse[i] += h * spring + slope * motor_impulse[i] / motor_inertia[i];
            }
            let change = Cholesky::new(&system)?.solve(&impulse);
            let motor_change =
                SVector::<f64, N>::from_fn(|i, _| (motor_impulse[i] + slopes[i] * change[i]) / motor_inertia[i]);
            let settled = settle_modes(&joints.coulomb, &mut modes, &(self.motor_v + motor_change));
            if settled {
                return Some(self.finish_elastic(elastic, &change, &motor_change, modes, h));
            }
        }
        // No consistent set after six tries: every doubtful joint sticks.
        let change = Cholesky::new(&system)?.solve(&impulse);
        Some(self.finish_elastic(elastic, &change, &(-self.motor_v), [0.0; N], h))
    }

    fn finish_elastic(
        &mut self,
        elastic: &Elastic<N>,
        change: &SVector<f64, N>,
        motor_change: &SVector<f64, N>,
        modes: [f64; N],
        h: f64,
    ) -> SVector<f64, N> {
        self.slip = Slip(modes);
        self.v += change;
        self.q += self.v * h;
        self.motor_v += motor_change;
        self.motor += self.motor_v * h;
        let wind = self.motor - self.q;
        SVector::from_fn(|i, _| wind[i] * elastic.stiffness[i] + (self.motor_v[i] - self.v[i]) * elastic.damping[i])
    }
}

/// Adds one contact point, linearised about the present state. Returns false if it does not press.
#[inline]
fn add_touch<const N: usize>(
    touch: &ContactPoint,
    frames: &[Pose<f64>; N],
    v: &SVector<f64, N>,
    h: f64,
    system: &mut SMatrix<f64, N, N>,
    impulse: &mut SVector<f64, N>,
) -> bool {
    let columns: [Vector3<f64>; N] = core::array::from_fn(|i| frames[i].z().cross(&(touch.point - frames[i].position)));
    let mut velocity = Vector3::zeros();
    for i in 0..N {
        velocity += columns[i] * v[i];
    }
    let approach = -touch.normal.dot(&velocity);
    // If a gap closes within the step, only the spring acts.
    let (k, d) = (touch.stiffness, if touch.depth > 0.0 { touch.damping } else { 0.0 });
    let force = k * (touch.depth + h * approach) + d * approach;
    if force <= 0.0 {
        return false;
    }
    let along: [f64; N] = core::array::from_fn(|i| touch.normal.dot(&columns[i]));
    let stiff = h * d + h * h * k;
    let sliding = velocity + touch.normal * approach;
    // Regularised Coulomb friction, its slope taken as the secant: never negative.
    let steady = (k * touch.depth + d * approach).max(0.0);
    let speed = (sliding.norm_squared() + touch.slow * touch.slow).sqrt();
    let drag = touch.friction * steady / speed;
    for i in 0..N {
        impulse[i] += h * (force * along[i] - drag * sliding.dot(&columns[i]));
    }
    if drag > 0.0 {
        let (normal, tangent) = (stiff - h * drag, h * drag);
        for i in 0..N {
            for j in 0..=i {
                let entry = normal * along[i] * along[j] + tangent * columns[i].dot(&columns[j]);
                system[(i, j)] += entry;
            }
        }
    } else {
        for i in 0..N {
            for j in 0..=i {
                system[(i, j)] += stiff * along[i] * along[j];
            }
        }
    }
    true
}
