//! Drift of links and plate while the cell warms up.
//!
//! Everything grows with one law, `w(t) = (exp(−t₀/T) − exp(−(t₀+t)/T)) / (1 − exp(−1 h/T))`. It is
//! zero at the start of the run, `t₀` after power-on, and scaled so that the first hour after
//! power-on gives 1.

use nalgebra::Vector3;
use rand::RngExt;
use spherecal_shared::robot::Robot;

use super::config::PlantConfig;
use super::random::{Stream, between, normal3, stream};

/// One hour, in s.
const HOUR_S: f64 = 3600.0;

/// Drift of one cell.
#[derive(Clone, Debug, Default)]
pub(super) struct Warming {
    /// Growth of `a` and `d` of each joint in the first hour, in m.
    growth: Vec<[f64; 2]>,
    /// Shift of the plate in that hour, in m, F0.
    plate: Vector3<f64>,
    /// Time constant and time since power-on, in s.
    law: (f64, f64),
}

impl Warming {
    pub(super) fn draw(robot: &Robot, config: &PlantConfig) -> Self {
        let t = &config.thermal;
        if !t.enabled {
            return Self::default();
        }
        let mut rng = stream(config.seed, Stream::Thermal);
        let links = between(&mut rng, t.links_m);
        let plate = between(&mut rng, t.plate_m);
        let direction = normal3(&mut rng).try_normalize(1e-9).unwrap_or_else(Vector3::z);
        let mut growth: Vec<[f64; 2]> = robot
            .joints
            .iter()
            .map(|j| [j.mdh.a, j.mdh.d].map(|length| length * rng.random_range(0.5..1.5)))
            .collect();
        let whole: f64 = growth.iter().flatten().map(|x| x.abs()).sum();
        for part in growth.iter_mut().flatten() {
            *part *= if whole > 0.0 { links / whole } else { 0.0 };
        }
        Self {
            growth,
            plate: direction * plate,
            law: (t.time_constant_s, t.on_since_s),
        }
    }

    /// Whether anything drifts.
    pub(super) fn is_on(&self) -> bool {
        !self.growth.is_empty()
    }

    /// `w(t)`, with `t` in s since the start of the run.
    fn share(&self, time_s: f64) -> f64 {
        let (constant, since) = self.law;
        let at = |t: f64| libm::exp(-t / constant);
        (at(since) - at(since + time_s)) / (1.0 - at(HOUR_S))
    }

    /// `robot`, given at the start of the run, at another time (s).
    pub(super) fn robot(&self, robot: &Robot, time_s: f64) -> Robot {
        let share = self.share(time_s);
        let mut robot = robot.clone();
        for (joint, [a, d]) in robot.joints.iter_mut().zip(&self.growth) {
            joint.mdh.a += a * share;
            joint.mdh.d += d * share;
        }
        robot
    }

    /// Shift of the plate since the start of the run, in m, F0.
    pub(super) fn plate(&self, time_s: f64) -> Vector3<f64> {
        if self.is_on() {
            self.plate * self.share(time_s)
        } else {
            Vector3::zeros()
        }
    }
}
