//! The joint spring-damper: for motions in free space and for every hold.

use nalgebra::SVector;
use spherecal_shared::scalar::sqrt;

use super::snapshot::Snapshot;

/// Smallest stiffness of every joint, in N m/rad, so that light wrist joints hold
/// against friction.
const LEAST_STIFFNESS: f64 = 40.0;

/// Setpoint of the joints.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointSetpoint<const N: usize> {
    /// Angles, in rad.
    pub q: [f64; N],
    /// Velocities, in rad/s.
    pub dq: [f64; N],
}

/// Torque of the joint spring-damper without gravity and Coriolis torque, in N m.
///
/// The stiffness is the mass matrix times `natural_rad_s` squared. Every motion of
/// the arm then has that natural frequency and Lehr's damping `ratio`. A spring for
/// each joint alone would not do: where two axes align (joints 1 and 3 of an
/// upright arm), the joints can turn against each other with almost no inertia, and
/// springs made for the inertia of the whole arm become unstable. The smallest
/// stiffness is added; its damping follows from the inertia that a joint moves
/// when the others are free, `1 / (M⁻¹)ᵢᵢ`.
#[inline]
pub fn joint_torque<const N: usize>(
    snapshot: &Snapshot<N>,
    setpoint: &JointSetpoint<N>,
    natural_rad_s: f64,
    ratio: f64,
) -> SVector<f64, N> {
    let error = SVector::<f64, N>::from_fn(|i, _| setpoint.q[i] - snapshot.q[i]);
    let rate = SVector::<f64, N>::from_fn(|i, _| setpoint.dq[i] - snapshot.dq[i]);
    let natural_rad_s = natural_rad_s.min(snapshot.fastest_rad_s);
    let wanted = error * (natural_rad_s * natural_rad_s) + rate * (2.0 * ratio * natural_rad_s);
    let mut torque = snapshot.mass.multiply(&wanted);
    for i in 0..N {
        let alone = SVector::<f64, N>::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
        let mobility = snapshot.mass.solve_lower(&alone).norm_squared();
        let stiffness = LEAST_STIFFNESS.min(snapshot.fastest_rad_s * snapshot.fastest_rad_s / mobility);
        let damping = 2.0 * ratio * sqrt(stiffness / mobility);
        torque[i] += stiffness * error[i] + damping * rate[i];
    }
    torque
}
