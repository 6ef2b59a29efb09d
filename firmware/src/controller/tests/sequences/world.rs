//! The world of the sequences: applies inputs and checks the properties.

use std::format;
use std::string::String;
use std::vec::Vec;

use nalgebra::Vector3;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveState, DriveStatus};
use spherecal_shared::protocol::host::{Command, Event, ImpedanceCommand, Phase};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use crate::phases::Activity;
use crate::testing::{Bench, HOME};

/// An input of the controller.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Input {
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
    Spring,
    Configure,
}

pub(super) const INPUTS: [Input; 22] = [
    Input::Short,
    Input::Long,
    Input::Repeated,
    Input::NotANumber,
    Input::Gap,
    Input::Jump,
    Input::Stopped,
    Input::Missed,
    Input::Silent,
    Input::Push,
    Input::Leaves,
    Input::Move,
    Input::Approach,
    Input::Pose,
    Input::Decouple,
    Input::Retreat,
    Input::Stop,
    Input::Clear,
    Input::Guide,
    Input::Unguide,
    Input::Spring,
    Input::Configure,
];

/// Most commands without a new state: bridged ones, and those until the brakes close.
const BLIND: u32 = 3 + 20;
/// Speed of the nest below which it is still, in m/s.
const STILL_M_S: f64 = 0.01;

fn procedure() -> Procedure {
    let mut procedure = Bench::fast_procedure();
    procedure.approach.tare_s = 0.05;
    procedure.couple.hold_s = 0.05;
    procedure.seating.test_s = 0.2;
    procedure.record.samples = 30;
    procedure.limits.host_silence_s = 0.05;
    procedure
}

/// Controller and simple arm, with the values that the properties need.
#[derive(Clone)]
pub(super) struct World {
    pub(super) bench: Bench,
    /// Position of the sphere, F0, in m.
    sphere: Vector3<f64>,
    /// Commands since the last usable state.
    blind: u32,
    seen: usize,
    /// Tick since which the nest has been seated and still.
    quiet_since: u64,
    last: Vector3<f64>,
    cleared: bool,
    step: f64,
    /// The inputs so far, for messages.
    path: Vec<Input>,
}

impl World {
    pub(super) fn new() -> Self {
        let bench = Bench::new(procedure());
        let sphere = bench.tcp() - Vector3::z() * 0.015;
        let mut world = Self {
            sphere,
            blind: 0,
            seen: bench.events.len(),
            quiet_since: 0,
            last: bench.tcp(),
            cleared: false,
            step: procedure().law.torque_rate_nm_s * 1e-3,
            path: Vec::new(),
            bench,
        };
        world.bench.sphere = Some(sphere);
        world
    }

    /// One tick, with a good state or one changed by `spoil`; checks properties 1 to 3.
    pub(super) fn tick(&mut self, spoil: Option<&dyn Fn(&mut DriveState)>) {
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
        // The pull at the end of a recording moves the nest but must not remove it.
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

    pub(super) fn ticks(&mut self, count: u32) {
        for _ in 0..count {
            self.tick(None);
        }
    }

    /// Runs until the phase changes, for at most `most` ticks.
    pub(super) fn pass(&mut self, most: u32) {
        let phase = self.bench.controller.phase();
        for _ in 0..most {
            self.tick(None);
            if self.bench.controller.phase() != phase {
                return;
            }
        }
    }

    pub(super) fn queue_command(&mut self, command: Command) {
        // A refusal is a valid answer.
        let _ = self.bench.controller.command(command);
        self.tick(None);
    }

    pub(super) fn apply(&mut self, input: Input) {
        self.path.push(input);
        match input {
            Input::Short => self.ticks(25),
            Input::Long => self.pass(1200),
            Input::Repeated => {
                for _ in 0..5 {
                    self.tick(Some(&|state| state.tick = 0));
                }
            }
            Input::NotANumber => {
                for _ in 0..30 {
                    self.tick(Some(&|state| state.q[3] = f64::NAN));
                }
            }
            Input::Gap => {
                self.bench.tick += 10;
                self.tick(None);
            }
            Input::Jump => {
                for _ in 0..5 {
                    self.tick(Some(&|state| state.q[1] += 1.0));
                }
            }
            Input::Stopped => {
                self.bench.status = DriveStatus::EmergencyStop;
                self.ticks(30);
                self.bench.status = DriveStatus::Ready;
            }
            Input::Missed => {
                self.bench.controller.record_missed(5);
                self.bench.controller.record_missed(0);
                self.tick(None);
            }
            Input::Silent => {
                self.bench.host = false;
                self.ticks(60);
                self.bench.host = true;
            }
            Input::Push => {
                self.bench.push = Vector3::new(120.0, 0.0, 30.0);
                self.ticks(40);
                self.bench.push = Vector3::zeros();
            }
            Input::Leaves => {
                self.bench.sphere = None;
                self.bench.caught = false;
                self.bench.push = Vector3::new(0.0, 0.0, 8.0);
                self.ticks(40);
                self.bench.push = Vector3::zeros();
                self.bench.sphere = Some(self.sphere);
            }
            Input::Move => {
                let mut target = HOME;
                target[0] = 0.1;
                let target = Joints::from_slice(&target).expect("seven of eight");
                self.queue_command(Command::Move { target });
            }
            Input::Approach => {
                let _ = self.bench.approach();
                self.tick(None);
            }
            Input::Pose => {
                let _ = self.bench.pose(0.1, true);
                self.tick(None);
            }
            Input::Decouple => self.queue_command(Command::Decouple),
            Input::Retreat => self.queue_command(Command::Retreat {
                direction: [0.0, 0.0, -1.0],
            }),
            Input::Stop => self.queue_command(Command::Stop),
            Input::Clear => {
                self.cleared = true;
                self.queue_command(Command::ClearFault);
            }
            Input::Guide => self.queue_command(Command::HandGuide { on: true }),
            Input::Unguide => self.queue_command(Command::HandGuide { on: false }),
            Input::Spring => self.queue_command(Command::Impedance(ImpedanceCommand {
                stiffness_n_m: [200.0; 3],
                rotation_nm_rad: 50.0,
                offset_m: [0.01, 0.0, 0.0],
                turn_rad: [0.0; 3],
            })),
            Input::Configure => {
                let tool = iiwa7_tool();
                let procedure = procedure();
                self.queue_command(Command::Configure { tool, procedure });
            }
        }
    }

    /// The part of the state that later inputs depend on.
    pub(super) fn key(&self) -> String {
        let c = &self.bench.controller;
        format!(
            "{:?} may be on sphere {} keep brakes {} blind {} on {} enabled {}",
            c.phase(),
            c.may_be_on_sphere,
            c.keep_brakes,
            c.blind_ticks > 0,
            self.bench.caught,
            self.bench.command.enable
        )
    }

    /// Checks property 4.
    pub(super) fn check_no_deadlock(&self) {
        let mut world = self.clone();
        for _ in 0..3 {
            world.apply(Input::Clear);
            world.apply(Input::Stop);
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
