//! The real phase machine, driven through every sequence of events to a stated
//! depth, from a state in every phase.
//!
//! Events are what may happen between two looks: commands, time, drive states
//! that cannot be used, a silent host, pushes, a nest that leaves. After every
//! tick of every sequence the safety properties are checked:
//!
//! 1. no torque without a fresh drive state: an unusable one gets the last torque
//!    again, 23 times in a row at most, then brakes; torques are finite, within
//!    their limits, and change no faster than allowed;
//! 2. nothing is recorded unless the nest was seated and still all the time;
//! 3. a fault is followed by the fault phase in the same tick, which only
//!    `ClearFault` ends;
//! 4. no deadlock: from everywhere a healthy drive and `Stop`, `ClearFault` lead
//!    to an idle controller that obeys.

use std::collections::BTreeSet;
use std::format;
use std::string::String;
use std::vec::Vec;

use nalgebra::Vector3;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::DriveStatus;
use spherecal_shared::protocol::host::{Command, Event, Phase};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use crate::phases::Activity;
use crate::testing::{Bench, HOME};

/// What may happen next.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Happens {
    Short,
    Long,
    Repeated,
    NotANumber,
    Gap,
    Jump,
    Stopped,
    Missed,
    Silent,
    Push,
    Leaves,
    Move,
    Approach,
    Pose,
    Decouple,
    Retreat,
    Stop,
    Clear,
    Guide,
    Unguide,
    Configure,
}

const ALL: [Happens; 21] = [
    Happens::Short,
    Happens::Long,
    Happens::Repeated,
    Happens::NotANumber,
    Happens::Gap,
    Happens::Jump,
    Happens::Stopped,
    Happens::Missed,
    Happens::Silent,
    Happens::Push,
    Happens::Leaves,
    Happens::Move,
    Happens::Approach,
    Happens::Pose,
    Happens::Decouple,
    Happens::Retreat,
    Happens::Stop,
    Happens::Clear,
    Happens::Guide,
    Happens::Unguide,
    Happens::Configure,
];

/// Commands without a fresh state at most: bridged, and until the brakes close.
const BLIND: u32 = 3 + 20;
/// Speed of the nest under which it is still, in m/s.
const STILL_M_S: f64 = 0.01;

fn procedure() -> Procedure {
    let mut procedure = Bench::brisk();
    procedure.approach.tare_s = 0.05;
    procedure.couple.hold_s = 0.05;
    procedure.seating.test_s = 0.1;
    procedure.record.samples = 30;
    procedure.limits.host_silence_s = 0.05;
    procedure
}

/// Controller, stand-in, and what is needed to judge them.
#[derive(Clone)]
struct World {
    bench: Bench,
    place: Vector3<f64>,
    /// Commands since the last fresh state.
    blind: u32,
    seen: usize,
    /// Since which tick the nest has been seated and still.
    quiet_since: u64,
    last: Vector3<f64>,
    cleared: bool,
    step: f64,
    /// The events that led here, for a message.
    path: Vec<Happens>,
}

impl World {
    fn new() -> Self {
        let bench = Bench::new(procedure());
        let place = bench.tcp() - Vector3::z() * 0.015;
        let mut world = Self {
            place,
            blind: 0,
            seen: bench.events.len(),
            quiet_since: 0,
            last: bench.tcp(),
            cleared: false,
            step: procedure().law.torque_rate_nm_s * 1e-3,
            path: Vec::new(),
            bench,
        };
        world.bench.sphere = Some(place);
        world
    }

    /// One tick, with a fresh state or one that cannot be used.
    fn tick(&mut self, spoil: Option<&dyn Fn(&mut spherecal_shared::protocol::drive::DriveState)>) {
        let before = self.bench.command.clone();
        let was = self.bench.controller.phase();
        match spoil {
            None => {
                self.bench.run(1);
                self.blind = if self.bench.status == DriveStatus::Ready {
                    0
                } else {
                    self.blind + 1
                };
            }
            Some(spoil) => {
                self.bench.tick += 1;
                let mut state = self.bench.state();
                spoil(&mut state);
                self.bench.tick_with(&state);
                self.blind += 1;
            }
        }
        let command = &self.bench.command;
        if self.blind > 0 && command.enable {
            assert!(
                self.blind <= BLIND,
                "{} torques without a fresh state: {:?}",
                self.blind,
                self.path
            );
            assert_eq!(
                command.tau, before.tau,
                "a new torque without a fresh state: {:?}",
                self.path
            );
        }
        for (i, (tau, last)) in command.tau.iter().zip(&before.tau).enumerate() {
            let limit = iiwa7().joints[i].limits.torque_nm;
            assert!(tau.abs() <= limit, "joint {}: {tau} N m", i + 1);
            if command.enable && before.enable {
                assert!(
                    (tau - last).abs() <= self.step + 1e-9,
                    "joint {}: {last} to {tau}",
                    i + 1
                );
            }
        }
        let tcp = self.bench.tcp();
        let speed = (tcp - self.last).norm() * 1e3;
        self.last = tcp;
        // The pull that ends a recording moves the nest, and must not move it off.
        let controller = &self.bench.controller;
        let pulls = matches!(&controller.activity,
            Activity::Recording(r) if r.count() == controller.procedure.record.samples);
        if !self.bench.caught || (speed > STILL_M_S && !pulls) {
            self.quiet_since = self.bench.tick;
        }
        let phase = self.bench.controller.phase();
        for event in &self.bench.events[self.seen..] {
            match event {
                Event::Fault(fault) => assert_eq!(phase, Phase::Fault, "{fault:?}"),
                Event::Recording(recording) => assert!(
                    recording.start_us / 1000 > self.quiet_since,
                    "recorded from {} on, still only from {} on: {:?}",
                    recording.start_us / 1000,
                    self.quiet_since,
                    self.path
                ),
                _ => {}
            }
        }
        self.seen = self.bench.events.len();
        assert!(
            was != Phase::Fault || phase == Phase::Fault || self.cleared,
            "a fault ended by itself: {:?}",
            self.path
        );
        self.cleared = false;
    }

    fn ticks(&mut self, count: u32) {
        for _ in 0..count {
            self.tick(None);
        }
    }

    /// Until the phase changes, so many ticks at most.
    fn pass(&mut self, most: u32) {
        let phase = self.bench.controller.phase();
        for _ in 0..most {
            self.tick(None);
            if self.bench.controller.phase() != phase {
                return;
            }
        }
    }

    fn queue_command(&mut self, command: Command) {
        // A refusal is an answer.
        let _ = self.bench.controller.command(command);
        self.tick(None);
    }

    fn happen(&mut self, what: Happens) {
        self.path.push(what);
        match what {
            Happens::Short => self.ticks(25),
            Happens::Long => self.pass(1200),
            Happens::Repeated => {
                for _ in 0..5 {
                    self.tick(Some(&|state| state.tick = 0));
                }
            }
            Happens::NotANumber => {
                for _ in 0..30 {
                    self.tick(Some(&|state| state.q[3] = f64::NAN));
                }
            }
            Happens::Gap => {
                self.bench.tick += 10;
                self.tick(None);
            }
            Happens::Jump => {
                for _ in 0..5 {
                    self.tick(Some(&|state| state.q[1] += 1.0));
                }
            }
            Happens::Stopped => {
                self.bench.status = DriveStatus::EmergencyStop;
                self.ticks(30);
                self.bench.status = DriveStatus::Ready;
            }
            Happens::Missed => {
                self.bench.controller.record_missed(5);
                self.bench.controller.record_missed(0);
                self.tick(None);
            }
            Happens::Silent => {
                self.bench.host = false;
                self.ticks(60);
                self.bench.host = true;
            }
            Happens::Push => {
                self.bench.push = Vector3::new(120.0, 0.0, 30.0);
                self.ticks(40);
                self.bench.push = Vector3::zeros();
            }
            Happens::Leaves => {
                self.bench.sphere = None;
                self.bench.caught = false;
                self.bench.push = Vector3::new(0.0, 0.0, 8.0);
                self.ticks(40);
                self.bench.push = Vector3::zeros();
                self.bench.sphere = Some(self.place);
            }
            Happens::Move => {
                let mut target = HOME;
                target[0] = 0.1;
                let target = Joints::from_slice(&target).expect("seven of eight");
                self.queue_command(Command::Move { target });
            }
            Happens::Approach => {
                let _ = self.bench.approach();
                self.tick(None);
            }
            Happens::Pose => {
                let _ = self.bench.pose(0.1, true);
                self.tick(None);
            }
            Happens::Decouple => self.queue_command(Command::Decouple),
            Happens::Retreat => self.queue_command(Command::Retreat {
                direction: [0.0, 0.0, -1.0],
            }),
            Happens::Stop => self.queue_command(Command::Stop),
            Happens::Clear => {
                self.cleared = true;
                self.queue_command(Command::ClearFault);
            }
            Happens::Guide => self.queue_command(Command::HandGuide { on: true }),
            Happens::Unguide => self.queue_command(Command::HandGuide { on: false }),
            Happens::Configure => {
                let tool = iiwa7_tool();
                let procedure = procedure();
                self.queue_command(Command::Configure { tool, procedure });
            }
        }
    }

    /// What of the state later events depend on.
    fn key(&self) -> String {
        let c = &self.bench.controller;
        format!(
            "{:?} touched {} braked {} blind {} on {} enabled {}",
            c.phase(),
            c.touched,
            c.braked,
            c.blind > 0,
            self.bench.caught,
            self.bench.command.enable
        )
    }

    /// Property 4.
    fn frees_itself(&self) {
        let mut world = self.clone();
        for _ in 0..3 {
            world.happen(Happens::Clear);
            world.happen(Happens::Stop);
            world.ticks(200);
        }
        assert_eq!(
            world.bench.controller.phase(),
            Phase::Idle,
            "from {}: {:?}",
            self.key(),
            self.path
        );
        let target = Joints::from_slice(&world.bench.q.as_slice()[..7]).expect("seven of eight");
        world
            .bench
            .controller
            .command(Command::Move { target })
            .expect("an idle controller obeys");
    }
}

/// A state in every phase.
fn beginnings() -> Vec<World> {
    let mut world = World::new();
    let mut all = Vec::from([world.clone()]);
    let mut guided = world.clone();
    guided.happen(Happens::Guide);
    let mut moving = world.clone();
    moving.happen(Happens::Move);
    moving.ticks(100);
    let mut failed = world.clone();
    failed.happen(Happens::Gap);
    all.extend([guided, moving, failed]);
    world.happen(Happens::Approach);
    for _ in 0..4 {
        all.push(world.clone());
        for _ in 0..20 {
            let phase = world.bench.controller.phase();
            world.pass(1200);
            if world.bench.controller.phase() != phase {
                break;
            }
        }
    }
    all.push(world.clone());
    world.happen(Happens::Pose);
    world.ticks(50);
    all.push(world.clone());
    world.pass(1200);
    world.ticks(40);
    all.push(world.clone());
    world.pass(1200);
    world.happen(Happens::Decouple);
    world.ticks(300);
    all.push(world);
    let phases: BTreeSet<String> = all
        .iter()
        .map(|w| format!("{:?}", w.bench.controller.phase()))
        .collect();
    assert_eq!(phases.len(), 12, "{phases:?}");
    all
}

/// Every sequence of so many events from `world`; returns how many were carried out.
fn explore(world: &World, depth: u32, keys: &mut BTreeSet<String>) -> u64 {
    if keys.insert(world.key()) {
        world.frees_itself();
    }
    if depth == 0 {
        return 0;
    }
    let mut count = 0;
    for what in ALL {
        let mut next = world.clone();
        next.happen(what);
        count += 1 + explore(&next, depth - 1, keys);
    }
    count
}

// Fails if any sequence of two events, from a state in every phase, breaks one
// of the four properties, or fewer sequences were tried than there are.
#[test]
fn every_sequence_of_events_is_safe() {
    let depth = std::env::var("SPHERECAL_DEPTH")
        .ok()
        .and_then(|d| d.parse().ok())
        .unwrap_or(2);
    let mut keys = BTreeSet::new();
    let count: u64 = beginnings().iter().map(|world| explore(world, depth, &mut keys)).sum();
    std::println!(
        "{count} events to depth {depth} from 12 phases, {} kinds of state",
        keys.len()
    );
    let events = ALL.len() as u64;
    let each: u64 = (1..=depth).map(|d| events.pow(d)).sum();
    assert_eq!(count, 12 * each);
    assert!(keys.len() >= 20, "{keys:?}");
}

// Fails if a kind of state that is reached by any number of events breaks one of
// the four properties: each kind is left by every event once, until there are no
// new ones.
#[test]
fn every_kind_of_state_is_safe() {
    let mut keys = BTreeSet::new();
    let mut open = beginnings();
    let mut events = 0;
    while let Some(world) = open.pop() {
        if !keys.insert(world.key()) {
            continue;
        }
        world.frees_itself();
        for what in ALL {
            let mut next = world.clone();
            next.happen(what);
            events += 1;
            if !keys.contains(&next.key()) {
                open.push(next);
            }
        }
    }
    std::println!("{} kinds of state, {events} events between them", keys.len());
    assert!(keys.len() >= 30, "{keys:?}");
}
