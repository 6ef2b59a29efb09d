//! The null space: a spring-damper on the motion that leaves the TCP in place.
//!
//! On a spherical-rotational-spherical arm this motion has one coordinate, the
//! elbow angle ([`spherecal_shared::robot::elbow`]), and the spring acts on that
//! angle. It thereby follows continuous inverse kinematics at the commanded elbow
//! angle without computing any. Another redundant arm is pulled to a posture.
//!
//! The projection is dynamically consistent: with `M = L Lᵀ`, the torque direction
//! `g` becomes `L (y − W Λ Wᵀ y)`, `y = L⁻¹ g`, `W = L⁻¹ Jᵀ`, which does not
//! accelerate the TCP.

use nalgebra::SVector;
use spherecal_shared::robot::elbow::{Elbow, elbow};
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;

/// Setpoint of the null space.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum NullSpace<const N: usize> {
    /// None: the arm is not redundant.
    Free,
    /// An elbow angle and its rate.
    Elbow {
        /// Elbow angle, in rad.
        angle: f64,
        /// Rate of the elbow angle, in rad/s.
        rate: f64,
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
    /// Torque of the null-space spring-damper, in N m. `stiffness` is in N m/rad,
    /// `ratio` is Lehr's damping ratio.
    #[inline]
    pub fn torque(&self, snapshot: &Snapshot<N>, stiffness: f64, ratio: f64) -> SVector<f64, N> {
        match self {
            Self::Free => SVector::zeros(),
            Self::Elbow { angle, rate } => match elbow(&snapshot.frames) {
                Some(now) => elbow_torque(snapshot, &now, *angle, *rate, stiffness, ratio),
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
    pub(crate) fn elbow_error(&self, snapshot: &Snapshot<N>) -> f64 {
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
    now: &Elbow<f64>,
    angle: f64,
    rate: f64,
    stiffness: f64,
    ratio: f64,
) -> SVector<f64, N> {
    // Gradient of the elbow angle on null motions: the elbow's speed along its
    // circle, divided by the radius. Joints beyond the elbow do not move it.
    let direction = now.tangent / now.radius;
    let mut gradient = SVector::<f64, N>::zeros();
    for (i, frame) in snapshot.frames.iter().enumerate().take(4) {
        gradient[i] = frame.z().cross(&(now.point - frame.position)).dot(&direction);
    }
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
    let damping = 2.0 * ratio * sqrt(stiffness / mobility);
    torque * (stiffness * difference(angle, now.angle) + damping * (rate - now_rate))
}
