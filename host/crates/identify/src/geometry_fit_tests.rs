//! Geometry alone of an arm that yields: which of its rows count.

use nalgebra::Vector3;
use proptest::prelude::*;
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{Inertia, Robot, Tool, built_in, iiwa7_tool};

use super::*;
use crate::calibration::finish;
use crate::load::Nominal;
use crate::{Calibration, EvaluateOptions, Method, Noise, Observation, Recordings, Set, Target, evaluate, identify};

/// Poses in front of the arm, where the joints carry load.
const LOADED: usize = 110;
/// Poses with the arm upright, where they carry none.
const UPRIGHT: usize = 14;

/// An arm with a tool of 2 kg.
fn arm() -> (Robot, Tool) {
    let tool = Tool {
        body: Inertia {
            mass_kg: 2.0,
            com_m: [0.0, 0.0, 0.1],
            inertia_kg_m2: [0.0; 6],
        },
        ..iiwa7_tool()
    };
    (built_in("iiwa7").unwrap(), tool)
}

/// The TCP (m) of the arm that yields, with link 3 of its table 0.8 mm longer.
fn real(robot: &Robot, tool: &Tool) -> impl Fn(&[f64]) -> Vector3<f64> + use<> {
    let mut own = robot.clone();
    own.joints[2].mdh.d += 8e-4;
    let chain = Chain::unchecked(&own, tool);
    let nominal = Nominal::new(robot, tool);
    let compliance = [3e-5, 6e-5, 4e-5, 5e-5, 0.0, 0.0, 0.0];
    move |q: &[f64]| {
        let load = nominal.load(q, None);
        let bent: Vec<f64> = (0..q.len()).map(|j| q[j] - compliance[j] * load.joint[j][2]).collect();
        chain.tcp_of(&chain.frames(&bent))
    }
}

fn noise(random: &mut ChaCha8Rng, sigma: f64) -> Vector3<f64> {
    Vector3::from_fn(|_, _| {
        let z: f64 = StandardNormal.sample(random);
        sigma * z
    })
}

/// Loaded poses, then upright ones; `gross` of the loaded rows are 5 mm off.
fn seen(seed: u64, gross: usize) -> Experiment {
    let (robot, tool) = arm();
    let tcp = real(&robot, &tool);
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut poses: Vec<Vec<f64>> = Vec::new();
    for _ in 0..LOADED {
        let mut any = |low: f64, high: f64| low + (high - low) * random.random::<f64>();
        poses.push(vec![
            any(-2.5, 2.5),
            any(0.2, 1.6),
            any(-1.5, 1.5),
            any(-1.9, -0.1),
            any(-2.5, 2.5),
            any(-1.8, 1.8),
            any(-2.8, 2.8),
        ]);
    }
    for _ in 0..UPRIGHT {
        let mut any = |width: f64| width * (2.0 * random.random::<f64>() - 1.0);
        poses.push(vec![
            any(2.5),
            any(0.06),
            any(2.5),
            any(0.06),
            any(2.5),
            any(0.1),
            any(2.5),
        ]);
    }
    let observations = poses.into_iter().enumerate().map(|(k, q)| {
        let mut point = tcp(&q) + noise(&mut random, 3e-5);
        if k % (LOADED / gross.max(1)) == 3 && gross > 0 && k < LOADED {
            point += noise(&mut random, 1.0).normalize() * 5e-3;
        }
        Observation {
            seat: None,
            q,
            tau: None,
            target: Target::Point(point.into()),
            set: Set::Calibrate,
        }
    });
    Experiment {
        observations: observations.collect(),
        robot,
        tool,
        spheres: Vec::new(),
    }
}

fn geometry() -> Options {
    Options {
        method: Method::Geometry,
        ..Options::default()
    }
}

/// Distances (m) of a calibration's TCP from the real one at the poses of the data.
fn errors(calibration: &Calibration, experiment: &Experiment) -> Vec<f64> {
    let tcp = real(&experiment.robot, &experiment.tool);
    let rows = experiment.observations.iter();
    rows.map(|o| (calibration.tcp_world_m(&o.q, None) - tcp(&o.q)).norm())
        .collect()
}

fn rms(values: &[f64]) -> f64 {
    (values.iter().map(|x| x * x).sum::<f64>() / values.len() as f64).sqrt()
}

/// The fit with the weights of its own residuals.
fn by_own_weights(experiment: &Experiment) -> Calibration {
    let fit = map::fit(experiment, &geometry(), Model::Geometry, |_| true).unwrap();
    finish(experiment, &geometry(), Model::Geometry, fit)
}

/// Geometry by least squares to what the full model says at the poses of the data.
fn projection(experiment: &Experiment) -> Calibration {
    let full = identify(experiment, &Options::default()).unwrap();
    let mut said = experiment.clone();
    for o in &mut said.observations {
        o.target = Target::Point(full.tcp_world_m(&o.q, None).into());
    }
    let plain = Options {
        student_t: 0.0,
        ..geometry()
    };
    identify(&said, &plain).unwrap()
}

// Fails if poses without load are taken for outliers of a geometry, although the full model follows them: by the
// weights of its own residuals they count a sixth or less.
#[test]
fn poses_without_load_count_in_geometry_alone() {
    for (seed, gross) in [(1, 0), (2, 0), (1, 6), (2, 6)] {
        let experiment = seen(seed, gross);
        let before = by_own_weights(&experiment);
        let found = identify(&experiment, &geometry()).unwrap();
        let weight = |c: &Calibration| {
            let rows = &c.residual.rows[LOADED..];
            rows.iter().map(|row| row.weight).sum::<f64>() / rows.len() as f64
        };
        assert!(weight(&before) < 0.17, "{}", weight(&before));
        assert!(weight(&found) > 0.9, "{}", weight(&found));
        let (was, is) = (errors(&before, &experiment), errors(&found, &experiment));
        let largest = |e: &[f64]| e.iter().copied().fold(0.0, f64::max);
        assert!(rms(&is) < 0.95 * rms(&was), "{} {}", rms(&is), rms(&was));
        assert!(
            largest(&is) < 0.85 * largest(&was),
            "{} {}",
            largest(&is),
            largest(&was)
        );
        // What is left is close to the best that a geometry can say of the full model.
        let best = projection(&experiment);
        let apart = |c: &Calibration| {
            let rows = experiment.observations.iter();
            let off = rows.map(|o| (c.tcp_world_m(&o.q, None) - best.tcp_world_m(&o.q, None)).norm());
            rms(&off.collect::<Vec<f64>>())
        };
        assert!(
            apart(&found) < 0.25 * apart(&before),
            "{} {}",
            apart(&found),
            apart(&before)
        );
    }
}

// Fails if rows that are 5 mm off count in geometry alone, are not named, or if rows that the full model follows are.
#[test]
fn gross_errors_stay_outliers_of_geometry_alone() {
    for seed in 1..4 {
        let experiment = seen(seed, 6);
        let found = identify(&experiment, &geometry()).unwrap();
        let full = identify(&experiment, &Options::default()).unwrap();
        let named = |c: &Calibration| -> Vec<usize> { c.residual.outliers.iter().map(|o| o.index).collect() };
        let is_gross = |i: usize| i < LOADED && i % (LOADED / 6) == 3;
        assert_eq!(named(&found), named(&full));
        let gross = found.residual.rows.iter().filter(|row| is_gross(row.index));
        let gross: Vec<_> = gross.map(|row| (row.index, row.weight)).collect();
        assert!(
            gross.iter().all(|(i, w)| *w < 0.2 && named(&found).contains(i)),
            "{gross:?}"
        );
        assert!(named(&found).len() <= gross.len() + 3, "{:?}", named(&found));
        // They move the TCP little.
        let clean = identify(&seen(seed, 0), &geometry()).unwrap();
        let (with, without) = (errors(&found, &experiment), errors(&clean, &experiment));
        assert!(rms(&with) < 1.03 * rms(&without), "{} {}", rms(&with), rms(&without));
    }
}

// Fails if the frames' alignment leaves poses without load out as gross errors.
#[test]
fn poses_without_load_are_no_gross_errors() {
    let options = EvaluateOptions {
        identify: geometry(),
        choose_priors: false,
        cross_validate: false,
        diagnose: false,
        ..EvaluateOptions::default()
    };
    let found = evaluate(&Recordings::new(seen(1, 0)), &options, &mut |_| {}).unwrap();
    assert_eq!(found.rejected, []);
    assert!(
        found.calibration.residual.rows[LOADED..]
            .iter()
            .all(|row| row.weight > 0.8)
    );
}

// Fails if an arm without effects is fitted otherwise than by its own weights, which are right there: the model has no
// error beside the noise.
#[test]
fn a_geometry_without_effects_keeps_its_weights() {
    let mut experiment = seen(4, 0);
    let chain = Chain::unchecked(&experiment.robot, &experiment.tool);
    let mut random = ChaCha8Rng::seed_from_u64(9);
    for o in &mut experiment.observations {
        let point = chain.pose(&o.q).position + noise(&mut random, 5e-5);
        o.target = Target::Point(point.into());
    }
    let (own, found) = (by_own_weights(&experiment), identify(&experiment, &geometry()).unwrap());
    let rows = experiment.observations.iter();
    let apart = rows.map(|o| (own.tcp_world_m(&o.q, None) - found.tcp_world_m(&o.q, None)).norm());
    assert!(rms(&apart.collect::<Vec<f64>>()) < 1e-5);
    assert!((found.noise_scale / own.noise_scale - 1.0).abs() < 0.1);
}

proptest! {
    // Fails if the model's error is not that at which the residuals have the size of their noise, if it is negative,
    // or if a row with more noise counts more.
    #[test]
    fn the_models_error_explains_the_residuals(
        rows in prop::collection::vec((0.0..100.0_f64, 0.1..10.0_f64), 4..40),
        effective in 0.0..6.0_f64,
    ) {
        let noise = RowNoise {
            whitening: Whitening::new(&Noise::default()),
            s2: 1.0,
            variance: rows.iter().map(|r| r.1).collect(),
        };
        let squared: Vec<Squared> = rows.iter().map(|r| Squared { d2: r.0, numbers: 3.0 }).collect();
        let (s2, weights) = noise.with_model_error(&squared, effective);
        prop_assert!(s2 >= 1.0);
        let sum: f64 = squared.iter().zip(&weights).map(|(row, w)| row.d2 * w / s2).sum();
        let freedom = 3.0 * rows.len() as f64 - effective;
        prop_assert!(sum <= freedom * (1.0 + 1e-6), "{} {}", sum, freedom);
        prop_assert!(s2 == 1.0 || sum >= freedom * (1.0 - 1e-6), "{} {}", sum, freedom);
        for (a, wa) in rows.iter().zip(&weights) {
            for (b, wb) in rows.iter().zip(&weights) {
                prop_assert!(a.1 <= b.1 || wa <= wb);
            }
        }
    }
}
