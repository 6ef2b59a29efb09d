//! Simulated robots whose cell is not what its user says.

use nalgebra::{Matrix3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use spherecal::model::Chain;
use spherecal::sim::plant::PlantConfig;
use spherecal::sim::worlds::World;
use spherecal_lab::worlds::{ContactPose, Trial, record_plant};

/// What is wrong with a cell, besides what its world says.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) enum Broken {
    Nothing,
    /// One coordinate of the certificate is wrong (m), in the plane of the spheres: normal to it,
    /// three spheres cannot tell a wrong coordinate from a plate that is tilted.
    Certificate(f64),
    /// The plate slips half way (m).
    Slip(f64),
    /// The plate drifts from first to last contact (m).
    Drift(f64),
    /// The TCP sags by this (m) times the square of joint 2's angle.
    Deflection(f64),
    /// A share of the contacts is 3 to 6 mm off.
    Outliers(f64),
    /// Each joint's error depends on another joint (rad).
    CrossJoint(f64),
    /// Joint deflection has a term quadratic in the torque (rad/(N m)²).
    Quadratic(f64),
    /// The links grow by this in the first hour (m).
    Links(f64),
    /// Harmonics of orders 3 to 6 (rad each).
    Harmonics(f64),
}

/// Moves what the contacts touch by `by(index, q)` (F0, m): the arm follows.
pub(crate) fn move_contacts(trial: &mut Trial, mut by: impl FnMut(usize, &[f64]) -> Vector3<f64>) {
    let experiment = &mut trial.spheres;
    let chain = Chain::unchecked(&experiment.robot, &experiment.tool);
    for (index, observation) in experiment.observations.iter_mut().enumerate() {
        let by = by(index, &observation.q);
        let tcp = chain.pose(&observation.q).position;
        let frames = chain.frames(&observation.q);
        let columns: Vec<Vector3<f64>> = frames.iter().map(|f| f.z().cross(&(tcp - f.position))).collect();
        let square = columns.iter().fold(Matrix3::zeros(), |s, c| s + c * c.transpose());
        let pull = square.try_inverse().expect("not singular") * by;
        for (angle, column) in observation.q.iter_mut().zip(&columns) {
            *angle += column.dot(&pull);
        }
    }
}

/// Displacement of the TCP (F0, m) where it sags.
fn sag(size: f64, q: &[f64]) -> Vector3<f64> {
    Vector3::z() * (-size * q[1] * q[1])
}

/// A robot of a world, measured in a broken cell.
pub(crate) fn record(world: World, broken: Broken, seed: u64, poses: &[ContactPose]) -> Trial {
    let mut plant = PlantConfig { seed, ..world.plant() };
    match broken {
        Broken::CrossJoint(rad) => plant.encoder.cross_rad = rad,
        Broken::Quadratic(size) => plant.compliance.quadratic_rad_per_nm2 = size,
        Broken::Links(size) => {
            plant.thermal.enabled = true;
            plant.thermal.links_m = [size; 2];
            plant.thermal.plate_m = [0.0; 2];
        }
        Broken::Harmonics(rad) => plant.encoder.harmonic_rad.extend([rad; 4]),
        _ => {}
    }
    let mut trial = record_plant(world, plant, poses).expect("the built-in worlds work");
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let angle = random.random_range(0.0..core::f64::consts::TAU);
    let sideways = Vector3::new(angle.cos(), angle.sin(), 0.0);
    let last = (poses.len() - 1) as f64;
    match broken {
        Broken::Certificate(size) => {
            let (sphere, axis) = [(1, 0), (2, 0), (2, 1), (0, 0), (1, 1)][seed as usize % 5];
            trial.spheres.spheres[sphere].position_m[axis] += size;
        }
        Broken::Slip(size) => move_contacts(&mut trial, |k, _| {
            if k < poses.len() / 2 {
                Vector3::zeros()
            } else {
                sideways * size
            }
        }),
        Broken::Drift(size) => move_contacts(&mut trial, |k, _| sideways * (size * k as f64 / last)),
        Broken::Deflection(size) => {
            // A TCP that sags stands on the sphere where its model would be above it.
            move_contacts(&mut trial, |_, q| -sag(size, q));
            let base = trial.base();
            let points = trial.validation.iter().zip(&mut trial.validation_truth_m);
            for (measured, truth) in points {
                let moved = Vector3::from(*truth) + base.rotation * sag(size, &measured.q);
                *truth = moved.into();
            }
        }
        Broken::Outliers(share) => move_contacts(&mut trial, |_, _| {
            let roll: f64 = random.random();
            let along = Vector3::from_fn(|_, _| random.random_range(-1.0..1.0)).normalize();
            let far = random.random_range(3e-3..6e-3);
            if roll < share { along * far } else { Vector3::zeros() }
        }),
        Broken::Nothing | Broken::CrossJoint(_) | Broken::Quadratic(_) | Broken::Harmonics(_) | Broken::Links(_) => {}
    }
    trial
}
