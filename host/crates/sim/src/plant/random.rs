//! The random streams of a cell's seed. Each error source has its own, so that switching one off
//! does not change the others.

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::StandardNormal;

/// Random streams of the error sources.
#[derive(Clone, Copy)]
pub(super) enum Stream {
    Geometry = 1,
    Tool,
    Compliance,
    Encoder,
    Friction,
    Inertia,
    Certificate,
    Placement,
    Bias,
    Seating,
    Sensors,
    Tracker,
    Sessions,
    Workspace,
    Hand,
    Offsets,
    Bending,
    Smooth,
    Cross,
    LostMotion,
    Scatter,
    Thermal,
    Reading,
    Still,
    Noise,
    Delay,
    Rotors,
    Cable,
}

pub(super) fn stream(seed: u64, which: Stream) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(which as u64);
    rng
}

/// A standard normal number.
pub(super) fn normal(rng: &mut ChaCha8Rng) -> f64 {
    rng.sample(StandardNormal)
}

/// A vector of three standard normal numbers.
pub(super) fn normal3(rng: &mut ChaCha8Rng) -> Vector3<f64> {
    Vector3::new(normal(rng), normal(rng), normal(rng))
}

/// Uniform between two bounds, equal ones allowed.
pub(super) fn between(rng: &mut ChaCha8Rng, [low, high]: [f64; 2]) -> f64 {
    low + (high - low) * rng.random::<f64>()
}

/// Rotation by roll, pitch and yaw about fixed axes, in rad.
pub(super) fn rpy([roll, pitch, yaw]: [f64; 3]) -> Matrix3<f64> {
    Rotation3::from_euler_angles(roll, pitch, yaw).into_inner()
}
