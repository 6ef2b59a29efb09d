//! The force with which the arm presses is bounded by the controller itself.

use spherecal::job::Config;
use spherecal::sim::inject::{FaultPlan, InjectedFault};
use spherecal_lab::faults::{Case, FaultTrial, Finish, TrialEnd};
use spherecal_shared::protocol::host::{Fault, Phase};

use crate::injected::one;

/// Arms that are hard to control: name, seed, `[plant]`.
const HARD: [(&str, u64, &str); 8] = [
    ("typical", 1, "preset = \"typical\""),
    ("as measured", 1, "preset = \"as_measured\""),
    ("as measured", 2, "preset = \"as_measured\""),
    ("harsh", 1, "preset = \"harsh\""),
    ("harsh", 2, "preset = \"harsh\""),
    (
        "elastic, 16,000 N m/rad",
        1,
        "preset = \"typical\"\n[elasticity]\nenabled = true\nstiffness_nm_rad = 16000.0",
    ),
    (
        "dry friction to 2 N m",
        1,
        "preset = \"typical\"\n[friction]\ncoulomb_nm = [1.0, 2.0]",
    ),
    (
        "torque noise of 0.25 N m",
        1,
        "preset = \"typical\"\n[sensors]\ntorque_white_nm = 0.25",
    ),
];

fn case(seed: u64, plant: &str) -> Case {
    let config = Config {
        seed,
        plant: toml::from_str(plant).expect("settings"),
        ..Config::default()
    };
    Case::of(config, Finish::Record).unwrap_or_else(|e| panic!("{plant}: {e}"))
}

// Fails if model error, friction, elasticity or noise of a sound run counts as pressing.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_sound_runs_do_not_press() {
    for (name, seed, plant) in HARD {
        let trial = case(seed, plant).run(&FaultPlan::default()).expect("a run");
        println!("{name}, seed {seed}: {:?}", trial.faults);
        assert_eq!(trial.ended, TrialEnd::Finished, "{name}");
        assert!(
            trial.faults.iter().all(|f| f.fault != Fault::Pressing),
            "{name}: {:?}",
            trial.faults
        );
    }
}

/// What a disturbance in a free motion came to.
fn disturbed(case: &Case, what: InjectedFault, entry: u32, after_s: f64, for_s: f64) -> FaultTrial {
    let trial = case
        .run(&one(what, Phase::Moving, entry, after_s, for_s))
        .expect("a run");
    println!(
        "{} at motion {entry} after {after_s} s: {:.1} N for 0.3 s, {:.1} N at most, {:?}",
        what.name(),
        trial.sustained_n,
        trial.pressed_n,
        trial
            .faults
            .iter()
            .map(|f| (f.fault, f.phase, f.value))
            .collect::<Vec<_>>()
    );
    trial
}

// Fails if a push that lasts does not stop a free motion, or if the run does not recover.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_push_in_a_free_motion_stops_it_and_the_run_recovers() {
    let case = case(2, "preset = \"typical\"");
    for (entry, force_n) in [
        (1, [0.0, 0.0, 40.0]),
        (2, [30.0, 0.0, 0.0]),
        (3, [0.0, -30.0, 0.0]),
        (4, [0.0, 20.0, 20.0]),
    ] {
        let push = InjectedFault::HumanPush { force_n };
        let trial = disturbed(&case, push, entry, 0.4, 0.6);
        assert_eq!(trial.ended, TrialEnd::Finished, "{:?}", trial.faults);
        let first = trial.faults.first().map(|f| (f.fault, f.phase));
        assert_eq!(first, Some((Fault::Pressing, Phase::Moving)), "motion {entry}");
    }
}

// Fails if the arm presses on an obstacle in a free motion, or if the run does not recover.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_obstacle_is_not_pressed_on() {
    let case = case(2, "preset = \"typical\"");
    for (entry, stiffness_n_m) in [(2, 1e4), (3, 1e4), (4, 1e3), (3, 1e5)] {
        let obstacle = InjectedFault::Obstacle {
            ahead_m: 0.02,
            stiffness_n_m,
        };
        let trial = disturbed(&case, obstacle, entry, 0.5, 2.0);
        assert_eq!(trial.ended, TrialEnd::Finished, "{:?}", trial.faults);
        let stopped = trial
            .faults
            .iter()
            .any(|f| matches!(f.fault, Fault::Pressing | Fault::Force) && f.phase == Phase::Moving);
        assert!(stopped, "{:?}", trial.faults);
        assert!(trial.sustained_n < 15.0, "{} N for 0.3 s", trial.sustained_n);
    }
}
