//! The first run on a robot, against the simulated arm: sound arms pass every step, and what is wrong is found before
//! the arm moves far.

use std::collections::VecDeque;
use std::path::Path;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU64, Ordering};

use spherecal::campaign::commission::{
    Attendant, CommissioningStep, MovingLimits, StepEnd, StepReport, commission_moving,
};
use spherecal::campaign::{Assignment, CampaignError, Silent};
use spherecal::job::{Choice, Commissioning, Config, Link, PreparedRun, commission, commissionings, open_store};
use spherecal::link::{Drive, JournalError, LinkError, LocalDevice, controller_in_process};
use spherecal::sim::plant::Disturbance;
use spherecal::sim::{Disturb, simulated_arm};
use spherecal::simulated::{plant, prepare};
use spherecal::store::StoreLocation;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};

/// Answers yes, but to the questions that are numbered.
#[derive(Default)]
struct Person {
    asked: usize,
    no_to: Option<usize>,
    answers: VecDeque<bool>,
    kept: Vec<StepReport>,
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
        self.kept.push(report.clone());
        Ok(())
    }
}

fn prepared(robot: &str, preset: &str, seed: u64) -> PreparedRun {
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
fn commissioned(prepared: &PreparedRun, person: &mut Person) -> (Commissioning, Vec<Commissioning>) {
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
#[ignore = "long: scripts/test --long runs it"]
fn long_sound_arms_pass_every_step() {
    for (robot, preset, seed) in [
        ("iiwa7", "typical", 1),
        ("iiwa7", "as_measured", 2),
        ("panda", "typical", 3),
        // A joint that sticks and slips most, and the hardest contact, of 180 arms.
        ("panda", "typical", 12),
        ("fr3", "as_measured", 3),
    ] {
        let mut person = Person::default();
        let (found, stored) = commissioned(&prepared(robot, preset, seed), &mut person);
        assert!(found.passed(), "{robot} {preset} {seed}: {found:#?}");
        let steps: Vec<CommissioningStep> = found.steps.iter().map(|s| s.step).collect();
        assert_eq!(steps, CommissioningStep::ALL);
        assert_eq!(person.asked, 2 * CommissioningStep::ALL.len());
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
            StepEnd::Declined
        } else {
            StepEnd::Failed
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
    assert_eq!(found.steps[0].verdict, StepEnd::Failed);
}

/// The first step on an arm with another tool than the host believes.
fn with_real_tool(prepared: &PreparedRun, tool: spherecal_shared::robot::Tool, person: &mut Person) -> Commissioning {
    use spherecal::campaign::commission::{ReadOnlyLimits, commission_read_only};
    let plant = plant(&prepared.config).expect("a plant");
    let arm = spherecal::sim::simulated_arm(&prepared.robot, &tool, &plant, &prepared.plan.home.joints);
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

/// A simulated arm to which something happens.
struct Cell {
    drive: Box<dyn Disturb>,
    /// Control periods with open brakes.
    enabled: Arc<AtomicU64>,
    /// At how many of them something happens, in order.
    happens: VecDeque<(u64, Disturbance)>,
    /// The brakes never open.
    stuck: bool,
}

impl Drive for Cell {
    fn hello(&self) -> &DriveHello {
        self.drive.hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        if command.is_some_and(|c| c.enable) {
            let count = self.enabled.fetch_add(1, Ordering::Relaxed);
            while let Some((_, what)) = self.happens.pop_front_if(|(at, _)| *at <= count) {
                self.drive.disturb(&what);
            }
        }
        let held = command.filter(|_| self.stuck).map(|command| DriveCommand {
            enable: false,
            ..command.clone()
        });
        self.drive.exchange(held.as_ref().or(command), state)
    }
}

/// Steps 2 to 5 in such a cell: their reports, the error, the questions asked, and the periods with open brakes.
fn moved_in(
    happens: &[(u64, Disturbance)],
    stuck: bool,
    no_to: Option<usize>,
) -> (Vec<StepReport>, Option<CampaignError>, usize, u64) {
    let prepared = prepared("iiwa7", "typical", 1);
    let arm = simulated_arm(
        &prepared.robot,
        &prepared.tool,
        &plant(&prepared.config).expect("a plant"),
        &prepared.plan.home.joints,
    );
    let enabled = Arc::new(AtomicU64::new(0));
    let cell = Cell {
        drive: arm.expect("an arm"),
        enabled: Arc::clone(&enabled),
        happens: happens.iter().copied().collect(),
        stuck,
    };
    let controller = controller_in_process(7).expect("seven joints");
    let mut device = LocalDevice::new(controller, Box::new(cell), 7).expect("they fit");
    let done = std::collections::BTreeSet::new();
    let assignment = Assignment {
        robot: &prepared.robot,
        tool: &prepared.tool,
        procedure: &prepared.config.procedure,
        plan: &prepared.plan,
        done: &done,
        seated: &[],
        options: prepared.config.campaign.options(),
    };
    let mut person = Person {
        no_to,
        ..Person::default()
    };
    let result = commission_moving(
        &assignment,
        &mut device,
        &MovingLimits::default(),
        &mut person,
        &mut Silent,
        &AtomicBool::new(false),
    );
    (person.kept, result.err(), person.asked, enabled.load(Ordering::Relaxed))
}

// Fails if the brakes open although the person did not agree to the first step that moves.
#[test]
fn without_a_yes_no_torque_is_commanded() {
    let (kept, error, asked, enabled) = moved_in(&[], false, Some(0));
    assert!(error.is_none(), "{error:?}");
    assert_eq!((kept.len(), kept[0].verdict), (1, StepEnd::Declined));
    assert_eq!((asked, enabled), (1, 0));
}

// Fails if an arm that is pushed, or that carries what nobody declared, passes at zero stiffness, if it is watched on
// while it goes, or if the person is asked whether that was as expected. A second of ramps comes before the hold.
#[test]
fn an_arm_that_goes_ends_at_zero_stiffness() {
    let (_, _, _, whole) = moved_in(&[], false, Some(1));
    for what in [Disturbance::Push([0.0, 40.0, 0.0]), Disturbance::Payload(3.0)] {
        let (kept, error, asked, enabled) = moved_in(&[(1000, what)], false, None);
        assert!(error.is_none(), "{error:?}");
        assert_eq!((kept.len(), asked), (1, 1), "{kept:?}");
        assert_eq!(
            (kept[0].step, kept[0].verdict),
            (CommissioningStep::ZeroStiffness, StepEnd::Failed),
            "{kept:?}"
        );
        assert!(!kept[0].remarks.is_empty(), "it says what to do");
        assert!(enabled + 2000 < whole, "{what:?}: {enabled} of {whole} periods");
    }
}

// Fails if an arm passes that springs hold but a hand presses.
#[test]
fn a_pressed_arm_fails_the_soft_hold() {
    let (_, _, _, first) = moved_in(&[], false, Some(2));
    let press = (first + 500, Disturbance::Push([0.0, 0.0, -80.0]));
    let (kept, error, asked, _) = moved_in(&[press], false, None);
    assert!(error.is_none(), "{error:?}");
    assert_eq!((kept.len(), asked), (2, 3), "{kept:?}");
    assert_eq!(
        (kept[1].step, kept[1].verdict),
        (CommissioningStep::SoftHold, StepEnd::Failed),
        "{kept:?}"
    );
}

// Fails if an arm whose brakes never open passes, or if what ended its commissioning is not kept.
#[test]
fn a_stuck_arm_fails_and_is_kept() {
    let (kept, error, _, _) = moved_in(&[], true, None);
    let last = kept.last().expect("kept");
    assert_eq!(last.verdict, StepEnd::Failed, "{kept:?} {error:?}");
    assert!(last.step <= CommissioningStep::FreeMotion, "{kept:?}");
    assert!(!last.remarks.is_empty(), "{last:?}");
}
