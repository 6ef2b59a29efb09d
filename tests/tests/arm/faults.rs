//! Faults injected into the whole system: what becomes of the run.

use std::collections::BTreeSet;
use std::path::Path;

use spherecal::campaign::{CampaignError, Outcome};
use spherecal::link::qemu::{Qemu, QemuOptions};
use spherecal::link::{Controller, LinkError, controller_in_process};
use spherecal::sim::inject::{FaultPlan, FaultyCell, FaultyDrive, InjectedFault, NotReadyStatus, PlannedFault, When};
use spherecal::sim::plant::PlantConfig;
use spherecal::sim::simulated_arm;
use spherecal_lab::faults::{CampaignOptions, Case, Finish, MatrixOptions, TrialEnd, campaign, matrix};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Event, Fault, Phase};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use spherecal_tests::plan::{Memory, ONCE, carry_out_with, short_plan};
use spherecal_tests::qemu::image;

fn during(name: Phase, entry: u32, after_s: f64) -> When {
    When::Phase { name, entry, after_s }
}

fn plan(faults: &[(InjectedFault, When, f64)]) -> FaultPlan {
    let faults = faults.iter().map(|&(what, when, for_s)| PlannedFault {
        what,
        when,
        for_s: Some(for_s),
    });
    FaultPlan {
        seed: 1,
        host_link: None,
        faults: faults.collect(),
    }
}

type Make = Box<dyn FnMut() -> Result<Box<dyn Controller>, LinkError> + Send>;

fn in_process() -> Make {
    Box::new(|| controller_in_process(7))
}

/// Two spheres, three poses each, with a plan of faults.
fn campaign_with(faults: &FaultPlan, mut make: Make) -> (Memory, Outcome, Result<(), CampaignError>) {
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[0, 1], &[0.0, 0.15, -0.1]);
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let drive = simulated_arm(&robot, &tool, &config, &plan.home.joints).expect("a plant");
    let first = make().expect("a controller");
    let mut device = FaultyCell::new(first, FaultyDrive::Simulated(drive), 7, faults, make).expect("a device");
    let mut procedure = Procedure::default();
    procedure.couple.hold_s = 1.0;
    procedure.record.samples = 300;
    carry_out_with(&mut device, &plan, &BTreeSet::new(), &procedure, ONCE)
}

/// Time of the last whole turn, in s.
fn last_turn_s(memory: &Memory) -> f64 {
    let (mut began, mut last) = (0, 0);
    for event in &memory.events {
        let Event::Phase(change) = event else { continue };
        if change.phase == Phase::Turning {
            began = change.time_us;
        } else if (change.from, change.phase) == (Phase::Turning, Phase::Recording) {
            last = change.time_us - began;
        }
    }
    last as f64 * 1e-6
}

fn poses(memory: &Memory) -> Vec<(u32, u32)> {
    memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect()
}

// Fails if an emergency stop, a push, a lost magnet, a controller that is reset
// and a host link that is down in one run cost a pose, give one twice, if the arm turns as fast
// as before after the nest has left its sphere in a turn, or if they leave angles that differ from
// those of an undisturbed run by more than a new coupling does.
#[test]
fn a_run_goes_on_at_the_pose_where_it_was() {
    let (clean, _, result) = campaign_with(&FaultPlan::default(), in_process());
    result.expect("the undisturbed run ends well");
    let stop = InjectedFault::DriveStatus {
        status: NotReadyStatus::EmergencyStop,
    };
    let push = InjectedFault::HumanPush {
        force_n: [35.0, 35.0, 0.0],
    };
    let faults = plan(&[
        (stop, during(Phase::Recording, 1, 0.1), 3.0),
        (push, during(Phase::Recording, 3, 0.1), 0.3),
        (InjectedFault::ControllerReset, during(Phase::Recording, 5, 0.1), 0.0),
        (InjectedFault::MagnetLost, during(Phase::Turning, 8, 0.05), 1.0),
        (InjectedFault::HostSilent, during(Phase::Approaching, 4, 0.2), 3.5),
    ]);
    let (memory, outcome, result) = campaign_with(&faults, in_process());
    result.expect("the run ends well");
    assert_eq!(poses(&memory), poses(&clean));
    let told: Vec<Fault> = outcome.faults.iter().map(|f| f.fault).collect();
    for fault in [Fault::Drive, Fault::ContactLost, Fault::HostSilence] {
        assert!(told.contains(&fault), "{fault:?} was not told: {told:?}");
    }
    assert!(outcome.rejected.is_empty());
    let (slow, fast) = (last_turn_s(&memory), last_turn_s(&clean));
    assert!(slow > 1.1 * fast, "{slow} and {fast} s");
    for (with, without) in memory.recordings.iter().zip(&clean.recordings) {
        for (a, b) in with.q.iter().zip(&without.q) {
            // The redundant arm may rest elsewhere on its circle of elbows.
            assert!((a.mean - b.mean).abs() < 0.05, "{} and {} rad", a.mean, b.mean);
        }
    }
}

// Fails if a pose whose turn loses the nest twice is given up, or is not turned to more slowly the third time than the second.
#[test]
fn a_pose_that_loses_its_nest_twice_is_tried_more_slowly() {
    let lost = |entry| (InjectedFault::MagnetLost, during(Phase::Turning, entry, 0.05), 1.0);
    let run = |faults: &[_]| {
        let (memory, outcome, result) = campaign_with(&plan(faults), in_process());
        result.expect("the run ends well");
        assert!(outcome.rejected.is_empty(), "{:?}", outcome.rejected);
        assert_eq!(outcome.faults.len(), faults.len(), "{:?}", outcome.faults);
        last_turn_s(&memory)
    };
    let (once, twice) = (run(&[lost(5)]), run(&[lost(5), lost(6)]));
    assert!(twice > 2.0 * once, "{twice} and {once} s");
}

// Fails if a nest whose magnet lets go while it stands still leaves a recording,
// at any pose: friction holds it, and only the pull tells.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_magnet_that_lets_go_leaves_no_recording() {
    let case = Case::new(3, Finish::Record).expect("a case");
    for entry in 1..=6 {
        let when = during(Phase::Recording, entry, 0.15);
        let trial = case
            .run(&plan(&[(InjectedFault::MagnetLost, when, 2.0)]))
            .expect("a run");
        assert!(trial.bad.is_empty(), "recording {entry}: {:?}", trial.bad);
        let told: Vec<_> = trial.faults.iter().map(|f| (f.fault, f.phase)).collect();
        assert_eq!(told, [(Fault::ContactLost, Phase::Recording)], "recording {entry}");
        assert_eq!(trial.recordings.len(), 6);
    }
}

// Fails if a sphere that is moved while its host is gone is taken by the next
// host for one that always stood there.
#[test]
fn a_sphere_moved_while_no_host_is_there_is_noticed() {
    let case = Case::new(1, Finish::Record).expect("a case");
    let moved = InjectedFault::SphereMoved {
        by_m: [0.02, 0.0, 0.0],
        over_s: 0.2,
    };
    let killed = InjectedFault::HostKilled { away_s: 3.0 };
    let when = |after_s| during(Phase::Turning, 2, after_s);
    let trial = case
        .run(&plan(&[(killed, when(0.1), 0.0), (moved, when(0.2), f64::INFINITY)]))
        .expect("a run");
    assert_eq!(trial.resumed, 1);
    assert!(
        matches!(&trial.ended, TrialEnd::Stopped(why) if why.contains("mm from where it was found before")),
        "{:?}",
        trial.ended
    );
}

// Fails if a run does not stop, or stops without saying what a person should
// do: for a mass that nobody declared, a sphere that is gone, one that was moved,
// an encoder that lost its place and a controller that stays silent.
#[test]
fn what_cannot_be_mended_is_explained() {
    let forever = f64::INFINITY;
    let moved = InjectedFault::SphereMoved {
        by_m: [0.02, 0.0, 0.0],
        over_s: 0.2,
    };
    let jump = InjectedFault::PositionJump { joint: 2, rad: 0.1 };
    let cases: [(InjectedFault, When, &str); 5] = [
        (InjectedFault::Payload { kg: 1.5 }, When::Tick(2000), "tool mass"),
        (
            InjectedFault::SphereMissing,
            during(Phase::Taring, 1, 0.0),
            "no contact with sphere 1",
        ),
        (moved, during(Phase::Coupled, 2, 0.0), "moved"),
        (jump, during(Phase::Moving, 1, 0.3), "encoder"),
        (
            InjectedFault::HostSilent,
            during(Phase::Turning, 1, 0.1),
            "check its power",
        ),
    ];
    for (fault, when, remedy) in cases {
        let (memory, _, result) = campaign_with(&plan(&[(fault, when, forever)]), in_process());
        let error = result.expect_err(fault.name()).to_string();
        assert!(error.contains(remedy), "{}: {error}", fault.name());
        assert!(memory.recordings.len() < 6);
    }
}

// Fails if faults of the drive link come out otherwise in QEMU than in this
// process: another fault, phase or tick, or another recording.
#[test]
#[ignore = "long: half a minute of robot time in QEMU"]
fn long_faults_are_the_same_in_qemu() {
    let Some(image) = image() else { return };
    let faults = plan(&[
        (
            InjectedFault::StateNan { joint: 3 },
            during(Phase::Recording, 2, 0.1),
            0.02,
        ),
        (InjectedFault::StateRepeated, during(Phase::Turning, 4, 0.1), 0.05),
        (InjectedFault::StateFrozen, during(Phase::Moving, 4, 0.2), 0.1),
    ]);
    let (here, at_home, result) = campaign_with(&faults, in_process());
    result.expect("the run ends well");
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().to_owned();
    let make = move || start(&image, &path);
    let (there, away, result) = campaign_with(&faults, Box::new(make));
    result.expect("the run in QEMU ends well");
    assert_eq!(at_home.faults.len(), 3, "{:?}", at_home.faults);
    assert_eq!(away.faults, at_home.faults);
    assert_eq!(there.recordings, here.recordings);
}

fn start(image: &Path, folder: &Path) -> Result<Box<dyn Controller>, LinkError> {
    let options = QemuOptions {
        image: Some(image.to_owned()),
        ..QemuOptions::new(folder)
    };
    Ok(Box::new(Qemu::start(&options)?))
}

// Fails if a controller in QEMU that is reset in the middle of a recording is
// not found again, or the run loses or repeats a pose by it.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_controller_in_qemu_is_reset() {
    let Some(image) = image() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let path = folder.path().to_owned();
    let faults = plan(&[(InjectedFault::ControllerReset, during(Phase::Recording, 2, 0.1), 0.0)]);
    let (memory, _, result) = campaign_with(&faults, Box::new(move || start(&image, &path)));
    result.expect("the run ends well");
    assert_eq!(poses(&memory), [(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)]);
}

/// A number from the environment, for the whole campaigns.
fn amount(name: &str, usual: u64) -> u64 {
    std::env::var(name).ok().and_then(|n| n.parse().ok()).unwrap_or(usual)
}

// Fails if any fault at any of the sampled instants ends otherwise than
// docs/recovery.md says. The whole matrix: `spherecal-lab faults`.
#[test]
#[cfg_attr(debug_assertions, ignore = "long: scripts/test --long runs it")]
fn long_every_fault_alone() {
    let table = matrix::run(&MatrixOptions {
        instants: amount("SPHERECAL_INSTANTS", 2) as u32,
        seeds: amount("SPHERECAL_SEEDS", 1),
        ..MatrixOptions::default()
    })
    .expect("a matrix");
    println!("{table}");
    assert!(table.holds(), "{table}");
    assert!(table.rows.iter().all(|row| row.runs >= 2), "every fault was injected");
}

// Fails if any of the sampled runs with random faults ends otherwise than
// calibrated as well as without, or with a stop that says why. The whole
// campaign: `spherecal-lab faults --campaign 1000`.
#[test]
#[cfg_attr(debug_assertions, ignore = "long: run by name")]
fn long_a_campaign_of_random_faults() {
    let runs = amount("SPHERECAL_RUNS", 12);
    let table = campaign::run(&CampaignOptions {
        runs,
        seeds: 2,
        preset: "as_measured".to_owned(),
        only: None,
        progress: false,
    })
    .expect("a campaign");
    println!("{table}");
    assert!(table.holds(), "{table}");
    assert_eq!(table.runs as u64, runs);
    assert!(table.injected > table.runs, "one to four faults a run");
}
