//! Cost of one control tick (1 ms) of the plant on one core.
//!
//! `cargo bench -p spherecal --bench plant`. Each measurement is a tick of the
//! default step: free (one Runge-Kutta step of 1 ms), seated (four implicit
//! sub-steps with three pads, magnet and plate), the same with dry joint
//! friction and the typical preset's errors and sensors. `tests/python/mujoco_speed.py`
//! times MuJoCo's `mj_step` on the same model.
//!
//! Measured on one shared x86-64 core, least over samples, µs a tick of 1 ms:
//! free ideal 2.8, free typical 3.7, seated ideal 3.0, seated with joint
//! friction 4.2, seated typical 4.7; so 0.74 and 1.04 µs a seated sub-step
//! without and with joint friction. MuJoCo 4.0 there, processor time a step:
//! free 2.7, seated 8.3, seated with joint friction 10.5 (`plant.md` states
//! 2.4, 4.8 and 5.2 for its model and machine).

use std::hint::black_box;

use criterion::{Criterion, criterion_group, criterion_main};
use nalgebra::{Matrix3, SMatrix, SVector};
use spherecal::plant::{Plant, PlantConfig};
use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

/// A plant seated on sphere 1 and the torque that holds it there.
fn seated(config: &PlantConfig) -> (Plant<7>, [f64; 7]) {
    let far = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), config, &[0.0; 7]).expect("a plant");
    let sphere = far.world().spheres[0].expect("a sphere");
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a robot");
    let down = Matrix3::new(-1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, -1.0);
    let mut q = [0.0, 0.7, 0.0, -1.4, 0.0, 1.0, 0.0];
    for _ in 0..200 {
        // Newton on the true arm, through its encoders.
        let link = far.world().link_angles_at_rest(&q);
        let tcp = far.world().tcp(&link);
        let turn = nalgebra::Rotation3::from_matrix(&(down * tcp.rotation.transpose())).scaled_axis();
        let error = SVector::<f64, 6>::from_iterator((sphere - tcp.origin).iter().chain(turn.iter()).copied());
        let j = arm.jacobian(&arm.frames(&q), &tcp.origin);
        let damped = j * j.transpose() + SMatrix::<f64, 6, 6>::identity() * 1e-6;
        let step = j.transpose() * damped.try_inverse().expect("regular") * error;
        for i in 0..7 {
            q[i] += step[i].clamp(-0.2, 0.2);
        }
    }
    let mut plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &q).expect("a plant");
    let hold = spherecal_shared::robot::Dynamics::bodies(&far.world().arm, &arm.frames(&q)).gravity();
    for _ in 0..2000 {
        let mut tau: [f64; 7] = hold.into();
        let sensed = plant.sensed();
        for i in 0..7 {
            tau[i] += 20.0 * (q[i] - sensed.q[i]) - 3.0 * sensed.dq[i];
        }
        plant.step(&tau);
    }
    assert_eq!(plant.truth().seated, Some(0), "{:?}", plant.truth());
    let tau = plant.sensed().tau;
    (plant, tau)
}

fn benches(c: &mut Criterion) {
    let mut group = c.benchmark_group("plant tick");
    let q = [0.3, 0.6, -0.2, -1.2, 0.4, 0.9, 0.1];
    let free = PlantConfig {
        contact: false,
        ..PlantConfig::ideal()
    };
    let plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &free, &q).expect("a plant");
    let tau = plant.sensed().tau;
    let mut moving = plant;
    group.bench_function("free, ideal", |b| b.iter(|| black_box(moving.step(black_box(&tau)))));
    let (mut plant, tau) = seated(&PlantConfig::ideal());
    group.bench_function("seated, ideal", |b| b.iter(|| black_box(plant.step(black_box(&tau)))));
    let mut dry = PlantConfig::ideal();
    dry.friction.enabled = true;
    let (mut plant, tau) = seated(&dry);
    group.bench_function("seated, joint friction", |b| {
        b.iter(|| black_box(plant.step(black_box(&tau))));
    });
    let (mut plant, tau) = seated(&PlantConfig::typical());
    group.bench_function("seated, typical", |b| b.iter(|| black_box(plant.step(black_box(&tau)))));
    let typical = PlantConfig::typical();
    let mut plant = Plant::<7>::new(&iiwa7(), &iiwa7_tool(), &typical, &q).expect("a plant");
    let tau = plant.sensed().tau;
    group.bench_function("free, typical", |b| b.iter(|| black_box(plant.step(black_box(&tau)))));
    group.finish();
}

criterion_group!(plant, benches);
criterion_main!(plant);
