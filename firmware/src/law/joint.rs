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
/// All joints answer as one: the stiffness is the mass matrix times
/// `natural_rad_s` squared, so that every motion of the arm has that natural
/// frequency and Lehr's damping `ratio` at it. Joint by joint it would not:
/// where two axes align (the first and the third of an upright arm) they can
/// turn against each other with next to no inertia, and a spring made for the
/// inertia of the whole arm runs away there. On top comes the least stiffness,
/// damped for what each joint moves when the others are free,
/// `1 / (M⁻¹)ᵢᵢ`.
#[inline]
pub fn joint_torque<const N: usize>(
    snapshot: &Snapshot<N>,
    setpoint: &JointSetpoint<N>,
    natural_rad_s: f64,
    ratio: f64,
) -> SVector<f64, N> {
    let error = SVector::<f64, N>::from_fn(|i, _| setpoint.q[i] - snapshot.q[i]);
    let rate = SVector::<f64, N>::from_fn(|i, _| setpoint.dq[i] - snapshot.dq[i]);
    let wanted = error * (natural_rad_s * natural_rad_s) + rate * (2.0 * ratio * natural_rad_s);
    let mut torque = snapshot.mass.multiply(&wanted);
    for i in 0..N {
        let alone = SVector::<f64, N>::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
        let mobility = snapshot.mass.solve_lower(&alone).norm_squared();
        let damping = 2.0 * ratio * sqrt(LEAST_STIFFNESS / mobility);
        torque[i] += LEAST_STIFFNESS * error[i] + damping * rate[i];
    }
    torque
}
