//! A study of the verdict: how often it refuses honest runs, how often it names small causes,
//! and how often the interval of the expected error holds the true error. It prints the figures
//! that `docs/design/record-2026.md` states.
//!
//! The environment can name the first seed and the number of robots of each world, so that a
//! change can be designed on some robots and measured on others:
//! `VERDICT_SEEDS=4000:40 cargo test --release -p spherecal-tests --test identify -- --ignored
//! study_of --nocapture`.

use nalgebra::Vector3;
use rayon::prelude::*;
use spherecal::identify::{EvaluateOptions, Recordings, Verdict, evaluate, fit_pose, workspace};
use spherecal::plan::{Cell, DesignRequest, design};
use spherecal::sim::worlds::World;
use spherecal_lab::worlds::{ContactPose, Trial, planned_poses, record as record_grid};

use super::broken::{Broken, record};

/// Checks that name a cause.
const CAUSES: [&str; 11] = [
    "certificate",
    "plate_slip",
    "plate_drift",
    "sphere_moved",
    "coupling_seat",
    "encoder",
    "joint_region",
    "read_at_rest",
    "backlash",
    "place",
    "payload",
];

/// A robot that was calibrated: what its user reads, and the truth.
struct Outcome {
    seed: u64,
    verdict: Verdict,
    /// Degrees of freedom of the residuals.
    student_t: f64,
    true_mm: f64,
}

/// The contacts of a trial alone, as a user without a tracker has them, and the mean error of the
/// result at the points that a tracker would validate by, with the base fitted to them.
fn outcome(trial: &Trial, judged: bool) -> Outcome {
    let mut recordings = Recordings::from(trial);
    recordings.tracker = None;
    let options = EvaluateOptions {
        align: false,
        cross_validate: judged,
        work: Some(workspace(&trial.spheres.robot, &trial.spheres.tool)),
        ..EvaluateOptions::default()
    };
    let evaluation = evaluate(&recordings, &options, &mut |_| {}).expect("readable data");
    let points = trial.validation.iter();
    let predicted: Vec<Vector3<f64>> = points.map(|m| evaluation.calibration.tcp_m(&m.q, None)).collect();
    let real: Vec<Vector3<f64>> = trial.validation_truth_m.iter().map(|p| Vector3::from(*p)).collect();
    let pose = fit_pose(&predicted, &real).expect("spread points");
    let errors = predicted.iter().zip(&real).map(|(p, r)| (pose.point(p) - r).norm());
    Outcome {
        seed: trial.seed,
        student_t: evaluation.calibration.noise.student_t,
        verdict: evaluation.verdict,
        true_mm: errors.sum::<f64>() / real.len() as f64 * 1e3,
    }
}

pub(crate) fn default_plan() -> Vec<ContactPose> {
    plan_of(150)
}

fn plan_of(poses: usize) -> Vec<ContactPose> {
    let plan = design(&Cell::iiwa7(), &DesignRequest::new(poses)).expect("the built-in cell is plannable");
    planned_poses(&plan)
}

/// First seed and number of robots, by the environment where it names them.
pub(crate) fn seeds(first: u64, count: u64) -> std::ops::Range<u64> {
    let asked = std::env::var("VERDICT_SEEDS").unwrap_or_default();
    let numbers: Vec<u64> = asked.split(':').filter_map(|n| n.parse().ok()).collect();
    match numbers[..] {
        [first, count] => first..first + count,
        _ => first..first + count,
    }
}

/// All robots of one world.
fn outcomes(
    world: World,
    broken: Broken,
    seeds: std::ops::Range<u64>,
    poses: &[ContactPose],
    judged: bool,
) -> Vec<Outcome> {
    let robot = |seed| outcome(&record(world, broken, seed, poses), judged);
    seeds.into_par_iter().map(robot).collect()
}

/// Prints how the stated error agrees with the truth; returns the share of intervals that hold it.
fn coverage(name: &str, found: &[Outcome]) -> f64 {
    let (mut low, mut high, mut inside) = (0, 0, 0);
    let mut ratios = Vec::new();
    for outcome in found {
        let e = outcome.verdict.expected_error_mm.expect("computed");
        println!(
            "  {name} {}: expected {:.3} ({:.3} to {:.3}), true {:.3}; t of {:.1}",
            outcome.seed, e.mean, e.interval[0], e.interval[1], outcome.true_mm, outcome.student_t
        );
        low += usize::from(outcome.true_mm < e.interval[0]);
        high += usize::from(outcome.true_mm > e.interval[1]);
        inside += usize::from((e.interval[0]..=e.interval[1]).contains(&outcome.true_mm));
        ratios.push(outcome.true_mm / e.mean);
    }
    ratios.sort_by(f64::total_cmp);
    println!(
        "{name}: {inside} of {} intervals hold the truth, {low} above it, {high} below it; true over expected: median \
         {:.2}, {:.2} to {:.2}",
        found.len(),
        ratios[ratios.len() / 2],
        ratios[0],
        ratios[ratios.len() - 1]
    );
    inside as f64 / found.len() as f64
}

// Fails if a slip or a wrong coordinate of 10 mm is not taken out of the fit: if the arm is known worse by a third than without
// it, if its interval does not hold the truth, or if it is refused.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_what_moved_in_the_cell_costs_nothing() {
    let poses = default_plan();
    let of = |broken| outcome(&record(World::W4, broken, 3000, &poses), true);
    let sound = of(Broken::Nothing).true_mm;
    for broken in [Broken::Certificate(1e-2), Broken::Slip(1e-2)] {
        let found = of(broken);
        let expected = found.verdict.expected_error_mm.expect("computed");
        println!(
            "{broken:?}: {:.3} mm, stated {:.3}, {sound:.3} without it",
            found.true_mm, expected.mean
        );
        assert!(found.verdict.may_be_used, "{broken:?}: {:?}", found.verdict.reasons);
        assert!(
            found.true_mm < 1.33 * sound,
            "{broken:?}: {} mm, {sound} mm without it",
            found.true_mm
        );
        let [low, high] = expected.interval;
        assert!(
            (low..=high).contains(&found.true_mm),
            "{broken:?}: {expected:?}, true {} mm",
            found.true_mm
        );
    }
}

// Prints the study. Fails if more than one of 40 honest runs is refused, if a wrong coordinate of
// 0.2 mm or a slip of 0.3 mm is named in fewer than 9 of 10 runs, or if the interval of the expected
// error holds the truth in fewer than 85 % of the sound robots.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_the_verdict() {
    let poses = default_plan();
    let (mut refused, mut inside, mut robots) = (0, 0.0, 0.0);
    for world in [World::W0, World::W1, World::W2, World::W3, World::W4] {
        let found = outcomes(world, Broken::Nothing, seeds(2000, 8), &poses, true);
        for outcome in found.iter().filter(|o| !o.verdict.may_be_used) {
            println!("{world} {}: refused: {}", outcome.seed, outcome.verdict.reasons[0]);
            refused += 1;
        }
        inside += coverage(world.name(), &found) * found.len() as f64;
        robots += found.len() as f64;
    }
    println!("{refused} of {robots} honest runs refused");
    let mut least = 1.0_f64;
    for broken in [Broken::Certificate(2e-4), Broken::Slip(3e-4)] {
        let found = outcomes(World::W0, broken, seeds(3000, 10), &poses, true);
        let cause = |o: &&Outcome| {
            let checks = &o.verdict.checks;
            checks.iter().any(|c| CAUSES.contains(&c.name) && !c.passed)
        };
        let named = found.iter().filter(cause).count();
        let refused = found.iter().filter(|o| !o.verdict.may_be_used).count();
        for outcome in &found {
            println!("{broken:?} {}: {}", outcome.seed, outcome.verdict.reasons[0]);
        }
        println!("{broken:?}: named in {named} of {}, refused in {refused}", found.len());
        least = least.min(named as f64 / found.len() as f64);
    }
    assert!(refused <= 1, "{refused} honest runs refused");
    assert!(least >= 0.9, "{least} named");
    assert!(inside >= 0.85 * robots, "{inside} of {robots} intervals hold the truth");
}

// Prints how well the interval of the expected error holds in worlds that no model describes. Fails
// if it holds the truth in fewer than 85 % of the robots of all these worlds together.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_broken_worlds() {
    let poses = default_plan();
    let (mut inside, mut robots) = (0.0, 0.0);
    let all = [
        Broken::Drift(3e-4),
        Broken::Deflection(3e-4),
        Broken::Deflection(1e-3),
        Broken::CrossJoint(2e-4),
        Broken::Quadratic(5e-8),
        Broken::Harmonics(1.5e-4),
        Broken::Outliers(0.1),
        Broken::Links(1e-4),
    ];
    // `VERDICT_BROKEN=CrossJoint` takes one of them.
    let asked = std::env::var("VERDICT_BROKEN").unwrap_or_default();
    for broken in all.into_iter().filter(|b| format!("{b:?}").contains(&asked)) {
        let found = outcomes(World::W0, broken, seeds(5000, 12), &poses, false);
        inside += coverage(&format!("{broken:?}"), &found) * found.len() as f64;
        robots += found.len() as f64;
    }
    assert!(inside >= 0.85 * robots, "{inside} of {robots} intervals hold the truth");
}

// Fails if the paper's whole grid, which turns the tool by 20 degrees and less and tells little of the rest of the cell, gives
// intervals that hold the truth in fewer than 90 % of the robots, none of which a constant was chosen on.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_intervals_of_the_papers_grid_hold_the_truth() {
    for world in [World::W0, World::W3, World::W4] {
        let of = |seed| outcome(&record_grid(world, seed).expect("the built-in worlds work"), false);
        let found: Vec<Outcome> = (1000..1020u64).into_par_iter().map(of).collect();
        let inside = coverage(&format!("{world}, the paper's grid"), &found);
        assert!(inside >= 0.9, "{world}: {inside} of the intervals hold the truth");
    }
}

// Prints what twenty contacts scattered over the cell state, and the truth. Fails if the interval of
// the expected error of a result that may be used does not hold the truth in 85 % of the robots.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_twenty_rows() {
    let all = default_plan();
    let poses: Vec<ContactPose> = all.iter().step_by(all.len().div_ceil(20)).cloned().collect();
    let (mut inside, mut used) = (0, 0);
    for world in [World::W0, World::W4] {
        let found = outcomes(world, Broken::Nothing, seeds(6000, 10), &poses, true);
        coverage(&format!("{world}, {} rows", poses.len()), &found);
        for outcome in &found {
            let e = outcome.verdict.expected_error_mm.expect("computed");
            used += usize::from(outcome.verdict.may_be_used);
            let holds = (e.interval[0]..=e.interval[1]).contains(&outcome.true_mm);
            inside += usize::from(outcome.verdict.may_be_used && holds);
        }
    }
    println!("{used} may be used; the interval of {inside} of them holds the truth");
    assert!(inside as f64 >= 0.85 * used as f64, "{inside} of {used}");
}

// Prints what is stated of robots as hard as real ones, after few and many poses: `docs/design/record-2026.md` says
// that the interval is too narrow for them. Fails if the robots whose joint offsets reach 20 mrad, one in
// three, are not calibrated: the mean error after 30 poses was 0.89 mm with the default priors alone.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_arms_as_measured() {
    for (count, most_mm) in [(30, 0.65), (60, 0.40), (150, 0.32)] {
        let poses = plan_of(count);
        let found = outcomes(World::W5, Broken::Nothing, seeds(7000, 20), &poses, false);
        coverage(&format!("W5, {count} poses"), &found);
        let mean = found.iter().map(|o| o.true_mm).sum::<f64>() / found.len() as f64;
        println!("W5, {count} poses: mean error {mean:.3} mm");
        assert!(mean < most_mm, "{count} poses: {mean} mm");
    }
}

// Fails if a sound robot with badly seated nests is refused, or if one whose plate slipped by 2 mm is vouched for with an error
// that it does not have.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_bad_seats_refuse_nothing_and_a_slip_is_in_the_statement() {
    let poses = default_plan();
    let of = |broken| outcome(&record(World::W5s, broken, 2020, &poses), true);
    let sound = of(Broken::Nothing);
    assert!(sound.verdict.may_be_used, "{:?}", sound.verdict.reasons);
    let slipped = of(Broken::Slip(2e-3));
    let stated = slipped.verdict.expected_error_mm.expect("computed");
    assert!(
        !slipped.verdict.may_be_used || slipped.true_mm < stated.interval[1],
        "{} mm, {stated:?}",
        slipped.true_mm
    );
    assert!(
        slipped
            .verdict
            .checks
            .iter()
            .any(|c| CAUSES.contains(&c.name) && !c.passed)
    );
}

// Prints how the verdict fares on robots as hard as real ones: how many sound ones are refused, and how many
// whose plate slipped or whose certificate is wrong. `docs/design/record-2026.md` has the figures. Fails if more than one
// sound robot of twelve is refused, if three of twelve with a fault of 1 mm are not, or if the intervals of any
// twelve hold the truth in fewer than 85 %.
#[test]
#[ignore = "study: takes minutes and prints the figures of docs/design/record-2026.md"]
fn study_of_verdicts_as_measured() {
    let poses = default_plan();
    let all = [
        Broken::Nothing,
        Broken::Slip(3e-4),
        Broken::Certificate(3e-4),
        Broken::Slip(1e-3),
        Broken::Certificate(1e-3),
    ];
    let asked = std::env::var("VERDICT_BROKEN").unwrap_or_default();
    let cases = all.into_iter().filter(|b| format!("{b:?}").contains(&asked));
    for (broken, world) in cases.flat_map(|b| [World::W5, World::W5s].map(|w| (b, w))) {
        let found = outcomes(world, broken, seeds(2000, 12), &poses, true);
        for outcome in &found {
            let verdict = &outcome.verdict;
            println!(
                "{broken:?} {}: may be used: {}, {:.3} mm",
                outcome.seed, verdict.may_be_used, outcome.true_mm
            );
            for check in verdict.checks.iter().filter(|c| CAUSES.contains(&c.name) && !c.passed) {
                println!("    {} {:.220}", check.name, check.words);
            }
        }
        let refused = found.iter().filter(|o| !o.verdict.may_be_used).count();
        println!("{world}, {broken:?}: {refused} of {} refused", found.len());
        let inside = coverage(&format!("{world}, {broken:?}"), &found);
        assert!(inside >= 0.85, "{broken:?}: {inside} of the intervals hold the truth");
        let share = refused as f64 / found.len() as f64;
        // Else what is named is in the fit and in the statement.
        if matches!(broken, Broken::Nothing) {
            assert!(share <= 1.0 / 12.0, "{refused} sound robots refused");
        }
    }
}
