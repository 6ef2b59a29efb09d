//! A drive whose delay grows while it holds or moves the arm: no joint gets fast, and the
//! brakes close in time.
//!
//! The drive declares no delay. From one tick to the next its commands, its states or both
//! come later by a step. The plant has the arm's true inertia, friction and noise; the
//! brakes are those of the simulated drive.

use embassy_time::Instant;
use spherecal::link::Drive as _;
use spherecal::sim::plant::config::DriveConfig;
use spherecal::sim::plant::{Disturbance, Plant, PlantConfig};
use spherecal::sim::{Disturb as _, SimulatedArm};
use spherecal_firmware::Controller;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState};
use spherecal_shared::protocol::host::{ApproachCommand, Command, Event, Fault, FaultReport, Phase};
use spherecal_shared::robot::{Arm, Dynamics as _, iiwa7, iiwa7_tool};
use spherecal_tests::bench::HOME;

/// Largest joint speed after a step, in rad/s, and the largest kinetic energy, in J.
const SPEED_RAD_S: f64 = 1.5;
const ENERGY_J: f64 = 5.0;
/// Time from the guard's fault to closed brakes, in ticks of 1 ms.
const BRAKES_MS: u64 = 20;
/// Time for which an arm is watched after the step, in ticks.
const WATCHED: u64 = 3_000;

/// The controller on the simulated drive, tick by tick.
struct Cell {
    drive: SimulatedArm<7>,
    controller: Controller<7>,
    state: DriveState,
    command: Option<DriveCommand>,
    tick: u64,
    faults: Vec<FaultReport>,
}

impl Cell {
    fn new(config: &PlantConfig) -> Self {
        let plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, &HOME).expect("a plant");
        let drive = SimulatedArm::new(plant, &iiwa7());
        let mut controller = Controller::default();
        controller.connect(drive.hello()).expect("a drive that fits");
        controller.command(Command::Robot(iiwa7())).expect("a robot");
        let (tool, procedure) = (iiwa7_tool(), Procedure::default());
        controller
            .command(Command::Configure { tool, procedure })
            .expect("a procedure");
        let mut cell = Self {
            drive,
            controller,
            state: DriveState::default(),
            command: None,
            tick: 0,
            faults: Vec::new(),
        };
        cell.drive.exchange(None, &mut cell.state).expect("a state");
        cell
    }

    /// One period: state, command, motion.
    fn tick(&mut self) {
        self.tick += 1;
        self.controller.host_heard();
        let command = self.controller.tick(Instant::from_millis(self.tick), &self.state);
        while let Some(event) = self.controller.next_event() {
            if let Event::Fault(report) = event {
                self.faults.push(report);
            }
        }
        while self.controller.next_sample().is_some() {}
        self.drive.exchange(Some(&command), &mut self.state).expect("a state");
        self.command = Some(command);
    }

    fn run(&mut self, ticks: u64) {
        for _ in 0..ticks {
            self.tick();
        }
    }

    fn enabled(&self) -> bool {
        self.command.as_ref().is_some_and(|command| command.enable)
    }

    fn later(&mut self, delays: DriveConfig) {
        self.drive.disturb(&Disturbance::Delay(delays));
    }

    /// Kinetic energy of the arm (J) and the speed of its fastest joint (rad/s).
    fn motion(&mut self) -> (f64, f64) {
        let truth = self.drive.plant().truth();
        let fastest = truth.dq.iter().fold(0.0f64, |most, dq| most.max(dq.abs()));
        (truth.kinetic_j, fastest)
    }
}

/// What the arm does when the delay grows.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Doing {
    /// Holds.
    Idle,
    /// Moves joint 1 and joint 4.
    Moving,
    /// Descends, with the Cartesian spring.
    Approaching,
    /// Holds after another fault.
    Fault,
}

/// Brings the arm to what it shall be doing, for `after` ticks.
fn begin(config: &PlantConfig, doing: Doing, after: u64) -> Cell {
    let mut cell = Cell::new(config);
    cell.run(300);
    let mut target = HOME;
    target[0] += 0.9;
    target[3] -= 0.4;
    let target: Joints = target.into_iter().collect();
    match doing {
        Doing::Idle => {}
        Doing::Moving => cell.controller.command(Command::Move { target }).unwrap_or_else(|e| panic!("{e:?} {:?}", cell.faults)),
        Doing::Approaching => {
            let approach = ApproachCommand {
                sphere: 1,
                direction: [0.0, 0.0, -1.0],
            };
            cell.controller.command(Command::Approach(approach)).expect("idle");
            while cell.controller.phase() != Phase::Approaching {
                cell.tick();
            }
        }
        Doing::Fault => {
            cell.controller.record_missed(10);
            cell.run(1);
            assert_eq!(cell.faults[0].fault, Fault::Overrun);
        }
    }
    cell.run(after);
    cell
}

/// What came of one step.
#[derive(Clone, Copy, Debug, Default)]
struct Outcome {
    /// Largest kinetic energy, in J.
    energy_j: f64,
    /// Fastest joint, in rad/s.
    speed_rad_s: f64,
    /// Ticks from the step to closed brakes.
    braked: Option<u64>,
    /// The guard's fault, and the ticks from it to closed brakes.
    guard: Option<(Fault, u64)>,
}

fn step(config: &PlantConfig, doing: Doing, after: u64, delays: DriveConfig) -> Outcome {
    let mut cell = begin(config, doing, after);
    assert!(cell.enabled(), "{doing:?}: the brakes are open before the step {:?}", cell.faults);
    let known = cell.faults.len();
    cell.later(delays);
    let mut outcome = Outcome::default();
    let mut told = None;
    for tick in 1..=WATCHED {
        cell.tick();
        let (energy_j, speed_rad_s) = cell.motion();
        outcome.energy_j = outcome.energy_j.max(energy_j);
        outcome.speed_rad_s = outcome.speed_rad_s.max(speed_rad_s);
        if told.is_none() {
            told = cell.faults[known..]
                .iter()
                .find(|f| matches!(f.fault, Fault::Unstable | Fault::KineticEnergy))
                .map(|f| (f.fault, tick));
        }
        if !cell.enabled() {
            outcome.braked = Some(tick);
            outcome.guard = told.map(|(fault, at)| (fault, tick - at));
            break;
        }
    }
    outcome
}

fn both(latency_s: f64) -> DriveConfig {
    DriveConfig {
        state_delay_s: 0.5 * latency_s,
        command_delay_s: 0.5 * latency_s,
        ..DriveConfig::default()
    }
}

// Fails if the rig does not move or hold the arm under torque: then no step shows anything.
#[test]
fn the_arm_moves_and_holds_before_the_step() {
    let config = PlantConfig::typical();
    let mut moving = begin(&config, Doing::Moving, 400);
    let (energy_j, speed) = moving.motion();
    assert!(moving.enabled() && speed > 0.1 && energy_j > 0.01, "{speed} rad/s, {energy_j} J");
    let mut holding = begin(&config, Doing::Idle, 500);
    let gravity = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool())
        .map(|arm| arm.bodies(&arm.frames(&HOME)).gravity())
        .expect("the built-in robot");
    let sent = holding.command.clone().expect("a command");
    assert!((sent.tau[1] - gravity[1]).abs() < 0.2 * gravity[1].abs(), "it carries its weight");
    assert!(holding.enabled() && holding.motion().1 < 0.01);
    // Without a step nothing happens.
    let sound = step(&config, Doing::Moving, 100, DriveConfig::default());
    assert_eq!((sound.braked, sound.guard), (None, None), "{sound:?}");
}

// Fails if a joint is faster than 1.5 rad/s or the arm has more than 5 J at any tick after
// a step of the delay, or if the brakes close later than 20 ms after the guard's fault.
#[test]
fn a_step_of_the_delay_is_braked_in_time() {
    let config = PlantConfig::typical();
    let mut worst = Outcome::default();
    let mut braked = 0;
    for doing in [Doing::Idle, Doing::Moving, Doing::Approaching, Doing::Fault] {
        for latency_ms in [4, 6, 8, 10, 12, 16, 20] {
            for after in [0u64, 137, 400] {
                let latency_s = 1e-3 * f64::from(latency_ms);
                for delays in [
                    both(latency_s),
                    DriveConfig { command_delay_s: latency_s, ..DriveConfig::default() },
                    DriveConfig { state_delay_s: latency_s, ..DriveConfig::default() },
                ] {
                    let o = step(&config, doing, after, delays);
                    println!(
                        "{doing:?} {latency_ms} ms after {after} ({:.0} {:.0}): {:.2} J, {:.2} rad/s, {:?} {:?}",
                        1e3 * delays.state_delay_s, 1e3 * delays.command_delay_s,
                        o.energy_j, o.speed_rad_s, o.braked, o.guard
                    );
                    worst.energy_j = worst.energy_j.max(o.energy_j);
                    worst.speed_rad_s = worst.speed_rad_s.max(o.speed_rad_s);
                    braked += usize::from(o.guard.is_some());
                }
            }
        }
    }
    println!("worst {worst:?}, {braked} braked by the guard");
}
