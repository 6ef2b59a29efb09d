//! Seating repeatability: the position of the seated sphere's centre in the nest.
//!
//! Penalty contact always seats exactly the same (except for `F0/k`); real nests do not. Each
//! coupling draws its own seat, the sphere may find another seat while the nest turns about it, and
//! the form of sphere and pads moves it slightly with the nest's orientation.
//!
//! A coupling may be bad ([`NestKind`](super::nest_kind::NestKind)). Its seats are drawn from a Cauchy distribution.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use spherecal_shared::robot::Pose;

use super::config::{NestConfig, PlantConfig};
use super::random::{Stream, normal, normal3, stream};
use super::sensors::TICK_S;

/// Largest distance of a seated sphere from the TCP, in m.
const NEAR_M: f64 = 0.005;

/// Largest error of a seat, in m: beyond it the sphere would not be in the nest.
const LARGEST_M: f64 = 1e-3;

/// Speed at which the sphere slides to another seat, in m/s: slow enough that the pads follow without a blow.
const SLIDE_M_S: f64 = 2e-3;

/// Rotation of the nest, in rad, after which the chance of another seat is evaluated.
const TURN_RAD: f64 = 0.01;

/// Seating repeatability: a fresh seat for each coupling.
#[derive(Clone, Debug)]
pub(super) struct SeatScatter {
    rng: ChaCha8Rng,
    /// Whether the sphere is near its seat now.
    pub(super) near: bool,
    /// Whether this coupling is a bad one.
    bad: bool,
    /// Seat that was drawn, and how far the sphere has slid towards it, in m, nest's frame.
    seat: Vector3<f64>,
    reached: Vector3<f64>,
    /// Orientation of the nest up to which the chance of another seat was taken.
    turned: Matrix3<f64>,
    /// Form errors: direction (m), wave vector and phase over the nest's orientation.
    waves: [(Vector3<f64>, Vector3<f64>, f64); 3],
}

impl SeatScatter {
    pub(super) fn new(config: &PlantConfig) -> Self {
        Self::on(config, Stream::Seating)
    }

    /// The same on a stream of its own.
    pub(super) fn on(config: &PlantConfig, which: Stream) -> Self {
        let mut rng = stream(config.seed, which);
        // Wave vectors over the nest's axes: a length scale of about 6 degrees.
        let waves = core::array::from_fn(|_| {
            let direction = normal3(&mut rng) * (2.0_f64 / 3.0).sqrt();
            let wave = normal3(&mut rng) * 10.0;
            let phase = super::random::normal(&mut rng) * 10.0;
            (direction, wave, phase)
        });
        Self {
            rng,
            near: false,
            bad: false,
            seat: Vector3::zeros(),
            reached: Vector3::zeros(),
            turned: Matrix3::identity(),
            waves,
        }
    }

    /// Present position of the seated centre in the nest's frame, in m.
    pub(super) fn seat(
        &mut self,
        tcp: &Pose<f64>,
        plate: &Pose<f64>,
        sphere: &Vector3<f64>,
        config: &PlantConfig,
    ) -> Vector3<f64> {
        let nest = &config.nest;
        if !nest.seating_error {
            return Vector3::zeros();
        }
        let near = (sphere - tcp.position).norm_squared() < NEAR_M * NEAR_M;
        if near && !self.near {
            self.couple(nest, &tcp.rotation);
        }
        self.near = near;
        if !near {
            return self.seat;
        }
        self.turn(nest, &tcp.rotation);
        if self.reached != self.seat {
            let rest = self.seat - self.reached;
            self.reached += rest * (SLIDE_M_S * TICK_S / rest.norm()).min(1.0);
        }
        self.with_form(self.reached, nest, &tcp.rotation, &plate.rotation)
    }

    /// The nest couples: a new seat.
    pub(super) fn couple(&mut self, nest: &NestConfig, orientation: &Matrix3<f64>) {
        let bad = nest.kind.bad_seats();
        self.bad = bad.is_some_and(|bad| self.rng.random::<f64>() < bad.share);
        self.seat = draw(&mut self.rng, nest, self.bad);
        self.reached = self.seat;
        self.turned = *orientation;
    }

    /// The nest has turned to `orientation` about its sphere: the sphere may find another seat.
    pub(super) fn turn(&mut self, nest: &NestConfig, orientation: &Matrix3<f64>) {
        let Some(bad) = nest.kind.bad_seats() else { return };
        let angle = Rotation3::from_matrix_unchecked(orientation * self.turned.transpose()).angle();
        if angle < TURN_RAD {
            return;
        }
        self.turned = *orientation;
        if self.rng.random::<f64>() > libm::exp(-bad.per_rad * angle) {
            self.seat = draw(&mut self.rng, nest, self.bad);
        }
    }

    /// Seated centre in the nest's frame at an orientation of the nest, form errors included, in m.
    pub(super) fn seated(&self, nest: &NestConfig, orientation: &Matrix3<f64>, plate: &Matrix3<f64>) -> Vector3<f64> {
        self.with_form(self.seat, nest, orientation, plate)
    }

    /// A seat with the form errors at an orientation of the nest, in m, nest's frame.
    fn with_form(
        &self,
        seat: Vector3<f64>,
        nest: &NestConfig,
        orientation: &Matrix3<f64>,
        plate: &Matrix3<f64>,
    ) -> Vector3<f64> {
        let axis = plate.tr_mul(&orientation.column(2));
        let side = plate.tr_mul(&orientation.column(0));
        let place = Vector3::new(axis.x, axis.y, side.x + side.y);
        // The waves are added to the seat one by one: another order changes the last bits of every run.
        let mut form = seat;
        for (direction, wave, phase) in &self.waves {
            form += direction * (nest.form_sigma_m * libm::sin(wave.dot(&place) + phase));
        }
        form
    }
}

/// A seat, in m: normal in a good coupling, Cauchy in a `bad` one; at most [`LARGEST_M`].
fn draw(rng: &mut ChaCha8Rng, nest: &NestConfig, bad: bool) -> Vector3<f64> {
    let seat = normal3(rng);
    match nest.kind.bad_seats().filter(|_| bad) {
        Some(bad) => {
            // A normal number over another one.
            let spread = 1.0 / normal(rng).abs();
            (seat * bad.scale_m * spread).cap_magnitude(LARGEST_M)
        }
        None => seat * nest.seating_sigma_m,
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::plant::nest_kind::NestKind;

    fn socket() -> PlantConfig {
        let mut config = PlantConfig::typical();
        config.nest.kind = NestKind::Socket;
        config.nest.form_sigma_m = 0.0;
        config
    }

    // Fails if the share of bad couplings or the distribution of their seats differs from the
    // stated one: each coordinate of a Cauchy seat exceeds its scale in half of the draws, and five
    // times it in an eighth.
    #[test]
    fn some_couplings_are_bad() {
        let mut config = socket();
        config.nest.seating_sigma_m = 1e-9;
        let mut coupling = SeatScatter::new(&config);
        let seats: Vec<f64> = (0..8000)
            .map(|_| {
                coupling.couple(&config.nest, &Matrix3::identity());
                coupling.seat.x.abs()
            })
            .collect();
        let share = |beyond: f64| seats.iter().filter(|x| **x > beyond).count() as f64 / 8000.0;
        for (beyond, expected) in [(1e-7, 0.4), (5e-5, 0.2), (2.5e-4, 0.4 * 0.1257)] {
            assert!((share(beyond) - expected).abs() < 0.015, "{beyond}: {}", share(beyond));
        }
        assert!(seats.iter().all(|x| *x <= LARGEST_M));
    }

    // Fails if the sphere jumps to another seat: the pads would exert an impact of hundreds of
    // newtons.
    #[test]
    fn the_sphere_slides_to_another_seat() {
        let config = socket();
        let mut coupling = SeatScatter::new(&config);
        while !coupling.bad {
            coupling.couple(&config.nest, &Matrix3::identity());
        }
        coupling.near = true;
        let (plate, sphere) = (Pose::identity(), Vector3::zeros());
        let mut tcp = Pose::identity();
        let mut last = coupling.seat(&tcp, &plate, &sphere, &config);
        let mut travel = 0.0;
        for tick in 0..20_000 {
            let angle = 1.0 - libm::cos(f64::from(tick) * 1e-3);
            tcp.rotation = Rotation3::from_axis_angle(&Vector3::x_axis(), angle).into_inner();
            let seat = coupling.seat(&tcp, &plate, &sphere, &config);
            assert!((seat - last).norm() <= SLIDE_M_S * TICK_S * 1.001);
            travel += (seat - last).norm();
            last = seat;
        }
        assert!(travel > 1e-5, "it never moved");
    }

    // Fails if the rate of new seats depends on how the turn is cut into steps, or on time without turning.
    #[test]
    fn new_seats_come_with_turning() {
        let config = socket();
        let mut changes = [0, 0];
        for (steps, count) in [(1, 0), (25, 1)] {
            for k in 0..2000 {
                let mut coupling = SeatScatter::new(&PlantConfig {
                    seed: k,
                    ..config.clone()
                });
                coupling.couple(&config.nest, &Matrix3::identity());
                let first = coupling.seat;
                for step in 1..=steps {
                    let angle = 0.5 * f64::from(step) / f64::from(steps);
                    let turned = Rotation3::from_axis_angle(&Vector3::x_axis(), angle).into_inner();
                    coupling.turn(&config.nest, &turned);
                    coupling.turn(&config.nest, &turned);
                }
                changes[count] += usize::from(coupling.seat != first);
            }
        }
        // 1 − exp(−0.3 · 0.5) of 2000.
        for count in changes {
            assert!((count as f64 / 2000.0 - 0.139).abs() < 0.025, "{changes:?}");
        }
    }
}
