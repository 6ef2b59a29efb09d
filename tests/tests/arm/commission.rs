//! The first run on a robot, against the simulated arm: sound arms pass every step, and what is wrong is found before
//! the arm moves far.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::atomic::AtomicBool;

use spherecal::campaign::Silent;
use spherecal::campaign::commission::{Attendant, Step, StepReport, Verdict};
use spherecal::job::{Choice, Commissioning, Config, Link, Prepared, commission, commissionings, open_store, prepare};
use spherecal::link::JournalError;
use spherecal::store::StoreLocation;

/// Answers yes, but to the questions that are numbered.
#[derive(Default)]
struct Person {
    asked: usize,
    no_to: Option<usize>,
    answers: VecDeque<bool>,
}

impl Attendant for Person {
    fn tell(&mut self, _: &str) {}

    fn ask(&mut self, _: &str) {
        self.answers.clear();
        self.answers.push_back(Some(self.asked) != self.no_to);
        self.asked += 1;
    }

    fn answer(&mut self) -> Option<bool> {
        self.answers.pop_front()
    }

    fn done(&mut self, report: &StepReport) -> Result<(), JournalError> {
        println!("{report:#?}");
        Ok(())
    }
}

fn prepared(robot: &str, preset: &str, seed: u64) -> Prepared {
    let mut config = Config {
        seed,
        robot: robot.to_owned(),
        ..Config::default()
    };
    config.plan.poses = 3;
    config.plan.choice = Choice::Grid;
    config.plant.insert("preset".to_owned(), preset.into());
    prepare(&config).expect("a plan")
}

/// What a commissioning finds, and what its store then holds.
fn commissioned(prepared: &Prepared, person: &mut Person) -> (Commissioning, Vec<Commissioning>) {
    let folder = tempfile::tempdir().expect("a folder");
    let file = StoreLocation::File(folder.path().join("calibration.db"));
    let mut store = open_store(&file, true).expect("a new store");
    let interrupt = AtomicBool::new(false);
    let found = commission(
        prepared,
        &Link::Sim,
        Path::new("."),
        store.as_mut(),
        person,
        &mut Silent,
        &interrupt,
    );
    let found = found.expect("the simulated arm does not fail");
    let stored = commissionings(store.as_mut(), "").expect("readable");
    assert!(
        store.newest_run().expect("readable").is_none(),
        "a commissioning is no calibration"
    );
    store.verify().expect("whole");
    (found, stored)
}

// Fails if an arm as described, or one as hard as real ones, does not pass every step, if a step is left out or asks
// fewer than two questions, or if the store does not hold what was found.
#[test]
fn sound_arms_pass_every_step() {
    for (robot, preset, seed) in [
        ("iiwa7", "typical", 1),
        ("iiwa7", "as_measured", 2),
        ("panda", "typical", 3),
    ] {
        let mut person = Person::default();
        let (found, stored) = commissioned(&prepared(robot, preset, seed), &mut person);
        assert!(found.passed(), "{robot} {preset} {seed}: {found:#?}");
        let steps: Vec<Step> = found.steps.iter().map(|s| s.step).collect();
        assert_eq!(steps, Step::ALL);
        assert_eq!(person.asked, 2 * Step::ALL.len());
        assert_eq!(stored, [found]);
    }
}

// Fails if a no is not the end: questions 0 and 1 belong to step 1, 2 and 3 to step 2, and so on.
#[test]
fn a_no_ends_the_procedure() {
    let prepared = prepared("iiwa7", "typical", 1);
    for no_to in [0, 2, 3, 6] {
        let mut person = Person {
            no_to: Some(no_to),
            ..Person::default()
        };
        let (found, stored) = commissioned(&prepared, &mut person);
        assert_eq!(person.asked, no_to + 1, "nothing is asked after a no");
        assert_eq!(found.steps.len(), no_to / 2 + 1);
        let last = found.steps.last().expect("a step");
        let expected = if no_to % 2 == 0 {
            Verdict::Declined
        } else {
            Verdict::Failed
        };
        assert_eq!(last.verdict, expected);
        assert!(!found.passed());
        assert_eq!(stored, [found]);
    }
}

// Fails if an arm that carries 1.5 kg which nobody declared is moved: the first step must find it.
#[test]
fn a_load_that_was_not_declared_is_found_before_the_arm_moves() {
    let prepared = prepared("iiwa7", "typical", 1);
    let mut loaded = prepared.tool;
    loaded.body.mass_kg += 1.5;
    let mut person = Person::default();
    let found = with_real_tool(&prepared, loaded, &mut person);
    assert_eq!(found.steps.len(), 1, "{found:#?}");
    assert_eq!(found.steps[0].verdict, Verdict::Failed);
}

/// The first step on an arm with another tool than the host believes.
fn with_real_tool(prepared: &Prepared, tool: spherecal_shared::robot::Tool, person: &mut Person) -> Commissioning {
    use spherecal::campaign::commission::{ReadOnlyLimits, commission_read_only};
    let arm = spherecal::sim::simulated_arm(&prepared.robot, &tool, &prepared.plant, &prepared.plan.home.joints);
    let mut reader = spherecal::link::DriveReader::new(arm.expect("an arm")).expect("this protocol");
    let report = commission_read_only(
        &mut reader,
        &prepared.robot,
        &prepared.tool,
        &ReadOnlyLimits::default(),
        person,
        &AtomicBool::new(false),
    );
    Commissioning {
        steps: vec![report.expect("read")],
        ..Commissioning::default()
    }
}
