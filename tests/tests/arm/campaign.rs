//! The campaign over the real host link, the real controller and the plant.

use std::collections::BTreeSet;

use spherecal::campaign::{CampaignError, CampaignObserver, Outcome, RunOptions};
use spherecal::link::Arrival;
use spherecal::plan::Plan;
use spherecal::sim::plant::PlantConfig;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::{Event, Fault, Phase};
use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};
use spherecal_tests::plan::{Memory, carry_out, carry_out_observed, cell, plant, short_plan, solve};

/// How far a waypoint is off that ends beside the sphere, in m: the nest's body
/// ends 42 mm from its axis.
const WRONG_M: f64 = 0.043;
/// Turns of the tool about each sphere, in rad.
const TURNS: [f64; 3] = [0.0, 0.15, -0.1];

fn campaign(
    config: &PlantConfig,
    plan: &Plan,
    done: &BTreeSet<(u32, u32)>,
) -> (Memory, Outcome, Result<(), CampaignError>) {
    carry_out(&mut cell(plant(config, plan)), plan, done)
}

// Fails if a pose is not recorded, is recorded twice or out of order, if a
// recording is not the mean of 200 samples, or if any fault occurs.
#[test]
fn two_spheres_are_recorded_pose_by_pose() {
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[0, 1], &TURNS);
    let (memory, outcome, result) = campaign(&config, &plan, &BTreeSet::new());
    result.expect("the campaign ends well");
    let order: Vec<_> = memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect();
    assert_eq!(order, [(1, 0), (1, 1), (1, 2), (2, 0), (2, 1), (2, 2)]);
    assert!(
        memory.recordings.iter().all(|r| r.count == 200 && r.gaps == 0),
        "200 samples without gaps"
    );
    assert_eq!(
        (outcome.faults.len(), outcome.contacts.len(), outcome.recorded),
        (0, 2, 6)
    );
    assert_eq!(
        (outcome.link.crc_errors, outcome.link.lost, outcome.link.duplicates),
        (0, 0, 0)
    );
    assert!(
        outcome.contacts.iter().all(|c| c.force_n >= 7.5),
        "contact is declared at 7.5 N"
    );
}

/// Says after `poses` recordings that they are enough, and that only at the `asked`-th question.
struct Enough {
    poses: usize,
    asked: u32,
    recorded: usize,
}

impl CampaignObserver for Enough {
    fn event(&mut self, _now_us: u64, arrival: &Arrival) {
        self.recorded += usize::from(matches!(arrival.body, Event::Recording(_)));
    }

    fn enough(&mut self, _waits: bool) -> Option<bool> {
        if self.recorded < self.poses {
            return Some(false);
        }
        self.asked = self.asked.saturating_sub(1);
        (self.asked == 0).then_some(true)
    }
}

// Fails if a campaign that is told on a sphere that its recordings are enough records another pose, takes the next sphere,
// stays on its sphere, or leaves out the second visit of the sphere that it measured; or if it does not wait for the answer.
#[test]
fn a_campaign_with_enough_recordings_ends_as_a_complete_one() {
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[0, 1], &TURNS);
    let took_us = [1, 300].map(|asked| {
        let mut enough = Enough {
            poses: 2,
            asked,
            recorded: 0,
        };
        let (memory, outcome, result) = carry_out_observed(
            &mut cell(plant(&config, &plan)),
            &plan,
            &BTreeSet::new(),
            &Procedure::default(),
            RunOptions::DEFAULT,
            &mut enough,
        );
        result.expect("the campaign ends well");
        let order: Vec<_> = memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect();
        assert_eq!(order, [(1, 0), (1, 1)]);
        let coupled = |event: &&Event| matches!(event, Event::Coupled(_));
        assert_eq!(memory.events.iter().filter(coupled).count(), 2, "and a second visit");
        assert!(outcome.faults.is_empty(), "{:?}", outcome.faults);
        let phases = memory.events.iter().rev().filter_map(|event| match event {
            Event::Phase(change) => Some(change.phase),
            _ => None,
        });
        assert_eq!(phases.take(2).collect::<Vec<_>>(), [Phase::Idle, Phase::Moving], "home");
        outcome.simulated_us
    });
    // Of 299 control periods of waiting, the lead of the next command takes 60 in any case.
    assert!(took_us[1] > took_us[0] + 200_000, "{took_us:?}");
}

// Fails if a stop that needs no way over home is not reached straight from the one before, which saves time, or not as
// well. Where the straight motion is not clear, its vias may take longer than the way over home.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_stop_is_reached_straight_from_the_one_before() {
    let config = PlantConfig::typical();
    let mut saved_s = Vec::new();
    for pair in [[0, 1], [1, 2], [2, 0]] {
        let over_home = short_plan(&config, &pair, &TURNS);
        let mut straight = over_home.clone();
        straight.spheres[1].over_home = false;
        let (_, before, result) = campaign(&config, &over_home, &BTreeSet::new());
        result.expect("the campaign ends well");
        let (memory, outcome, result) = campaign(&config, &straight, &BTreeSet::new());
        result.expect("the campaign ends well");
        assert_eq!((memory.recordings.len(), outcome.faults.len()), (6, 0));
        saved_s.push((before.simulated_us as f64 - outcome.simulated_us as f64) * 1e-6);
    }
    println!("saved {saved_s:?} s");
    assert!(saved_s.iter().any(|s| *s > 0.5), "saved {saved_s:?} s");
}

// Fails if the same seed gives other bits, or another seed the same.
#[test]
fn one_seed_gives_the_same_bits() {
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[2], &TURNS);
    let (first, _, _) = campaign(&config, &plan, &BTreeSet::new());
    let (second, _, _) = campaign(&config, &plan, &BTreeSet::new());
    assert_eq!(first.recordings.len(), 3);
    assert_eq!(first.recordings, second.recordings);
    let other = PlantConfig { seed: 2, ..config };
    assert_ne!(first.recordings, campaign(&other, &plan, &BTreeSet::new()).0.recordings);
}

// Fails if a recording can come from anything but contact: without it the
// campaign stops with a typed reason and has recorded nothing.
#[test]
fn without_contact_there_is_no_recording() {
    let config = PlantConfig {
        contact: false,
        ..PlantConfig::typical()
    };
    let (memory, outcome, result) = campaign(&config, &short_plan(&config, &[0], &TURNS), &BTreeSet::new());
    let error = result.expect_err("there is nothing to touch");
    assert!(
        matches!(error, CampaignError::NoContact { sphere: 1, attempts: 3 }),
        "{error}"
    );
    assert!(error.to_string().starts_with("no contact with sphere 1"), "{error}");
    assert!(memory.recordings.is_empty());
    assert!(outcome.faults.iter().all(|f| f.fault == Fault::NoContact));
}

// Fails if a resumed campaign records again what it has, or leaves out what it has not.
#[test]
fn a_resumed_campaign_records_what_is_missing() {
    let config = PlantConfig::typical();
    let plan = short_plan(&config, &[0, 1], &TURNS);
    let done = BTreeSet::from([(1, 0), (1, 1), (1, 2), (2, 1)]);
    let (memory, _, result) = campaign(&config, &plan, &done);
    result.expect("the campaign ends well");
    let order: Vec<_> = memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect();
    assert_eq!(order, [(2, 0), (2, 2)]);
}

// Fails if a nest that lands beside a sphere is not brought onto it from beside
// its waypoint: the waypoint of sphere 1 is so far off that the same descent
// would end beside the sphere again.
#[test]
fn a_retry_begins_beside_a_waypoint_that_was_wrong() {
    let config = PlantConfig::typical();
    let mut plan = short_plan(&config, &[0], &TURNS);
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("an arm");
    let from: [f64; 7] = plan.spheres[0]
        .approach
        .joints
        .as_slice()
        .try_into()
        .expect("seven joints");
    let start = arm.tcp_frame(&arm.frames(&from));
    let aside = start.position + start.rotation.column(0) * WRONG_M;
    plan.spheres[0].approach.joints = solve(&arm, aside, start.rotation, from).to_vec();
    let (memory, outcome, result) = campaign(&config, &plan, &BTreeSet::new());
    result.expect("the campaign ends well");
    assert_eq!(memory.recordings.len(), 3);
    let faults: Vec<_> = outcome.faults.iter().map(|f| f.fault).collect();
    assert!(
        !faults.is_empty() && faults.iter().all(|f| matches!(f, Fault::NotSeated | Fault::NoContact)),
        "{faults:?}"
    );
}
