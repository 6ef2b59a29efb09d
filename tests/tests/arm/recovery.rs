//! Recovery that does not push: retreat and return after pushes.

use spherecal::sim::inject::InjectedFault;
use spherecal_lab::faults::worst::{self, WorstOptions};
use spherecal_lab::faults::{Case, Finish, PEAK_N, SUSTAINED_N, TrialEnd};
use spherecal_shared::protocol::host::{Fault, Phase};

use crate::injected::one;

// Fails if a run in which a person pushes the nest off its sphere, to any side and at any pose, ends
// without all poses or a reason, or if the arm presses on the sphere in its recovery.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_push_off_the_sphere_is_recovered_without_pressing() {
    let case = Case::new(2, Finish::Record).expect("a case");
    for entry in 1..=6u32 {
        let angle = f64::from(entry) * 1.1;
        let push = InjectedFault::HumanPush {
            force_n: [50.0 * angle.cos(), 50.0 * angle.sin(), 0.0],
        };
        let trial = case.run(&one(push, Phase::Recording, entry, 0.1, 0.5)).expect("a run");
        assert_eq!(trial.ended, TrialEnd::Finished, "entry {entry}: {:?}", trial.faults);
        println!(
            "entry {entry}: {:.1} N for 0.3 s, {:.1} N at most, {:?}",
            trial.sustained_n, trial.pressed_n, trial.bad
        );
        assert!(
            trial.sustained_n <= SUSTAINED_N && trial.pressed_n <= PEAK_N,
            "entry {entry}: {} N for 0.3 s, {} N at most",
            trial.sustained_n,
            trial.pressed_n
        );
    }
}

// Fails if the arm compensates a push that has spoilt its tare: on the way off it would press with that force, three
// times in a row, and give the sphere up.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_push_in_the_tare_is_not_compensated() {
    let case = Case::new(2, Finish::Record).expect("a case");
    for force_n in [[40.0, 0.0, 0.0], [0.0, -40.0, 0.0], [0.0, 0.0, 40.0]] {
        let push = InjectedFault::HumanPush { force_n };
        let trial = case.run(&one(push, Phase::Taring, 2, 0.15, 0.3)).expect("a run");
        let faults: Vec<_> = trial.faults.iter().map(|f| (f.fault, f.phase)).collect();
        assert_eq!(trial.ended, TrialEnd::Finished, "{force_n:?}: {faults:?}");
        assert_eq!(faults, [(Fault::Tare, Phase::Taring)], "{force_n:?}");
    }
}

// Fails if an arm that is pushed until it is stretched, and through, twists its elbow round: the torque that its drive
// cannot follow was reported as a failing sensor, at every attempt to leave.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_an_arm_pushed_through_its_stretched_posture_comes_back() {
    let case = Case::new(2, Finish::Record).expect("a case");
    for newton in [25.0, 33.0, 45.0] {
        for entry in 1..=3 {
            let push = InjectedFault::HumanPush {
                force_n: [newton, 0.0, 0.0],
            };
            let trial = case
                .run(&one(push, Phase::Approaching, entry, 0.3, 1.2))
                .expect("a run");
            let faults: Vec<_> = trial.faults.iter().map(|f| (f.fault, f.phase)).collect();
            assert_eq!(trial.ended, TrialEnd::Finished, "{newton} N at {entry}: {faults:?}");
            assert!(
                !faults
                    .iter()
                    .any(|(f, _)| matches!(f, Fault::TorqueSensor | Fault::Force)),
                "{newton} N at {entry}: {faults:?}"
            );
        }
    }
}

// Fails if the search for the worst push finds one after which the arm presses, or a run that ends
// without a reason.
#[test]
#[ignore = "long: 48 runs"]
fn long_the_worst_pushes_do_not_make_the_arm_press() {
    let table = worst::run(&WorstOptions {
        only: vec!["human_push".to_owned()],
        runs: 48,
        seeds: 3,
        progress: false,
    })
    .expect("a search");
    assert!(table.holds(), "{table}");
}
