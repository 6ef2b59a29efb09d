//! Maps of residuals on simulated points: kept where there is something to map, and nowhere else.

use nalgebra::Vector3;
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use spherecal_identify::residual_map::MapInput;
use spherecal_identify::{
    EvaluateOptions, Evaluation, Experiment, Observation, Recordings, Set, Target, evaluate, halton_configurations,
};
use spherecal_model::chain::Chain;
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

const ROWS: usize = 150;
const JUDGES: usize = 150;

/// A tracker's points of an arm with small errors; `size_m` displaces the tool by its orientation. The judging rows
/// have no noise.
fn seen(seed: u64, size_m: f64, rows: usize) -> Experiment {
    let robot = iiwa7();
    let mut random = ChaCha8Rng::seed_from_u64(seed);
    let mut normal = move |sigma: f64| -> f64 {
        let z: f64 = StandardNormal.sample(&mut random);
        sigma * z
    };
    let mut real = robot.clone();
    for joint in &mut real.joints {
        joint.mdh.d += normal(2e-4);
        joint.mdh.theta += normal(3e-4);
    }
    let chain = Chain::unchecked(&real, &iiwa7_tool());
    let waves: Vec<(f64, f64)> = (0..7).map(|_| (normal(1e-4), normal(1e-4))).collect();
    let mut draw = ChaCha8Rng::seed_from_u64(1000 + seed);
    let from = draw.random_range(0..20_000);
    let all = halton_configurations(&robot, from + rows + JUDGES).split_off(from);
    let observations = all.into_iter().enumerate().map(|(k, q)| {
        let bent: Vec<f64> = q
            .iter()
            .zip(&waves)
            .map(|(q, (c, s))| q + c * q.cos() + s * (2.0 * q).sin())
            .collect();
        let pose = chain.pose(&bent);
        // The direction of gravity seen from the tool: it sags by it, not in proportion.
        let u = pose.rotation.inverse() * Vector3::z();
        let sag = Vector3::new(2.0 * u.x * u.z, u.y + u.x * u.x, u.y * u.z - u.x) * size_m;
        let mut point = pose.position + pose.rotation * sag;
        let set = if k < rows {
            point += Vector3::new(normal(3e-5), normal(3e-5), normal(3e-5));
            Set::Calibrate
        } else {
            Set::Validate
        };
        Observation {
            seat: None,
            q,
            tau: None,
            target: Target::Point(point.into()),
            set,
        }
    });
    Experiment {
        observations: observations.collect(),
        robot,
        tool: iiwa7_tool(),
        spheres: Vec::new(),
    }
}

/// An evaluation that tries maps and chooses nothing else.
fn evaluated(experiment: Experiment, diagnose: bool) -> Evaluation {
    let options = EvaluateOptions {
        residual_map: true,
        choose_priors: false,
        choose_model: false,
        diagnose,
        ..EvaluateOptions::default()
    };
    evaluate(&Recordings::new(experiment), &options, &mut |_| {}).unwrap()
}

/// Mean error on the judging rows, in mm.
fn mean_mm(found: &Evaluation, model: &str) -> Option<f64> {
    Some(found.judged.as_ref()?.model(model)?.errors().mean_mm)
}

/// Of arms whose tool is displaced by `size_m` times a function of its orientation: how many keep a map over the
/// orientation, and the sum of the errors (mm) without displacement, without map, and with it.
fn displaced(seeds: std::ops::Range<u64>, size_m: f64) -> (usize, [f64; 3]) {
    let (mut kept, mut sums) = (0, [0.0; 3]);
    for seed in seeds {
        let none = evaluated(seen(seed, 0.0, ROWS), false);
        let found = evaluated(seen(seed, size_m, ROWS), false);
        let report = found.residual_map.as_ref().unwrap();
        kept += usize::from(
            report
                .map
                .as_ref()
                .is_some_and(|m| m.data().input == MapInput::Orientation),
        );
        sums[0] += mean_mm(&none, "calibrated").unwrap();
        sums[1] += mean_mm(&found, "calibrated").unwrap();
        sums[2] += mean_mm(&found, "calibrated_with_map").unwrap_or_else(|| mean_mm(&found, "calibrated").unwrap());
    }
    (kept, sums)
}

/// Of arms without such a displacement: how many keep a map; none may predict worse by more than 1 %.
fn sound(seeds: std::ops::Range<u64>) -> usize {
    let mut kept = 0;
    for seed in seeds {
        let found = evaluated(seen(seed, 0.0, ROWS), false);
        let without = mean_mm(&found, "calibrated").unwrap();
        if let Some(with) = mean_mm(&found, "calibrated_with_map") {
            kept += 1;
            assert!(
                with < 1.01 * without,
                "seed {seed}: {with} mm with the map, {without} mm without"
            );
        }
    }
    kept
}

// Fails if a tool that is displaced with its orientation keeps no map, or if the map does not take most of what the
// displacement adds to the error on rows that nothing has seen.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_displaced_tool_keeps_a_map() {
    let (kept, [none, without, with]) = displaced(1..3, 1e-4);
    assert_eq!(kept, 2);
    assert!(with - none < 0.5 * (without - none), "{none} {without} {with}");
}

// Fails if the same does not hold for 9 of 10 arms.
#[test]
#[ignore = "long: a minute"]
fn long_most_displaced_tools_keep_a_map() {
    let (kept, [none, without, with]) = displaced(1..11, 1e-4);
    println!(
        "{kept} of 10 keep a map; mean errors {:.3}, {:.3}, {:.3} mm",
        none / 10.0,
        without / 10.0,
        with / 10.0
    );
    assert!(kept >= 9, "{kept} of 10");
    assert!(with - none < 0.5 * (without - none), "{none} {without} {with}");
}

// Fails if an arm without such a displacement keeps a map.
#[test]
fn a_sound_arm_keeps_no_map() {
    assert_eq!(sound(1..3), 0);
}

// Fails if more than one of 20 keeps a map, or if one predicts worse with it by more than 1 %.
#[test]
#[ignore = "long: a minute"]
fn long_few_sound_arms_keep_a_map() {
    let kept = sound(1..21);
    println!("{kept} of 20 keep a map");
    assert!(kept <= 1, "{kept} of 20");
}

// Fails if the expected error with the map does not hold the true one, if the map's share in it is no share, or if the
// report keeps from the reader what the robot files do not hold.
#[test]
fn the_share_of_the_map_is_stated() {
    for seed in 1..5 {
        let found = evaluated(seen(seed, 1e-4, ROWS), false);
        let report = found.residual_map.as_ref().unwrap();
        let share = report.share.unwrap();
        let [low, high] = share.expected_error_mm.interval;
        let truth = mean_mm(&found, "calibrated_with_map").unwrap();
        assert!(
            (low..high).contains(&truth),
            "seed {seed}: {truth} mm is not in {low} to {high} mm"
        );
        assert!((0.01..0.9).contains(&share.of_map), "{share:?}");
        assert!(
            share.sigma_mm > 0.0 && share.largest_mm >= share.correction_mm,
            "{share:?}"
        );
        for words in ["calibrated.urdf", "compensator", "contiguous blocks", "standard errors"] {
            assert!(report.words.contains(words), "{}", report.words);
        }
        let q = [0.3, -0.4, 0.2, 1.0, -0.5, 0.6, 0.1];
        let map = report.map.as_ref().unwrap();
        let moved = found.tcp_with_map_m(&q, None) - found.calibration.tcp_m(&q, None);
        assert!((moved - map.correction(&found.calibration, &q).shift_m).norm() < 1e-12);
    }
}

// Fails if a row has a part in the fit or in the map that predict it: without validation rows, the prediction of a
// row by the cross-validation must not change, in any bit, when the row itself does.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_no_row_teaches_the_map_that_judges_it() {
    let experiment = || {
        let mut all = seen(1, 1e-4, ROWS);
        all.observations.truncate(ROWS);
        all
    };
    let first = evaluated(experiment(), false);
    assert!(first.cross_validated && first.residual_map.as_ref().unwrap().map.is_some());
    let samples = |found: &Evaluation| {
        found
            .judged
            .as_ref()
            .unwrap()
            .model("calibrated_with_map")
            .unwrap()
            .samples
            .clone()
    };
    for row in [7, 68] {
        let mut other = experiment();
        if let Target::Point(point) = &mut other.observations[row].target {
            point[1] += 3e-4;
        }
        let second = evaluated(other, false);
        let (one, two) = (samples(&first), samples(&second));
        assert_eq!(one[row].index, row);
        assert_eq!(one[row].at_m, two[row].at_m, "row {row}");
        // It teaches the maps of the other folds.
        assert!((0..ROWS).any(|k| k % 5 != row % 5 && one[k].at_m != two[k].at_m));
    }
}

// Fails if few rows or nobody's wish give a map, or if few rows are an error.
#[test]
fn few_rows_and_no_wish_give_no_map() {
    let few = evaluated(seen(1, 1e-4, 40), false).residual_map.unwrap();
    assert!(
        few.map.is_none() && few.words.contains("40 rows cannot tell"),
        "{}",
        few.words
    );
    let default = EvaluateOptions {
        diagnose: false,
        ..EvaluateOptions::default()
    };
    assert!(!default.residual_map);
}
