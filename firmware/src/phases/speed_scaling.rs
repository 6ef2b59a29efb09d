//! Speed scaling: slows a motion down at soft limits, before a hard limit stops it.
//!
//! The time along a path runs at a rate between 1 and [`SLOWEST`]. Each soft limit
//! has a *load*, which is 1 at the limit. The rate falls while any load is above 1
//! and rises again when all are below. For a felt force it falls more calmly.
//!
//! A load is that of the last setpoint's speed where the phase has one for the joints. The
//! measured speed answers to the rate as late as the arm follows: with it the rate swings, and an
//! arm with elastic joints (7,000 N m/rad) swings with the rate.

use nalgebra::SVector;
use spherecal_shared::scalar::sqrt;

use super::Env;
use crate::safety::workspace_clearance;

/// Largest decrease and increase of the rate, in 1/s, and its smallest value.
const SLOWER_PER_S: f64 = 20.0;
const FASTER_PER_S: f64 = 2.0;
/// Largest decrease of the rate for a felt force, in 1/s. A faster one brakes a heavy arm so hard that its own inertia
/// looks like a force: a UR20 swung at 10 Hz with 50 to 170 N, and never reached its targets.
const CALMER_PER_S: f64 = 5.0;
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
    /// Advances by one period under a load and that of a felt force; returns the rate.
    #[inline]
    pub(crate) fn step(&mut self, load: f64, felt: f64, period_s: f64) -> f64 {
        // The speed of a setpoint is proportional to the rate, so that this is the rate at the limit.
        let towards = |load: f64| self.rate / load.max(self.rate) - self.rate;
        // Not `clamp`, which panics if the period is not a number.
        let step = towards(load)
            .max(-SLOWER_PER_S * period_s)
            .min(towards(felt).max(-CALMER_PER_S * period_s))
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

/// Load of the joints that move towards the ends of their ranges with `dq` (rad/s).
#[inline]
pub(super) fn joint_load<const N: usize>(env: &Env<'_, N>, dq: &[f64; N]) -> f64 {
    let margin = env.procedure.limits.position_margin_rad;
    let mut load = 0.0f64;
    for (i, joint) in env.joints.iter().enumerate() {
        let (q, dq) = (env.snapshot.q[i], dq[i]);
        let left = if q > joint.max_rad || q < joint.min_rad {
            // It was pushed out of its range and comes back.
            0.0
        } else if dq > 0.0 {
            joint.max_rad - margin - q
        } else {
            q - joint.min_rad - margin
        };
        load = load.max(dq.abs() / (JOINT_END_RAD_S + JOINT_GAIN_PER_S * left.max(0.0)));
    }
    load
}

/// Load of the TCP in free space: its speed with the joint speeds `dq` (rad/s), and the bounds that it moves towards.
#[inline]
pub(super) fn tcp_load<const N: usize>(env: &Env<'_, N>, dq: &[f64; N]) -> f64 {
    let limits = &env.procedure.limits;
    let v = env.snapshot.jacobian.fixed_rows::<3>(0) * SVector::from(*dq);
    let (clearance, outward) = workspace_clearance(&env.snapshot.tcp.position, limits);
    let towards = v.dot(&outward);
    (sqrt(v.norm_squared()) / limits.soft_speed_m_s).max(towards / (TCP_END_M_S + TCP_GAIN_PER_S * clearance.max(0.0)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phases::scene::Scene;
    use std::vec::Vec;

    // Fails if the motion does not slow down until the load is 1, if a persistent
    // load does not slow it to the minimum, or if it stays slow without a load.
    #[test]
    fn the_pace_follows_the_load() {
        let mut scaling = SpeedScaling::default();
        // A motion that at full rate has twice the speed limit.
        for _ in 0..1000 {
            let load = 2.0 * scaling.rate();
            scaling.step(load, 0.0, 1e-3);
        }
        assert!((scaling.rate() - 0.5).abs() < 0.01, "{}", scaling.rate());
        for _ in 0..1000 {
            scaling.step(1e9, 0.0, 1e-3);
        }
        assert_eq!(scaling.rate(), SLOWEST);
        for _ in 0..1000 {
            scaling.step(0.5 * scaling.rate(), 0.0, 1e-3);
        }
        assert_eq!(scaling.rate(), 1.0);
    }

    // Fails if a rate that is at its limit does not stay there exactly: that of a setpoint has no delay.
    #[test]
    fn a_rate_at_its_limit_stays() {
        let mut scaling = SpeedScaling::default();
        let mut load = 0.0;
        let rates: Vec<f64> = (0..1_000)
            .map(|_| {
                let rate = scaling.step(load, 0.0, 1e-3);
                load = 1.6 * rate;
                rate
            })
            .collect();
        assert!(
            rates[100..].iter().all(|rate| (rate - 0.625).abs() < 1e-12),
            "{}",
            rates[999]
        );
    }

    /// Joint speeds with which the TCP has a velocity (m/s).
    fn with(scene: &Scene, velocity: [f64; 3]) -> [f64; 7] {
        let jacobian = scene.snapshot.jacobian.fixed_rows::<3>(0).into_owned();
        let inverse = jacobian.pseudo_inverse(1e-9).expect("not singular");
        (inverse * SVector::from(velocity)).into()
    }

    // Fails if a load is not 1 where its soft limit is: 0.75 m/s, and towards the end of a range
    // or a bound what may still be stopped (0.1 rad/s and 5/s; 0.05 m/s and 4/s), or if the measured
    // speed counts, which is late.
    #[test]
    fn a_load_is_one_at_its_limit() {
        let mut scene = Scene::at(&crate::testing::HOME, &[0.5; 7]);
        let fast = with(&scene, [0.45, 0.0, 0.6]);
        assert!((tcp_load(&scene.env(), &fast) - 1.0).abs() < 1e-9);
        // 5 cm above the plate: 0.25 m/s is allowed towards it, and any speed away from it.
        scene.procedure.limits.plate_offset_m = scene.snapshot.tcp.position.z - 0.05;
        for (speed, load) in [(-0.5, 2.0), (0.15, 0.2)] {
            let dq = with(&scene, [0.0, 0.0, speed]);
            assert!((tcp_load(&scene.env(), &dq) - load).abs() < 1e-9, "{speed} m/s");
        }
        // Beyond it: 0.05 m/s.
        scene.procedure.limits.plate_offset_m += 0.2;
        let dq = with(&scene, [0.0, 0.0, -0.1]);
        assert!((tcp_load(&scene.env(), &dq) - 2.0).abs() < 1e-9);

        let mut scene = Scene::new();
        let (joint, margin) = (scene.joints[3], scene.procedure.limits.position_margin_rad);
        let mut load = |q: f64, dq: f64| {
            scene.snapshot.q[3] = q;
            joint_load(&scene.env(), &[0.0, 0.0, 0.0, dq, 0.0, 0.0, 0.0])
        };
        for (end, outwards) in [(joint.max_rad - margin, 1.0), (joint.min_rad + margin, -1.0)] {
            assert!((load(end - outwards * 0.1, outwards * 1.2) - 2.0).abs() < 1e-9);
            assert!((load(end + outwards * 0.1, outwards * 0.05) - 0.5).abs() < 1e-9);
        }
        for (end, outwards) in [(joint.max_rad, 1.0), (joint.min_rad, -1.0)] {
            let back = load(end + outwards * 0.01, outwards * -0.3);
            assert!((back - 3.0).abs() < 1e-9, "0.1 rad/s on the way back into the range");
        }
        let middle = 0.5 * (joint.min_rad + joint.max_rad);
        assert!(load(middle, 1.0) < 0.15);
    }

    // Fails if the rate changes faster than by 20/s downwards, by 5/s for a felt force also where a load is at its limit, or by
    // 2/s upwards, or if it is called slowest anywhere else than at its smallest value.
    #[test]
    fn the_pace_changes_within_its_rates() {
        let mut scaling = SpeedScaling::default();
        assert!((scaling.step(100.0, 0.0, 1e-3) - 0.98).abs() < 1e-12);
        assert!((scaling.step(1.001, 0.0, 1e-3) - 0.98 / 1.001).abs() < 1e-12);
        let rate = scaling.rate();
        assert!((scaling.step(0.5, 0.0, 1e-3) - rate - 0.002).abs() < 1e-12);
        for load in [0.5, 1.000_1] {
            let rate = scaling.rate();
            assert!((scaling.step(load, 100.0, 1e-3) - rate + 0.005).abs() < 1e-12);
        }
        assert!(!scaling.is_slowest());
        while scaling.step(100.0, 0.0, 1e-3) > SLOWEST {
            assert!(!scaling.is_slowest());
        }
        assert!(scaling.is_slowest());
    }
}
