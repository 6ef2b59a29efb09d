//! How each error source is drawn from its stream of the seed.

use core::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use spherecal_shared::robot::{Arm, Frame, Inertia, Robot, Tool};

use super::config::{PlacementConfig, PlantConfig};
use super::error::PlantError;
use super::world::{JointError, MAX_SPHERES, Stream, Tone, between, normal, normal3, rpy, stream};

pub(super) fn draw_geometry<const N: usize>(
    nominal: &Robot,
    tool: &Tool,
    config: &PlantConfig,
) -> Result<Robot, PlantError> {
    let g = &config.geometry;
    if !g.enabled {
        return Ok(nominal.clone());
    }
    let mut rng = stream(config.seed, Stream::Geometry);
    let draws: Vec<[f64; 4]> = nominal
        .joints
        .iter()
        .map(|_| {
            [
                g.alpha_sigma_rad * normal(&mut rng),
                g.length_sigma_m * normal(&mut rng),
                g.theta_sigma_rad * normal(&mut rng),
                g.length_sigma_m * normal(&mut rng),
            ]
        })
        .collect();
    let scaled = |factor: f64| {
        let mut robot = nominal.clone();
        for (joint, [alpha, a, theta, d]) in robot.joints.iter_mut().zip(&draws).skip(1) {
            joint.mdh.alpha += factor * alpha;
            joint.mdh.a += factor * a;
            joint.mdh.theta += factor * theta;
            joint.mdh.d += factor * d;
        }
        robot
    };
    let mut factor = 1.0;
    if g.nominal_mean_m > 0.0 {
        let reference = Arm::<f64, N>::new(nominal, tool)?;
        for _ in 0..3 {
            let arm = Arm::<f64, N>::new(&scaled(factor), tool)?;
            let mean = mean_difference(nominal, &reference, &arm);
            if mean > 0.0 {
                factor *= g.nominal_mean_m / mean;
            }
        }
    }
    Ok(scaled(factor))
}

/// Mean distance of two arms' TCPs over 500 configurations in joint space, the
/// same for every seed, in m.
fn mean_difference<const N: usize>(nominal: &Robot, one: &Arm<f64, N>, other: &Arm<f64, N>) -> f64 {
    let mut rng = stream(0, Stream::Workspace);
    let count = 500;
    let sum: f64 = (0..count)
        .map(|_| {
            let q = core::array::from_fn(|i| {
                nominal
                    .joints
                    .get(i)
                    .map_or(0.0, |j| between(&mut rng, [j.limits.min_rad, j.limits.max_rad]))
            });
            let at = |arm: &Arm<f64, N>| arm.tcp_frame(&arm.frames(&q)).origin;
            (at(one) - at(other)).norm()
        })
        .sum();
    sum / f64::from(count)
}

pub(super) fn draw_masses(robot: &mut Robot, tool: &mut Tool, config: &PlantConfig) {
    let m = &config.inertia;
    if !m.mass_error {
        return;
    }
    let mut rng = stream(config.seed, Stream::Inertia);
    let scale = |body: &mut Inertia, factor: f64| {
        body.mass_kg *= factor;
        for entry in &mut body.inertia_kg_m2 {
            *entry *= factor;
        }
    };
    for joint in &mut robot.joints {
        scale(
            &mut joint.link,
            (1.0 + m.link_mass_sigma * normal(&mut rng)).clamp(0.2, 5.0),
        );
    }
    let size = between(&mut rng, m.tool_mass_error);
    let sign = if rng.random::<bool>() { 1.0 } else { -1.0 };
    scale(&mut tool.body, 1.0 + sign * size);
}

/// True pose of the plate in F0 in each of its placements.
pub(super) fn draw_plates(config: &PlantConfig) -> Vec<Frame<f64>> {
    let p = &config.plate;
    let mut rng = stream(config.seed, Stream::Placement);
    let place = |nominal: &PlacementConfig| {
        let mut rotation = rpy(nominal.rpy_rad);
        let mut origin = Vector3::from(nominal.origin_m);
        if p.placement_error {
            origin += normal3(&mut rng) * p.placement_sigma_m;
            rotation = Rotation3::new(normal3(&mut rng) * p.placement_sigma_rad).into_inner() * rotation;
        }
        Frame { rotation, origin }
    };
    p.placements().iter().map(place).collect()
}

pub(super) fn draw_spheres(
    config: &PlantConfig,
    plate: &Frame<f64>,
) -> heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES> {
    let p = &config.plate;
    let sigma = if p.certificate_error {
        p.certificate_sigma_m
    } else {
        0.0
    };
    let mut rng = stream(config.seed, Stream::Certificate);
    p.spheres_m
        .iter()
        .map(|certified| Some(plate.point(&(Vector3::from(*certified) + normal3(&mut rng) * sigma))))
        .take(MAX_SPHERES)
        .collect()
}

pub(super) fn draw_joint_errors<const N: usize>(config: &PlantConfig) -> [JointError; N] {
    let e = &config.encoder;
    let mut rng = stream(config.seed, Stream::Encoder);
    let root_half = core::f64::consts::FRAC_1_SQRT_2;
    core::array::from_fn(|_| {
        let mut error = JointError::default();
        for amplitude in &e.harmonic_rad {
            let pair = [normal(&mut rng), normal(&mut rng)].map(|x| x * amplitude * root_half);
            if e.harmonics {
                error.harmonics.push(pair);
            }
        }
        let [low, high] = e.gear_orders.map(f64::from);
        for _ in 0..3 {
            let tone = Tone {
                order: between(&mut rng, [low, high]).round(),
                amplitude: e.gear_rad * (2.0_f64 / 3.0).sqrt(),
                phase: between(&mut rng, [0.0, TAU]),
            };
            if e.gear && e.gear_rad > 0.0 {
                error.tones.push(tone);
            }
        }
        let features = 8;
        for _ in 0..features {
            let tone = Tone {
                order: normal(&mut rng) / e.smooth_length_rad.max(1e-3),
                amplitude: e.smooth_rad * (2.0 / f64::from(features)).sqrt(),
                phase: between(&mut rng, [0.0, TAU]),
            };
            if e.smooth_rad > 0.0 {
                error.tones.push(tone);
            }
        }
        for order in [1.0, 2.0] {
            let tone = Tone {
                order,
                amplitude: e.cross_rad,
                phase: between(&mut rng, [0.0, TAU]),
            };
            if e.cross_rad > 0.0 {
                error.cross.push(tone);
            }
        }
        error
    })
}
