//! Cables and hoses along the arm: they pull each joint towards the angle in which they lie without tension.

use nalgebra::SVector;

use super::config::PlantConfig;
use super::random::{Stream, between, stream};

/// The torques of the cables on all joints. They act on the links, beyond the torque sensors.
#[derive(Clone, Debug)]
pub(super) struct Cable<const N: usize> {
    /// Largest torque, in N m.
    most: [f64; N],
    /// Angle without torque, in rad.
    laid: [f64; N],
    /// Angle over which the torque grows, in rad.
    bend: f64,
}

impl<const N: usize> Cable<N> {
    /// Draws the angles in which the cables lie.
    pub(super) fn draw(config: &PlantConfig) -> Self {
        let c = &config.disturbance;
        let mut rng = stream(config.seed, Stream::Cable);
        Self {
            most: core::array::from_fn(|i| c.cable_nm.get(i).copied().unwrap_or(0.0)),
            laid: core::array::from_fn(|_| between(&mut rng, [-c.cable_laid_rad, c.cable_laid_rad])),
            bend: c.cable_bend_rad,
        }
    }

    /// Whether any cable pulls.
    pub(super) fn is_on(&self) -> bool {
        self.most.iter().any(|most| *most > 0.0)
    }

    /// Torque on the links at the angles `q` (rad), in N m.
    pub(super) fn torque(&self, q: &SVector<f64, N>) -> SVector<f64, N> {
        if !self.is_on() {
            return SVector::zeros();
        }
        SVector::from_fn(|i, _| -self.most[i] * libm::tanh((q[i] - self.laid[i]) / self.bend))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a cable pulls away from the angle in which it lies, by more than its largest torque, or by less far from
    // there; or if joints beyond the list are pulled.
    #[test]
    fn a_cable_pulls_back() {
        let mut config = PlantConfig::typical();
        assert!(!Cable::<7>::draw(&config).is_on());
        config.disturbance.cable_nm = vec![0.0, 0.0, 0.0, 0.0, 0.0, 1.5];
        let cable = Cable::<7>::draw(&config);
        assert!(cable.is_on() && cable.laid[5].abs() <= 1.0);
        let at = |by: f64| cable.torque(&SVector::from_element(cable.laid[5] + by));
        for (by, torque) in [(0.0, 0.0), (0.3, -1.5 * 1.0f64.tanh()), (-3.0, 1.5), (3.0, -1.5)] {
            assert!((at(by)[5] - torque).abs() < 1e-6, "{by} rad: {}", at(by)[5]);
        }
        assert_eq!((at(2.0)[4], at(2.0)[6]), (0.0, 0.0));
    }
}
