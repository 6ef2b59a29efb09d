//! Speed scaling: slows a motion down at soft limits, before a hard limit stops it.
//!
//! The time along a path runs at a rate between 1 and [`SLOWEST`]. Each soft limit
//! has a *load*, which is 1 at the limit. The rate falls while any load is above 1
//! and rises again when all are below.

use nalgebra::Vector3;

use super::Env;
use crate::safety::workspace_clearance;

/// Largest decrease and increase of the rate, in 1/s, and its smallest value.
const SLOWER_PER_S: f64 = 20.0;
const FASTER_PER_S: f64 = 2.0;
const SLOWEST: f64 = 0.05;

/// Speed that a joint may have at the end of its range (rad/s), and its increase
/// with the distance from there (1/s).
const JOINT_END_RAD_S: f64 = 0.1;
const JOINT_GAIN_PER_S: f64 = 5.0;
/// The same for the TCP towards a bound of the workspace and towards the plate.
const TCP_END_M_S: f64 = 0.05;
const TCP_GAIN_PER_S: f64 = 4.0;

/// The speed scaling of one motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpeedScaling {
    rate: f64,
}

impl Default for SpeedScaling {
    fn default() -> Self {
        Self { rate: 1.0 }
    }
}

impl SpeedScaling {
    /// Advances by one period under a load; returns the rate.
    #[inline]
    pub(crate) fn step(&mut self, load: f64, period_s: f64) -> f64 {
        let wanted = if load > 1.0 { self.rate / load } else { 1.0 };
        // Not `clamp`, which panics if the period is not a number.
        let step = (wanted - self.rate)
            .max(-SLOWER_PER_S * period_s)
            .min(FASTER_PER_S * period_s);
        self.rate = (self.rate + step).min(1.0).max(SLOWEST);
        self.rate
    }

    /// Whether the rate has its smallest value.
    pub(crate) fn is_slowest(&self) -> bool {
        self.rate <= SLOWEST
    }

    /// The rate, from 0 to 1.
    pub(crate) fn rate(&self) -> f64 {
        self.rate
    }
}

/// Load of the joints that move towards the ends of their ranges.
#[inline]
pub(super) fn joint_load<const N: usize>(env: &Env<'_, N>) -> f64 {
    let margin = env.procedure.limits.position_margin_rad;
    let mut load = 0.0f64;
    for (i, joint) in env.joints.iter().enumerate() {
        let (q, dq) = (env.snapshot.q[i], env.snapshot.dq[i]);
        let left = if dq > 0.0 {
            joint.max_rad - margin - q
        } else {
            q - joint.min_rad - margin
        };
        load = load.max(dq.abs() / (JOINT_END_RAD_S + JOINT_GAIN_PER_S * left.max(0.0)));
    }
    load
}

/// Load of the TCP in free space: its speed, the force on it, and the bounds that
/// it moves towards.
#[inline]
pub(super) fn tcp_load<const N: usize>(env: &Env<'_, N>) -> f64 {
    let limits = &env.procedure.limits;
    let v = &env.snapshot.velocity;
    let (clearance, outward) = workspace_clearance(&env.snapshot.tcp.position, limits);
    let towards = Vector3::new(v[0], v[1], v[2]).dot(&outward);
    (env.snapshot.tcp_speed() / limits.soft_speed_m_s)
        .max(env.force_n / limits.soft_force_n)
        .max(towards / (TCP_END_M_S + TCP_GAIN_PER_S * clearance.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the motion does not slow down until the load is 1, if a persistent
    // load does not slow it to the minimum, or if it stays slow without a load.
    #[test]
    fn the_pace_follows_the_load() {
        let mut scaling = SpeedScaling::default();
        // A motion that at full rate has twice the speed limit.
        for _ in 0..1000 {
            let load = 2.0 * scaling.rate();
            scaling.step(load, 1e-3);
        }
        assert!((scaling.rate() - 0.5).abs() < 0.01, "{}", scaling.rate());
        for _ in 0..1000 {
            scaling.step(1e9, 1e-3);
        }
        assert_eq!(scaling.rate(), SLOWEST);
        for _ in 0..1000 {
            scaling.step(0.5, 1e-3);
        }
        assert_eq!(scaling.rate(), 1.0);
    }
}
