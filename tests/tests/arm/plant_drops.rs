//! Contact never creates energy: random drops of the nest onto a sphere.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal_shared::robot::{Arm, Dynamics, Pose, iiwa7, iiwa7_tool};

/// Joint angles for a TCP frame from a start, by damped least squares; `None` out of reach.
fn reach(arm: &Arm<f64, 7>, target: &Pose<f64>) -> Option<[f64; 7]> {
    let mut q = [0.0, 0.5, 0.0, -1.7, 0.0, 0.9, 0.0];
    for _ in 0..60 {
        let frames = arm.frames(&q);
        let tcp = arm.tcp_frame(&frames);
        let turn = nalgebra::Rotation3::from_matrix(&(target.rotation * tcp.rotation.transpose())).scaled_axis();
        let e = target.position - tcp.position;
        let error = SVector::<f64, 6>::from_iterator(e.iter().chain(turn.iter()).copied());
        let j = arm.jacobian(&frames, &tcp.position);
        let damped = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-5;
        let step = j.transpose() * damped.try_inverse()? * error;
        for i in 0..7 {
            q[i] += step[i].clamp(-0.2, 0.2);
        }
    }
    let tcp = arm.tcp_frame(&arm.frames(&q));
    ((tcp.position - target.position).norm() < 1e-6).then_some(q)
}

/// Gain of energy over the start in one drop, and the largest kinetic energy, in J.
fn drop_once(rng: &mut ChaCha8Rng, substep_s: f64) -> (f64, f64, bool) {
    let mut config = PlantConfig::ideal();
    config.substep_s = substep_s;
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a robot");
    let mut between = |low: f64, high: f64| low + (high - low) * rng.random::<f64>();
    let sphere = Vector3::from(config.cell.first().origin_m)
        + nalgebra::Rotation3::from_axis_angle(&Vector3::z_axis(), config.cell.first().rpy_rad[2])
            * Vector3::from(config.cell.plate.spheres_m[(between(0.0, 2.999)) as usize]);
    let tilt = nalgebra::Rotation3::new(Vector3::new(between(-0.2, 0.2), between(-0.2, 0.2), between(-0.4, 0.4)));
    let down = Matrix3::new(-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0);
    let target = Pose {
        rotation: tilt.into_inner() * down,
        position: sphere + Vector3::new(between(-0.015, 0.015), between(-0.015, 0.015), between(0.004, 0.05)),
    };
    let q = reach(&arm, &target).expect("above the plate");
    let frames = arm.frames(&q);
    let press = Vector3::new(between(-5.0, 5.0), between(-5.0, 5.0), -between(0.0, 30.0));
    let jacobian = arm.jacobian(&frames, &target.position);
    let force = SVector::<f64, 6>::from_column_slice(&[press.x, press.y, press.z, 0.0, 0.0, 0.0]);
    let torque = arm.bodies(&frames).gravity() + jacobian.transpose() * force;
    let tau: [f64; 7] = torque.into();
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &config, &q).expect("a plant");
    // A constant torque has the potential −tau q.
    let energy = |p: &Plant<7>| {
        let t = p.truth();
        (
            t.kinetic_j + t.potential_j - torque.dot(&SVector::from(t.q)),
            t.kinetic_j,
        )
    };
    let (start, _) = energy(&plant);
    let (mut gain, mut kinetic, mut touched) = (f64::NEG_INFINITY, 0.0_f64, false);
    for _ in 0..400 {
        plant.step(&tau);
        let (now, moving) = energy(&plant);
        gain = gain.max(now - start);
        kinetic = kinetic.max(moving);
        touched |= plant.truth().contact_n.norm() > 0.0;
    }
    (gain, kinetic, touched)
}

fn drops(count: u32, seed: u64, substep_s: f64) {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut worst, mut relative, mut hits) = (f64::NEG_INFINITY, f64::NEG_INFINITY, 0);
    for k in 0..count {
        let (gain, kinetic, touched) = drop_once(&mut rng, substep_s);
        hits += u32::from(touched);
        worst = worst.max(gain);
        relative = relative.max(gain / kinetic);
        assert!(
            gain < 2e-4 * kinetic + 1e-6,
            "drop {k}: {gain:.2e} J gained of {kinetic:.2e} J"
        );
    }
    println!(
        "{count} drops, {hits} with contact, step {substep_s}: most energy gained {worst:.2e} J, {relative:.2e} of the kinetic peak"
    );
    assert!(
        hits * 10 > count * 8,
        "most drops must meet something: {hits} of {count}"
    );
}

/// Fails if pads, rim, friction, magnet or integrator feed energy in.
#[test]
fn contact_never_creates_energy() {
    drops(60, 1, 2.5e-4);
}

/// The same over 1,000 drops.
#[test]
#[cfg_attr(debug_assertions, ignore = "long: run in release")]
fn long_contact_never_creates_energy_in_1000_drops() {
    drops(1000, 2, 2.5e-4);
}
