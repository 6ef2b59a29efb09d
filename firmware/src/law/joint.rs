//! The joint spring-damper of free-space motions and of every hold.

use nalgebra::SVector;
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;

/// Stiffness that every joint has at least, in N m/rad: light wrist joints
/// must hold against friction too.
const LEAST_STIFFNESS: f64 = 40.0;

/// Where the joints are drawn to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSetpoint<const N: usize> {
    /// Angles, in rad.
    pub q: [f64; N],
    /// Velocities, in rad/s.
    pub dq: [f64; N],
}

/// Torque of the joint spring-damper without gravity and Coriolis, in N m.
///
/// Stiffness is the joint's inertia times `natural_rad_s` squared, damping
/// follows from Lehr's ratio.
#[inline]
pub fn joint_torque<const N: usize>(
    snapshot: &Snapshot<N>,
    setpoint: &JointSetpoint<N>,
    natural_rad_s: f64,
    ratio: f64,
) -> SVector<f64, N> {
    SVector::from_fn(|i, _| {
        let inertia = snapshot.inertia[i];
        let stiffness = inertia * natural_rad_s * natural_rad_s + LEAST_STIFFNESS;
        let damping = 2.0 * ratio * sqrt(inertia * stiffness);
        stiffness * (setpoint.q[i] - snapshot.q[i]) + damping * (setpoint.dq[i] - snapshot.dq[i])
    })
}
