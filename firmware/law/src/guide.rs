//! Hand-guiding: the arm follows a hand and stays where the hand leaves it.
//!
//! The gravity model is never exact, so an arm that is only damped creeps away
//! when it is released. Each joint therefore has a spring that *yields*: its rest
//! position moves along once the spring carries [`YIELD_SHARE`] of the joint's
//! torque limit. The spring holds a smaller model error; a hand exceeds it.
//!
//! `τ = K (q_h − q) − D q̇ − walls`, where `q_h` is the rest position and
//! `|q_h − q| ≤ GIVE_RAD`. The damping grows above the speed limits, and a wall
//! (a one-sided spring) stands before each joint limit.

use nalgebra::SVector;
use spherecal_shared::robot::JointLimits;
use spherecal_shared::scalar::sqrt;

use super::{JointSetpoint, Snapshot};

/// Share of the joint's torque limit at which its spring yields. On the big joints
/// of an iiwa 7 this is 2.6 N m: as much as a mass error of 3 % causes on joint 2,
/// and 5 N for a hand half a metre away.
const YIELD_SHARE: f64 = 0.015;
/// Deflection of the spring at which it yields, in rad. It makes the springs of
/// light wrist joints soft, as 1 kHz requires.
const GIVE_RAD: f64 = 0.015;
/// Damping ratio of the spring, so that a released joint does not oscillate.
const DAMPING_RATIO: f64 = 0.5;
/// Speed of the TCP above which the damping grows, in m/s. ISO 10218-1 limits
/// hand-guiding to 0.25 m/s unless an assessment allows more.
const TCP_SPEED_M_S: f64 = 0.25;
/// Speed of a joint above which the damping grows, in rad/s.
const JOINT_SPEED_RAD_S: f64 = 0.8;
/// Growth of the damping: at twice the speed limit it is `1 + BRAKE` times as large.
const BRAKE: f64 = 10.0;
/// Thickness of the wall before a joint limit, in rad.
const WALL_RAD: f64 = 0.15;
/// Torque of the wall at its far end, as a share of the joint's torque limit.
const WALL_SHARE: f64 = 0.4;

/// Torque of hand-guiding without gravity and Coriolis torque, in N m. Moves the
/// rest position `hold` along. Every joint keeps `margin_rad` from its limits.
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    // Fails if the wall before a joint limit starts elsewhere than 0.15 rad before the
    // margin, pushes outwards, or has another height at either end of the range.
    #[test]
    fn the_wall_stands_before_both_limits() {
        let limits = core::array::from_fn(|i| iiwa7().joints[i].limits);
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        let margin = 0.05;
        let wall = |q: f64| {
            let mut at = HOME;
            at[0] = q;
            let snapshot = Snapshot::new(&arm, &at, &[0.0; 7]).expect("a mass matrix");
            let mut hold = JointSetpoint { q: at, dq: [0.0; 7] };
            guide_torque(&snapshot, &mut hold, &limits, margin)[0]
        };
        let height = WALL_SHARE * limits[0].torque_nm;
        let (low, high) = (limits[0].min_rad + margin, limits[0].max_rad - margin);
        for (inwards, end) in [(1.0, low), (-1.0, high)] {
            assert!((wall(end) - inwards * height).abs() < 1e-9);
            assert!((wall(end + inwards * 0.5 * WALL_RAD) - inwards * 0.5 * height).abs() < 1e-9);
            assert_eq!(wall(end + inwards * (WALL_RAD + 0.01)), 0.0);
        }
    }
}
