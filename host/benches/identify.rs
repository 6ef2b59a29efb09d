//! Identification, single thread: geometry on 300 poses, the full structured
//! model with its covariance on 1,840 contacts, and how the time grows with the
//! number of poses; the first two beside NumPy on the same contacts in the same
//! run (`numpy_identify.py`; left out with a word where NumPy is not installed).

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use nalgebra::{Matrix3, SMatrix, Vector3};
use rand::{RngExt, SeedableRng};
use spherecal::identify::{Experiment, Method, Model, Observation, Options, Set, Target, identify, paper_plate};
use spherecal_shared::robot::kinematics::frames_into;
use spherecal_shared::robot::{LinkTransform, Pose, iiwa7, iiwa7_tool};
use std::hint::black_box;
use std::time::Instant;

/// Contacts (or measured points) of a slightly wrong arm at random configurations.
fn experiment(poses: usize, contacts: bool) -> Experiment {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(1);
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let links: Vec<_> = robot
        .joints
        .iter()
        .map(|joint| {
            let mut row = joint.mdh;
            row.alpha += random.random_range(-1e-3..1e-3);
            row.a += random.random_range(-4e-4..4e-4);
            row.theta += random.random_range(-1e-3..1e-3);
            LinkTransform::from(&row)
        })
        .collect();
    let spheres = paper_plate();
    let observations = (0..poses).map(|i| {
        let mut q: Vec<f64> = (0..7).map(|_| random.random_range(-1.5..1.5)).collect();
        let mut frames = [Pose::identity(); 7];
        let mut tcp = |q: &[f64]| frames_into(&links, q, &mut frames).point(&tool.tcp());
        let sphere = i % 3;
        let target = if contacts {
            // Damped Newton onto the sphere, with small numerical derivatives: no need of inverse kinematics.
            let centre = Vector3::new(0.45, -0.1, 0.3) + Vector3::from(spheres[sphere].position_m);
            for _ in 0..200 {
                let e = tcp(&q) - centre;
                let mut jacobian = SMatrix::<f64, 3, 7>::zeros();
                for j in 0..7 {
                    let mut moved = q.clone();
                    moved[j] += 1e-6;
                    jacobian.set_column(j, &((tcp(&moved) - centre - e) / 1e-6));
                }
                let normal = jacobian * jacobian.transpose() + Matrix3::identity() * 1e-3;
                let step = jacobian.transpose() * normal.try_inverse().expect("damped") * e;
                let shorter = (0.3 / step.norm()).min(1.0);
                q.iter_mut().zip(&step).for_each(|(q, step)| *q -= shorter * step);
            }
            assert!((tcp(&q) - centre).norm() < 1e-9, "a pose off its sphere");
            Target::Sphere {
                sphere: spheres[sphere].id,
                place: 0,
            }
        } else {
            Target::Point((tcp(&q) + Vector3::from_fn(|_, _| random.random_range(-5e-5..5e-5))).into())
        };
        // Gear noise: without any there is nothing to weigh, and no search settles.
        for angle in &mut q {
            *angle += random.random_range(-1e-4..1e-4);
        }
        Observation {
            seat: None,
            q,
            tau: None,
            target,
            set: Set::Calibrate,
        }
    });
    let observations = observations.collect();
    Experiment {
        robot: robot.clone(),
        tool,
        spheres,
        observations,
    }
}

fn options(method: Method) -> Options {
    let default = Options::default();
    Options {
        method,
        model: Model::Full,
        // Geometry by least squares, as NumPy does it: robust weights would take a full fit before it.
        student_t: if method == Method::Geometry {
            0.0
        } else {
            default.student_t
        },
        ..default
    }
}

fn identification(c: &mut Criterion) {
    let mut group = c.benchmark_group("identify");
    group.sample_size(20);
    for (name, method, poses) in [
        ("geometry_300", Method::Geometry, 300),
        ("full_1840", Method::Full, 1840),
        ("full_300", Method::Full, 300),
    ] {
        let data = experiment(poses, true);
        let options = options(method);
        group.bench_function(name, |b| {
            b.iter_batched(
                || (),
                |()| black_box(identify(black_box(&data), &options).map(|c| c.residual.rms_mm)),
                BatchSize::SmallInput,
            );
        });
    }
    group.finish();
    let mut group = c.benchmark_group("identify_scaling");
    group.sample_size(10);
    for poses in [1_000, 10_000, 100_000, 1_000_000] {
        let data = experiment(poses, false);
        let options = options(Method::Geometry);
        group.throughput(Throughput::Elements(poses as u64));
        group.bench_function(format!("geometry_{poses}"), |b| {
            b.iter(|| black_box(identify(black_box(&data), &options).map(|c| c.residual.rms_mm)));
        });
    }
    group.finish();
}

/// Best time of several, in ms: what else runs on the machine only adds.
fn best_ms(data: &Experiment, options: &Options) -> f64 {
    let times = (0..15).map(|_| {
        let start = Instant::now();
        black_box(identify(black_box(data), options).map(|c| c.residual.rms_mm)).ok();
        start.elapsed().as_secs_f64() * 1e3
    });
    times.fold(f64::INFINITY, f64::min)
}

/// The time of NumPy for the same contacts, in ms; none where it cannot run.
fn numpy_ms(data: &Experiment, model: &str) -> Option<f64> {
    let mut csv = String::from("q1,q2,q3,q4,q5,q6,q7,sphere\n");
    for (i, o) in data.observations.iter().enumerate() {
        let joints: Vec<_> = o.q.iter().map(|q| format!("{q:?}")).collect();
        csv += &format!("{},{}\n", joints.join(","), i % 3);
    }
    let file = std::env::temp_dir().join(format!("spherecal_bench_{}_{model}.csv", std::process::id()));
    std::fs::write(&file, csv).ok()?;
    let script = concat!(env!("CARGO_MANIFEST_DIR"), "/benches/numpy_identify.py");
    let run = std::process::Command::new("python3")
        .args([script, model])
        .arg(&file)
        .envs([("OMP_NUM_THREADS", "1"), ("OPENBLAS_NUM_THREADS", "1")])
        .output();
    std::fs::remove_file(&file).ok();
    String::from_utf8(run.ok()?.stdout).ok()?.trim().parse().ok()
}

/// One line a model: our time, NumPy's, and their ratio.
fn beside_numpy(_: &mut Criterion) {
    for (model, method, poses) in [("geometry", Method::Geometry, 300), ("structured", Method::Full, 1840)] {
        let data = experiment(poses, true);
        let ours = best_ms(&data, &options(method));
        let beside = match numpy_ms(&data, model) {
            Some(theirs) => format!("NumPy {theirs:.2} ms, ratio {:.3}", ours / theirs),
            None => "NumPy left out: `pip install numpy` for python3".to_owned(),
        };
        println!("{model} on {poses} contacts: {ours:.2} ms; {beside}");
    }
}

criterion_group!(benches, beside_numpy, identification);
criterion_main!(benches);
