//! Draws each error source from its stream of the seed.

use core::f64::consts::TAU;

use nalgebra::{Rotation3, Vector3};
use rand::RngExt;
use spherecal_model::{MAX_SPHERES, Placement};
use spherecal_shared::robot::{Arm, Inertia, Pose, Robot, Tool};

use super::config::PlantConfig;
use super::error::PlantError;
use super::joint::{JointError, PathMemory, Tone};
use super::random::{Stream, between, normal, normal3, rpy, stream};

/// Number of waves that replace a Gaussian process (random Fourier features). Their squares add up
/// to its variance for any number.
const FEATURES: u32 = 16;

/// The true geometry, and the factor by which the draws were scaled.
pub(super) fn draw_geometry<const N: usize>(
    nominal: &Robot,
    tool: &Tool,
    config: &PlantConfig,
) -> Result<(Robot, f64), PlantError> {
    let g = &config.geometry;
    if !g.enabled {
        return Ok((nominal.clone(), 1.0));
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
    if g.nominal_mean_m > 0.0 && g.overall_mean_m == 0.0 {
        let reference = Arm::<f64, N>::new(nominal, tool)?;
        for _ in 0..3 {
            let arm = Arm::<f64, N>::new(&scaled(factor), tool)?;
            let mean = mean_difference(nominal, &reference, &arm);
            if mean > 0.0 {
                factor *= g.nominal_mean_m / mean;
            }
        }
    }
    Ok((scaled(factor), factor))
}

/// Joint offsets of a robot that was never mastered well.
pub(super) fn draw_offsets(robot: &mut Robot, config: &PlantConfig) {
    let g = &config.geometry;
    if !g.enabled || g.offset_share == 0.0 {
        return;
    }
    let mut rng = stream(config.seed, Stream::Offsets);
    let bad = rng.random::<f64>() < g.offset_share;
    for joint in robot.joints.iter_mut().skip(1) {
        let offset = between(&mut rng, [-g.offset_rad, g.offset_rad]);
        if bad {
            joint.mdh.theta += offset;
        }
    }
}

/// 500 configurations in joint space, the same for every seed, in rad.
pub(super) fn anywhere<const N: usize>(nominal: &Robot) -> impl Iterator<Item = [f64; N]> + '_ {
    let mut rng = stream(0, Stream::Workspace);
    (0..500).map(move |_| {
        core::array::from_fn(|i| {
            nominal
                .joints
                .get(i)
                .map_or(0.0, |j| between(&mut rng, [j.limits.min_rad, j.limits.max_rad]))
        })
    })
}

/// Mean distance of two arms' TCPs over [`anywhere`], in m.
fn mean_difference<const N: usize>(nominal: &Robot, one: &Arm<f64, N>, other: &Arm<f64, N>) -> f64 {
    let at = |arm: &Arm<f64, N>, q: &[f64; N]| arm.tcp_frame(&arm.frames(q)).position;
    let sum: f64 = anywhere::<N>(nominal)
        .map(|q| (at(one, &q) - at(other, &q)).norm())
        .sum();
    sum / 500.0
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
pub(super) fn draw_plates(config: &PlantConfig) -> Vec<Pose<f64>> {
    let p = &config.plate;
    let mut rng = stream(config.seed, Stream::Placement);
    let place = |nominal: &Placement| {
        let mut rotation = rpy(nominal.rpy_rad);
        let mut origin = Vector3::from(nominal.origin_m);
        if p.placement_error {
            origin += normal3(&mut rng) * p.placement_sigma_m;
            rotation = Rotation3::new(normal3(&mut rng) * p.placement_sigma_rad).into_inner() * rotation;
        }
        Pose::new(rotation, origin)
    };
    config.cell.placements.iter().map(place).collect()
}

pub(super) fn draw_spheres(
    config: &PlantConfig,
    plate: &Pose<f64>,
) -> heapless::Vec<Option<Vector3<f64>>, MAX_SPHERES> {
    let plate_in_cell = &config.cell.plate;
    let sigma = if config.plate.certificate_error {
        plate_in_cell.certificate_sigma_m
    } else {
        0.0
    };
    let mut rng = stream(config.seed, Stream::Certificate);
    plate_in_cell
        .spheres_m
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
                other_order: 0.0,
                amplitude: e.gear_rad * (2.0_f64 / 3.0).sqrt(),
                phase: between(&mut rng, [0.0, TAU]),
            };
            if e.gear && e.gear_rad > 0.0 {
                error.tones.push(tone);
            }
        }
        // Earlier versions drew ten tones here. The draws stay, so that a seed still gives the same
        // robot.
        for _ in 0..8 {
            normal(&mut rng);
            between(&mut rng, [0.0, TAU]);
        }
        for _ in 0..2 {
            between(&mut rng, [0.0, TAU]);
        }
        error
    })
}

/// Smooth errors of the joint, and errors of two joints together, each on its own stream.
pub(super) fn draw_joint_functions<const N: usize>(config: &PlantConfig, errors: &mut [JointError; N]) {
    let e = &config.encoder;
    let share = (2.0 / f64::from(FEATURES)).sqrt();
    if e.smooth_rad > 0.0 {
        let mut rng = stream(config.seed, Stream::Smooth);
        for error in errors.iter_mut() {
            error.tones.extend((0..FEATURES).map(|_| Tone {
                order: normal(&mut rng) / e.smooth_length_rad.max(1e-3),
                other_order: 0.0,
                amplitude: e.smooth_rad * share,
                phase: between(&mut rng, [0.0, TAU]),
            }));
        }
    }
    if e.cross_rad > 0.0 && N > 1 {
        let mut rng = stream(config.seed, Stream::Cross);
        for (i, error) in errors.iter_mut().enumerate() {
            error.other = (i + rng.random_range(1..N)) % N;
            error.cross.extend((0..FEATURES).map(|_| Tone {
                order: normal(&mut rng) / e.cross_length_rad.max(1e-3),
                other_order: normal(&mut rng) / e.cross_length_rad.max(1e-3),
                amplitude: e.cross_rad * share,
                phase: between(&mut rng, [0.0, TAU]),
            }));
        }
    }
}

/// Compliance of each joint, in rad/(N m), with gears of these sizes.
pub(super) fn draw_compliance<const N: usize>(config: &PlantConfig, gear: &[f64; N]) -> [f64; N] {
    let c = &config.compliance;
    let mut rng = stream(config.seed, Stream::Compliance);
    core::array::from_fn(|i| {
        let drawn = if let Some(range) = c.joints_rad_per_nm.get(i) {
            between(&mut rng, *range)
        } else {
            let factor = between(&mut rng, [1.0 - c.spread, 1.0 + c.spread]);
            c.joint_rad_per_nm * factor
        };
        let stiffness = config.elasticity.stiffness_nm_rad;
        let compliance = if config.elasticity.enabled && stiffness > 0.0 {
            1.0 / stiffness
        } else if c.enabled || config.elasticity.enabled {
            drawn
        } else {
            0.0
        };
        compliance / gear[i]
    })
}

/// Bending of each link about x and y of its joint's frame, and tilt of the base, in rad/(N m).
pub(super) fn draw_bending<const N: usize>(config: &PlantConfig) -> ([[f64; 2]; N], [f64; 2]) {
    let c = &config.compliance;
    if !c.enabled {
        return ([[0.0; 2]; N], [0.0; 2]);
    }
    let mut rng = stream(config.seed, Stream::Bending);
    let mut pair = |mean: f64, sigma: f64| [(); 2].map(|()| mean + sigma * normal(&mut rng));
    let links = core::array::from_fn(|_| pair(c.link_rad_per_nm, c.link_sigma_rad_per_nm));
    (links, pair(c.base_rad_per_nm, c.base_sigma_rad_per_nm))
}

/// The state of each joint that depends on its path.
pub(super) fn draw_memory<const N: usize>(config: &PlantConfig) -> [PathMemory; N] {
    let (l, e) = (&config.lost_motion, &config.encoder);
    let mut rng = stream(config.seed, Stream::LostMotion);
    core::array::from_fn(|_| {
        let drawn = between(&mut rng, l.half_width_rad);
        PathMemory {
            half_width: if l.enabled { drawn } else { 0.0 },
            travel: l.travel_rad,
            scatter: e.scatter_rad,
            scatter_travel: e.scatter_travel_rad,
        }
    })
}
