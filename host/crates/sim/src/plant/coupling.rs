//! Seating repeatability: where the seated sphere's centre stands in the nest.
//!
//! Penalty contact seats exactly the same each time (but for `F0/k`); real nests
//! do not. Each coupling draws a seat of its own, and the form of sphere and
//! pads moves it a little with the nest's orientation.

use nalgebra::Vector3;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::robot::Frame;

use super::config::PlantConfig;
use super::world::{Stream, normal3, stream};

/// Seating repeatability: a fresh seat for each coupling.
#[derive(Clone, Debug)]
pub(super) struct Coupling {
    rng: ChaCha8Rng,
    /// Whether the sphere is near its seat now.
    pub(super) near: bool,
    /// Seat of this coupling, in m, nest's frame.
    seat: Vector3<f64>,
    /// Form errors: direction (m), wave vector and phase over the nest's orientation.
    waves: [(Vector3<f64>, Vector3<f64>, f64); 3],
}

impl Coupling {
    pub(super) fn new(config: &PlantConfig) -> Self {
        let mut rng = stream(config.seed, Stream::Seating);
        // Wave vectors over the nest's axes: a length scale of about 6 degrees.
        let waves = core::array::from_fn(|_| {
            let direction = normal3(&mut rng) * (2.0_f64 / 3.0).sqrt();
            let wave = normal3(&mut rng) * 10.0;
            let phase = super::world::normal(&mut rng) * 10.0;
            (direction, wave, phase)
        });
        Self {
            rng,
            near: false,
            seat: Vector3::zeros(),
            waves,
        }
    }

    /// Where the seated centre stands in the nest's frame now, in m.
    pub(super) fn seat(
        &mut self,
        tcp: &Frame<f64>,
        plate: &Frame<f64>,
        sphere: &Vector3<f64>,
        config: &PlantConfig,
    ) -> Vector3<f64> {
        let nest = &config.nest;
        if !nest.seating_error {
            return Vector3::zeros();
        }
        let near = (sphere - tcp.origin).norm_squared() < 0.005 * 0.005;
        if near && !self.near {
            self.seat = normal3(&mut self.rng) * nest.seating_sigma_m;
        }
        self.near = near;
        if !near {
            return self.seat;
        }
        let axis = plate.rotation.tr_mul(&tcp.z());
        let side: Vector3<f64> = plate.rotation.tr_mul(&Vector3::from(tcp.rotation.column(0)));
        let place = Vector3::new(axis.x, axis.y, side.x + side.y);
        let mut seat = self.seat;
        for (direction, wave, phase) in &self.waves {
            seat += direction * (nest.form_sigma_m * libm::sin(wave.dot(&place) + phase));
        }
        seat
    }
}
