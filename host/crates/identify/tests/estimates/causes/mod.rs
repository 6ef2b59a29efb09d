//! Score tests and expected error on drawn robots, with and without injected errors.
//!
//! The robots here are drawn by this file alone: geometry, once-per-turn encoder
//! errors, noise of joints and of seating. Their sizes are not those of the priors.

mod budget;
mod patterns;

use nalgebra::{Matrix3, Rotation3, Vector3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution, StandardNormal};
use spherecal_identify::causes::{Alternative, Course};
use spherecal_identify::{
    EvaluateOptions, Evaluation, Experiment, Observation, Pose, Recordings, Set, Target, Verdict, evaluate,
    paper_plate, workspace,
};
use spherecal_model::{Chain, fit_pose};
use spherecal_shared::robot::{Robot, Tool, iiwa7, iiwa7_tool};

/// Couplings in their order: a sphere's id each.
const VISITS: [u32; 6] = [1, 2, 1, 3, 2, 1];
/// Poses of each coupling.
const POSES: usize = 25;
/// Noise of each joint in each pose, in rad.
const WHITE_RAD: f64 = 4e-5;
/// Repeatability of a seat, in m.
const SEATING_M: f64 = 3e-6;

fn normal(rng: &mut ChaCha8Rng, sigma: f64) -> f64 {
    let z: f64 = StandardNormal.sample(rng);
    z * sigma
}

/// One robot with its errors.
struct Drawn {
    chain: Chain,
    /// Amplitude (rad) and phase of each encoder's error.
    encoders: Vec<(f64, f64)>,
}

impl Drawn {
    fn new(rng: &mut ChaCha8Rng) -> Self {
        let (mut robot, mut tool): (Robot, Tool) = (iiwa7(), iiwa7_tool());
        for joint in robot.joints.iter_mut().skip(1) {
            joint.mdh.a += normal(rng, 2e-4);
            joint.mdh.d += normal(rng, 2e-4);
            joint.mdh.alpha += normal(rng, 4e-4);
            joint.mdh.theta += normal(rng, 7e-4);
        }
        tool.tcp_m = tool.tcp_m.map(|x| x + normal(rng, 8e-4));
        Self {
            chain: Chain::unchecked(&robot, &tool),
            encoders: (0..7)
                .map(|_| (normal(rng, 1.5e-4), rng.random_range(0.0..core::f64::consts::TAU)))
                .collect(),
        }
    }

    /// TCP in F0, in m, where the encoders read `q` and the joints are off by `white`.
    fn tcp(&self, q: &[f64], white: &[f64]) -> Vector3<f64> {
        let stand: Vec<f64> = q
            .iter()
            .zip(&self.encoders)
            .zip(white)
            .map(|((q, (size, phase)), white)| q + size * (q + phase).sin() + white)
            .collect();
        self.chain.pose(&stand).position
    }

    /// Encoder angles nearest to `q` that bring the TCP to `target` (F0, m).
    fn reach(&self, q: &[f64], target: &Vector3<f64>, white: &[f64]) -> Option<Vec<f64>> {
        let mut q = q.to_vec();
        for _ in 0..40 {
            let tcp = self.tcp(&q, white);
            let miss = target - tcp;
            if miss.norm() < 1e-11 {
                return Some(q);
            }
            let frames = self.chain.frames(&q);
            let columns: Vec<Vector3<f64>> = frames.iter().map(|f| f.z().cross(&(tcp - f.position))).collect();
            let square = columns.iter().fold(Matrix3::zeros(), |s, c| s + c * c.transpose());
            let pull = square.try_inverse()? * miss;
            for (angle, column) in q.iter_mut().zip(&columns) {
                *angle += column.dot(&pull).clamp(-0.3, 0.3);
            }
        }
        None
    }
}

/// What is injected at one pose: its time (0 to 1), sphere, coupling, the sphere's
/// centre (plate, m) and the encoders' readings (rad).
type Inject<'a> = &'a dyn Fn(f64, u32, usize, &mut Vector3<f64>, &mut [f64]);

struct Trial {
    robot: Drawn,
    experiment: Experiment,
    course: Course,
}

/// Measures a drawn robot.
fn measured(seed: u64, inject: Inject<'_>) -> Trial {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let robot = Drawn::new(&mut rng);
    let spheres = paper_plate();
    let plate = Pose {
        rotation: *Rotation3::from_axis_angle(&Vector3::z_axis(), 2.6).matrix(),
        position: Vector3::new(0.6, 0.03, 0.32),
    };
    let neutral = [0.1, 0.7, -0.2, -1.4, 0.2, 0.9, 0.0];
    let mut observations = Vec::new();
    let mut coupling = Vec::new();
    let count = VISITS.len() * POSES;
    for (visit, &sphere) in VISITS.iter().enumerate() {
        let centre = spheres
            .iter()
            .find(|s| s.id == sphere)
            .expect("on the plate")
            .position_m;
        let mut recorded = 0;
        while recorded < POSES {
            let time = observations.len() as f64 / (count - 1) as f64;
            let start: Vec<f64> = neutral.iter().map(|q| q + rng.random_range(-1.1..1.1)).collect();
            let mut target = Vector3::from(centre);
            let mut encoders = [0.0; 7];
            inject(time, sphere, visit, &mut target, &mut encoders);
            let target = plate.point(&target) + Vector3::from_fn(|_, _| normal(&mut rng, SEATING_M));
            let white: Vec<f64> = (0..7).map(|_| normal(&mut rng, WHITE_RAD)).collect();
            let Some(q) = robot.reach(&start, &target, &white) else {
                continue;
            };
            if robot.chain.limit_margin(&q) < 0.05 {
                continue;
            }
            observations.push(Observation {
                seat: None,
                q: q.iter().zip(&encoders).map(|(q, off)| q + off).collect(),
                tau: None,
                target: Target::Sphere { sphere, place: 0 },
                set: Set::Calibrate,
            });
            coupling.push(visit);
            recorded += 1;
        }
    }
    let time = (0..count).map(|k| k as f64 / (count - 1) as f64).collect();
    Trial {
        robot,
        experiment: Experiment {
            robot: iiwa7(),
            tool: iiwa7_tool(),
            spheres,
            observations,
        },
        course: Course {
            coupling,
            time,
            ..Course::default()
        },
    }
}

fn sound(seed: u64) -> Trial {
    measured(seed, &|_, _, _, _, _| ())
}

fn diagnosed(trial: &Trial) -> Evaluation {
    let options = EvaluateOptions {
        work: Some(workspace(&trial.experiment.robot, &trial.experiment.tool)),
        cross_validate: false,
        ..EvaluateOptions::default()
    };
    let recordings = Recordings {
        course: Some(trial.course.clone()),
        ..Recordings::new(trial.experiment.clone())
    };
    evaluate(&recordings, &options, &mut |_| ()).expect("sound data")
}

/// Mean TCP error over the workspace, in mm, after the best fit of the frames.
fn error_mm(trial: &Trial, evaluation: &Evaluation) -> f64 {
    let over = workspace(&trial.experiment.robot, &trial.experiment.tool);
    let found: Vec<_> = over.iter().map(|q| evaluation.calibration.tcp_m(q, None)).collect();
    let real: Vec<_> = over.iter().map(|q| trial.robot.tcp(q, &[0.0; 7])).collect();
    let frame = fit_pose(&found, &real).expect("points in space");
    let errors = found.iter().zip(&real).map(|(a, b)| (frame.point(a) - b).norm());
    errors.sum::<f64>() / over.len() as f64 * 1e3
}

/// Whether the result is refused, or its error is not above the stated interval.
fn honest(trial: &Trial, evaluation: &Evaluation) -> bool {
    let expected = evaluation.verdict.expected_error_mm.expect("it can be told");
    !evaluation.verdict.may_be_used || error_mm(trial, evaluation) < expected.interval[1]
}

/// Whether the strongest finding, or one that explains the same data, is `wanted`.
fn named(found: &Evaluation, wanted: impl Fn(&Alternative) -> bool, words: &str) -> bool {
    found
        .causes
        .findings
        .first()
        .is_some_and(|f| wanted(&f.alternative) || f.or.iter().any(|w| w.contains(words)))
}

// Fails if a sound experiment is blamed for anything, if its seats are not those of the plate, or if the stated error is not
// that of the robots over the workspace: one interval of six may miss (by chance in 23 of 100 cases), two may not (3), and the
// stated error lies within a factor of 1.5 of the true one in the median.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_sound_data_name_nothing_and_the_expected_error_holds() {
    let mut above = Vec::new();
    let mut ratios = Vec::new();
    for seed in 1..=6 {
        let trial = sound(seed);
        let found = diagnosed(&trial);
        assert!(
            found.causes.findings.is_empty(),
            "seed {seed}: {:?}",
            found.causes.findings
        );
        let expected = found.verdict.expected_error_mm.expect("it can be told");
        let mean_mm = error_mm(&trial, &found);
        if mean_mm > expected.interval[1] {
            above.push(format!("seed {seed}: {mean_mm} mm against {expected:?}"));
        }
        ratios.push(expected.mean / mean_mm);
        let nominal = found.verdict.nominal_error_mm.expect("it can be told");
        assert!(nominal.mean > 3.0 * expected.mean, "{nominal:?}");
        assert!(
            found.verdict.probability.is_some_and(|p| p > 0.99),
            "{:?}",
            found.verdict.probability
        );
    }
    assert!(above.len() <= 1, "{above:?}");
    ratios.sort_by(f64::total_cmp);
    assert!((0.67..1.5).contains(&ratios[3]), "{ratios:?}");
}

// Fails if one coordinate of the certificate that is wrong by 0.2 mm is not named
// with its size.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_wrong_coordinate_of_the_certificate_is_named() {
    for (seed, sphere, axis) in [(11, 0, 0), (12, 2, 1), (13, 1, 0)] {
        let mut trial = sound(seed);
        trial.experiment.spheres[sphere].position_m[axis] += 2e-4;
        let found = diagnosed(&trial);
        assert!(
            named(&found, |a| matches!(a, Alternative::Certificate { .. }), "certificate"),
            "seed {seed}: {:?}",
            found.causes.findings
        );
        let found = &found.causes.findings[0];
        assert!(found.sigma > 0.0 && found.harm_mm > 0.0 && !found.next.is_empty() && !found.rows.is_empty());
    }
}

// Fails if a slip of the plate by 0.3 mm half way is not named with size and instant.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_slip_of_the_plate_is_named() {
    let trial = measured(31, &|time, _, _, sphere, _| {
        if time > 0.5 {
            sphere.x += 3e-4;
        }
    });
    let found = diagnosed(&trial);
    let found = found.causes.findings.first().expect("the plate slipped");
    let Alternative::Slip { time, .. } = found.alternative else {
        panic!("{found:?}");
    };
    assert!((time - 0.5).abs() < 0.1, "{found:?}");
    assert!((found.size - 0.3).abs() < 4.0 * found.sigma.max(0.02), "{found:?}");
    assert!(found.rows.iter().all(|r| *r >= 60), "{:?}", found.rows);
}

// Fails if a sphere that moved by 0.5 mm between two couplings is not named.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_sphere_that_moved_is_named() {
    let trial = measured(41, &|_, id, visit, sphere, _| {
        if id == 1 && visit >= 2 {
            sphere.y += 5e-4;
        }
    });
    let found = diagnosed(&trial);
    let moved = |a: &Alternative| matches!(a, Alternative::SphereMoved { sphere: 1, .. });
    assert!(named(&found, moved, "sphere 1 moved"), "{:?}", found.causes.findings);
}

// Fails if a single coupling that is 0.3 mm off is not named.
#[test]
fn a_coupling_that_is_off_is_named() {
    let trial = measured(51, &|_, _, visit, sphere, _| {
        if visit == 2 {
            *sphere += Vector3::new(2e-4, -2e-4, 1e-4);
        }
    });
    let found = diagnosed(&trial);
    let off = |a: &Alternative| matches!(a, Alternative::Seat { coupling: 2 });
    assert!(named(&found, off, "coupling 3"), "{:?}", found.causes.findings);
}

// Fails if a jump of 1 mrad or a drift of 2 mrad of one encoder is not named with its
// joint.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_an_encoder_that_jumps_or_drifts_is_named() {
    let jumped = measured(61, &|time, _, _, _, encoders| {
        if time > 0.5 {
            encoders[2] += 1e-3;
        }
    });
    let found = diagnosed(&jumped);
    let step = |a: &Alternative| matches!(a, Alternative::EncoderStep { joint: 2, .. });
    assert!(named(&found, step, "encoder 3 jumped"), "{:?}", found.causes.findings);
    let drifted = measured(62, &|time, _, _, _, encoders| encoders[3] += 2e-3 * time);
    let found = diagnosed(&drifted);
    let drift = |a: &Alternative| matches!(a, Alternative::EncoderDrift { joint: 3 });
    assert!(named(&found, drift, "encoder 4 drifted"), "{:?}", found.causes.findings);
}

// Fails if 12 rows on one sphere are said to give a robot that is surely better than
// the nominal one.
#[test]
fn few_rows_on_one_sphere_do_not_look_like_a_calibration() {
    let trial = sound(71);
    let full = diagnosed(&trial);
    let mut few = sound(71);
    few.experiment.observations.truncate(12);
    few.course.coupling.truncate(12);
    few.course.time.truncate(12);
    let found = diagnosed(&few);
    let of = |found: &Evaluation| found.verdict.expected_error_mm.expect("it can be told").mean;
    assert!(of(&found) > 3.0 * of(&full), "{} against {}", of(&found), of(&full));
}

fn evaluated(experiment: Experiment) -> Verdict {
    evaluated_rows(&Recordings::new(experiment))
}

fn evaluated_rows(recordings: &Recordings) -> Verdict {
    let evaluation = evaluate(recordings, &EvaluateOptions::default(), &mut |_| ()).expect("readable data");
    evaluation.verdict
}

// Fails if the verdict of sound data refuses, or if a result is vouched for that a wrong certificate, a plate that slipped, an
// encoder that jumped or a wrong scale made worse than it says, or if a cause that is named is not told.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_what_the_residuals_name_is_in_the_statement() {
    let verdict = evaluated(sound(91).experiment);
    assert!(verdict.may_be_used, "{:?}", verdict.reasons);
    let expected = verdict.expected_error_mm.expect("it can be told");
    assert!(expected.interval[0] < expected.mean && expected.mean < expected.interval[1]);

    let mut certificate = sound(92);
    certificate.experiment.spheres[2].position_m[0] += 1e-3;
    let slip = measured(93, &|time, _, _, sphere, _| {
        if time > 0.5 {
            sphere.x += 1e-3;
        }
    });
    let encoder = measured(94, &|time, _, _, _, encoders| {
        if time > 0.5 {
            encoders[1] += 3e-3;
        }
    });
    let mut scale = sound(95);
    for sphere in &mut scale.experiment.spheres {
        sphere.position_m = sphere.position_m.map(|x| x * 1.0033);
    }
    for (trial, cause) in [
        (certificate, Some("certificate")),
        (slip, Some("slipped")),
        (encoder, Some("encoder")),
        (scale, None),
    ] {
        let found = diagnosed(&trial);
        let (mean_mm, verdict) = (error_mm(&trial, &found), &found.verdict);
        assert!(
            honest(&trial, &found),
            "{cause:?}: {mean_mm} mm, {:?}",
            verdict.expected_error_mm
        );
        if let Some(cause) = cause {
            assert!(
                verdict.reasons.iter().any(|r| r.contains(cause)),
                "{cause}: {:?}",
                verdict.reasons
            );
        }
    }
}

// Fails if 12 rows on one sphere may be used.
#[test]
fn the_verdict_refuses_few_rows_on_one_sphere() {
    let mut few = sound(96).experiment;
    few.observations.truncate(12);
    let verdict = evaluated(few);
    assert!(!verdict.may_be_used, "{:?}", verdict.checks);
    assert!(
        verdict.checks.iter().any(|c| c.name == "scale_observed" && !c.passed),
        "{:?}",
        verdict.checks
    );
}
