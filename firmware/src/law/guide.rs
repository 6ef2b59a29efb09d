//! Hand-guiding: an arm without weight that goes where it is led, and stays
//! where it is left.
//!
//! The gravity model is never exact, so an arm that is only damped creeps away
//! when it is let go. Each joint therefore hangs on a spring that *yields*: its
//! rest is dragged along once the spring carries [`YIELD_SHARE`] of the joint's
//! torque. A model error below that is held, a hand above it leads.
//!
//! `τ = K (q_h − q) − D q̇ − walls`, with `|q_h − q| ≤ τ_y / K` the same for all joints. The damping
//! grows with speed past the limits, and a wall stands before each joint limit.

use nalgebra::SVector;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::scalar::sqrt;

use super::{JointSetpoint, Snapshot};

/// Share of a joint's torque at which its spring yields: 2.6 N m on the big
/// joints of an iiwa 7, which a mass error of 3 % leaves on joint 2, and 5 N at
/// a hand half a metre away.
const YIELD_SHARE: f64 = 0.015;
/// How far a joint gives before it goes, in rad: light wrists get soft springs
/// by it, as they must at 1 kHz.
const GIVE_RAD: f64 = 0.015;
/// Damping over that of an undamped spring's, so that what is let go does not swing.
const DAMPING_RATIO: f64 = 0.5;
/// Speed of the TCP above which the damping grows, in m/s: that of
/// hand-guiding in ISO 10218-1 is not to exceed 0.25 m/s without an assessment.
const TCP_SPEED_M_S: f64 = 0.25;
/// The same for each joint, in rad/s.
const JOINT_SPEED_RAD_S: f64 = 0.8;
/// How fast the damping grows: so many times itself for each limit exceeded.
const BRAKE: f64 = 10.0;
/// Thickness of the wall before a joint limit, in rad.
const WALL_RAD: f64 = 0.15;
/// Torque of the wall at its end, over the joint's limit.
const WALL_SHARE: f64 = 0.4;

/// Torque of hand-guiding without gravity and Coriolis, in N m; drags `hold`
/// along. `margin_rad` is what every joint keeps from its limit.
#[inline]
pub fn guide_torque<const N: usize>(
    snapshot: &Snapshot<N>,
    hold: &mut JointSetpoint<N>,
    limits: &[JointLimits; N],
    margin_rad: f64,
) -> SVector<f64, N> {
    let fast = snapshot.tcp_speed() / TCP_SPEED_M_S;
    let mut torque = SVector::zeros();
    for (i, limit) in limits.iter().enumerate() {
        let (q, dq, inertia) = (snapshot.q[i], snapshot.dq[i], snapshot.inertia[i]);
        let spring = YIELD_SHARE * limit.torque_nm / GIVE_RAD;
        hold.q[i] = hold.q[i].max(q - GIVE_RAD).min(q + GIVE_RAD);
        hold.dq[i] = 0.0;
        let excess = fast.max(dq.abs() / JOINT_SPEED_RAD_S) - 1.0;
        let damping = 2.0 * DAMPING_RATIO * sqrt(inertia * spring) * (1.0 + BRAKE * excess.max(0.0));
        let stiffness = WALL_SHARE * limit.torque_nm / WALL_RAD;
        let low = limit.min_rad + margin_rad + WALL_RAD;
        let high = limit.max_rad - margin_rad - WALL_RAD;
        let inside = (q - high).max(0.0) + (q - low).min(0.0);
        let wall_damping = if inside == 0.0 {
            0.0
        } else {
            2.0 * sqrt(inertia * stiffness)
        };
        torque[i] = spring * (hold.q[i] - q) - (damping + wall_damping) * dq - stiffness * inside;
    }
    torque
}
