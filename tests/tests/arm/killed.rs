//! The host killed at any instant of a visit, while the drive lives on: the controller of the next session is new and
//! knows nothing of a nest on a sphere.

use std::collections::BTreeSet;
use std::sync::atomic::AtomicBool;
use std::sync::{Arc, Mutex};

use nalgebra::Vector3;
use spherecal::campaign::{Assignment, CampaignError, CampaignObserver, run};
use spherecal::link::{Arrival, Device, Drive, LinkError, LocalDevice};
use spherecal::plan::Plan;
use spherecal::sim::SimulatedArm;
use spherecal::sim::plant::{Plant, PlantConfig};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::host::{Coupled, Event, Phase};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};
use spherecal_tests::plan::{Memory, ONCE, cell, short_plan};

/// Largest force in N with which an arm may pull at a nest on a sphere outside a release. (A host that is killed as the arm
/// leaves the sphere leaves it pulling, with its brakes closed.)
const PULL_N: f64 = 15.0;
/// Periods over which a force is averaged. A magnet that draws the nest in when the brakes open ends in a blow, which rings
/// for some 10 ms.
const MEAN: usize = 20;

/// What arm and controller do at present.
#[derive(Default)]
struct Seen {
    phase: Phase,
    /// Periods so far.
    periods: u64,
    /// The period in which the nest was seated first.
    seated: Option<u64>,
    /// The newest forces of the arm on nest and magnet, F0, in N.
    pulls: Vec<Vector3<f64>>,
    /// The largest mean of them, in N, under control with the nest on a sphere, and neither coupled nor in a release.
    worst_n: f64,
}

/// A drive that lives on when its controller has ended.
#[derive(Clone)]
struct LivingDrive {
    hello: DriveHello,
    arm: Arc<Mutex<SimulatedArm<7>>>,
    seen: Arc<Mutex<Seen>>,
}

impl LivingDrive {
    fn new(config: &PlantConfig, plan: &Plan) -> Self {
        let home: [f64; 7] = plan.home.joints.as_slice().try_into().expect("seven joints");
        let plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &home).expect("a plant");
        let arm = SimulatedArm::new(plant, &iiwa7());
        Self {
            hello: arm.hello().clone(),
            arm: Arc::new(Mutex::new(arm)),
            seen: Arc::default(),
        }
    }
}

impl Drive for LivingDrive {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        let mut arm = self.arm.lock().expect("no panic");
        arm.exchange(command, state)?;
        let truth = arm.plant().truth();
        let mut seen = self.seen.lock().expect("no panic");
        seen.periods += 1;
        // What pads and magnet do not balance between them, the arm carries.
        seen.pulls.push(truth.contact_n + truth.magnet_n);
        let begin = seen.pulls.len().saturating_sub(MEAN);
        seen.pulls.drain(..begin);
        if truth.seated.is_none() {
            return Ok(());
        }
        seen.seated = seen.seated.or(Some(seen.periods));
        let free = matches!(seen.phase, Phase::Idle | Phase::Moving | Phase::Fault);
        if free && command.is_some_and(|command| command.enable) {
            let mean = seen.pulls.iter().sum::<Vector3<f64>>() / MEAN as f64;
            seen.worst_n = seen.worst_n.max(mean.norm());
        }
        Ok(())
    }
}

impl CampaignObserver for LivingDrive {
    fn event(&mut self, _: u64, arrival: &Arrival) {
        if let Event::Phase(change) = &arrival.body {
            self.seen.lock().expect("no panic").phase = change.phase;
        }
    }
}

/// A device whose host is killed after some periods.
struct Mortal {
    device: LocalDevice,
    left: u64,
}

impl Device for Mortal {
    fn now_us(&self) -> u64 {
        self.device.now_us()
    }

    fn ticks(&self) -> u64 {
        self.device.ticks()
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        self.left = self.left.checked_sub(1).ok_or_else(|| LinkError::device("killed"))?;
        self.device.step(down, up)
    }
}

/// One session of a new host with a new controller, for `ticks` periods at most. It goes on where `memory` ends.
fn session(drive: &LivingDrive, plan: &Plan, memory: &mut Memory, ticks: u64) -> (u64, Result<(), CampaignError>) {
    let (robot, tool) = (iiwa7(), iiwa7_tool());
    let done: BTreeSet<_> = memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect();
    let couplings = memory.events.iter().filter_map(|event| match event {
        Event::Coupled(coupled) => Some(*coupled),
        _ => None,
    });
    let assignment = Assignment {
        robot: &robot,
        tool: &tool,
        procedure: &Procedure::default(),
        plan,
        done: &done,
        seated: &couplings.collect::<Vec<Coupled>>(),
        options: ONCE,
    };
    drive.seen.lock().expect("no panic").phase = Phase::Idle;
    let device = cell(Box::new(drive.clone()));
    let mut mortal = Mortal { device, left: ticks };
    let mut observer = drive.clone();
    let (_, result) = run(&assignment, &mut mortal, memory, &mut observer, &AtomicBool::new(false));
    (mortal.ticks(), result)
}

// Fails if a session that follows a kill, at any instant from the approach to the way home, pulls at a nest on a
// sphere (it pulled with 19 to 21 N against the magnet and gave up), loses a pose, or records one twice. The kills just
// before the nest is seated leave it where the magnet draws it in as the brakes open.
#[test]
#[ignore = "slow: 32 kills of a visit"]
fn slow_a_new_controller_finds_out_that_the_nest_is_on_a_sphere() {
    const KILLS: u64 = 24;
    let config = PlantConfig::preset("typical").expect("a preset");
    let plan = short_plan(&config, &[0], &[0.0, 0.15]);
    let alone = LivingDrive::new(&config, &plan);
    let (whole, result) = session(&alone, &plan, &mut Memory::default(), u64::MAX);
    result.expect("it ends well");
    let drawn = alone.seen.lock().expect("no panic").seated.expect("it couples");
    let mut seated = 0;
    let anywhere = (0..KILLS).map(|kill| whole * (2 * kill + 1) / (2 * KILLS));
    for at in anywhere.chain((1..=8).map(|kill| drawn - 8 * kill)) {
        let drive = LivingDrive::new(&config, &plan);
        let mut memory = Memory::default();
        let (_, killed) = session(&drive, &plan, &mut memory, at);
        assert!(killed.is_err(), "it was killed in period {at}");
        let on = drive.arm.lock().expect("no panic").plant().truth().seated.is_some();
        seated += u32::from(on);
        let (_, result) = session(&drive, &plan, &mut memory, u64::MAX);
        let worst_n = drive.seen.lock().expect("no panic").worst_n;
        println!("killed at {at}, seated {on}: {result:?}, {worst_n:.1} N");
        result.unwrap_or_else(|error| panic!("killed in period {at}, seated {on}: {error}"));
        assert!(worst_n <= PULL_N, "killed in period {at}: {worst_n} N at the nest");
        let poses: Vec<_> = memory.recordings.iter().map(|r| (r.sphere, r.pose)).collect();
        assert_eq!(poses, [(1, 0), (1, 1)], "killed in period {at}");
    }
    assert!(seated >= 8, "only {seated} kills with the nest on the sphere");
}
