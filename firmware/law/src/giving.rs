//! The hold that gives way: for an arm that presses on something.
//!
//! The hold after any other fault is a stiff joint spring. Against a contact it would
//! press on. This one follows: once spring and damper together are stronger at the TCP
//! than a few newtons, the rest position moves towards the arm, so the spring vanishes
//! and only the damper is left. Below that the spring holds the arm against model error.

use nalgebra::{SVector, Vector3};
use spherecal_shared::robot::JointLimits;

use super::{JointSetpoint, Snapshot};

/// Force at the TCP at which the hold gives way, beyond model error, in N.
const GIVE_N: f64 = 5.0;
/// Largest distance that it gives way by, in m. Then it holds: a person could push the
/// arm into something else.
const MOST_M: f64 = 0.1;

/// A hold that gives way.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Giving {
    from: Vector3<f64>,
    most_n: f64,
}

impl Giving {
    /// From the TCP `from` (F0, in m) on. `model_n` is the size of the force by which the
    /// model errs, in N.
    pub fn new(from: Vector3<f64>, model_n: f64) -> Self {
        Self {
            from,
            most_n: GIVE_N + model_n,
        }
    }

    /// Moves the rest position `hold`. `torque` is that of the hold at this tick, in N m.
    /// Every joint keeps `margin_rad` from its limits.
    #[inline]
    pub fn follow<const N: usize>(
        &self,
        snapshot: &Snapshot<N>,
        torque: &SVector<f64, N>,
        hold: &mut JointSetpoint<N>,
        limits: &[JointLimits; N],
        margin_rad: f64,
    ) {
        let force = snapshot.point_force(torque).norm();
        let away = (snapshot.tcp.position - self.from).norm();
        // Not for NaN either.
        if !(force > self.most_n && away < MOST_M) {
            return;
        }
        let kept = self.most_n / force;
        for (i, limit) in limits.iter().enumerate() {
            let q = snapshot.q[i];
            let rest = q + (hold.q[i] - q) * kept;
            hold.q[i] = rest.max(limit.min_rad + margin_rad).min(limit.max_rad - margin_rad);
        }
    }
}
