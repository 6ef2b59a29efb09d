//! The scaling of a motion: soft limits, which slow it down before hard ones stop it.
//!
//! Time along a path runs at a scaling from 1 down to [`SLOWEST`]. Each soft limit
//! is a *load*, 1 where it begins to bite: the scaling falls until no load is above
//! 1, and rises again when all are below.

use nalgebra::Vector3;

use super::Env;
use crate::safety::workspace_clearance;

/// How fast the scaling falls and rises again, per s, and its least value.
const SLOWER_PER_S: f64 = 20.0;
const FASTER_PER_S: f64 = 2.0;
const SLOWEST: f64 = 0.05;

/// Towards an end of its range a joint may run this fast at the end (rad/s),
/// and so much faster for each rad before it (1/s).
const JOINT_END_RAD_S: f64 = 0.1;
const JOINT_GAIN_PER_S: f64 = 5.0;
/// The same for the TCP towards the end of the workspace and the plate.
const TCP_END_M_S: f64 = 0.05;
const TCP_GAIN_PER_S: f64 = 4.0;

/// The scaling of one motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct SpeedScaling {
    now: f64,
}

impl Default for SpeedScaling {
    fn default() -> Self {
        Self { now: 1.0 }
    }
}

impl SpeedScaling {
    /// Moves the scaling by one period under a load; returns it.
    #[inline]
    pub(crate) fn step(&mut self, load: f64, period_s: f64) -> f64 {
        let wanted = if load > 1.0 { self.now / load } else { 1.0 };
        // Not `clamp`, which panics where the period is not a number.
        let step = (wanted - self.now)
            .max(-SLOWER_PER_S * period_s)
            .min(FASTER_PER_S * period_s);
        self.now = (self.now + step).min(1.0).max(SLOWEST);
        self.now
    }

    /// Whether it has fallen as far as it goes.
    pub(crate) fn stopped(&self) -> bool {
        self.now <= SLOWEST
    }

    /// The scaling, from 0 to 1.
    pub(crate) fn now(&self) -> f64 {
        self.now
    }
}

/// Load of the joints that run towards the ends of their ranges.
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

/// Load of a TCP in free space: its speed, the force that it meets, and the
/// bounds that it runs towards.
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

    // Fails if a load does not slow the motion until it is borne, if nothing
    // makes it stop for good, or if it stays slow without one.
    #[test]
    fn the_pace_follows_the_load() {
        let mut scaling = SpeedScaling::default();
        // A motion whose speed is twice the limit at full scaling.
        for _ in 0..1000 {
            let load = 2.0 * scaling.now();
            scaling.step(load, 1e-3);
        }
        assert!((scaling.now() - 0.5).abs() < 0.01, "{}", scaling.now());
        for _ in 0..1000 {
            scaling.step(1e9, 1e-3);
        }
        assert_eq!(scaling.now(), SLOWEST);
        for _ in 0..1000 {
            scaling.step(0.5, 1e-3);
        }
        assert_eq!(scaling.now(), 1.0);
    }
}
