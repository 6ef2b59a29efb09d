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
use spherecal_shared::protocol::host::{ApproachCommand, Command, Event, Fault, FaultReport, Phase, PoseCommand};
use spherecal_shared::robot::{Arm, Dynamics as _, iiwa7, iiwa7_tool};
use spherecal_tests::plan::short_plan;

/// Largest joint speed of an arm at rest after a step, in rad/s, that of a moving one by the commanded one, and the largest
/// kinetic energy, in J.
const SPEED_RAD_S: f64 = 1.5;
const BEYOND: f64 = 1.1;
const ENERGY_J: f64 = 5.0;
/// Longest delay, in ms, for which the speeds are bounded; and that of a turn, which needs a stiff spring
/// about the tool's axis.
const BOUNDED_MS: u32 = 12;
const TURN_BOUNDED_MS: u32 = 4;
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
    /// At rest at `q` (rad).
    fn new(config: &PlantConfig, q: &[f64; 7]) -> Self {
        let plant = Plant::new(&iiwa7(), &iiwa7_tool(), config, q).expect("a plant");
        let drive = SimulatedArm::new(plant, &iiwa7());
        let mut controller = Controller::default();
        controller.connect(drive.hello()).expect("a drive that fits");
        controller
            .command(Command::Robot(iiwa7().driven().expect("seven joints")))
            .expect("a robot");
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

    /// Kinetic energy of the arm (J), and the speed of its fastest joint (rad/s).
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
    /// Sits on the sphere.
    Coupled,
    /// Turns about the sphere.
    Turning,
    /// Holds after another fault.
    Fault,
}

/// Home, and the approach frame of a sphere with the direction of the approach.
fn places(config: &PlantConfig) -> ([f64; 7], [f64; 7], [f64; 3]) {
    let plan = short_plan(config, &[0], &[0.0]);
    let joints = |joints: &[f64]| joints.try_into().expect("seven joints");
    let visit = &plan.spheres[0];
    (
        joints(&plan.home.joints),
        joints(&visit.approach.joints),
        visit.approach_direction,
    )
}

/// A pose of the plan's first sphere, far from the approach.
fn turned(config: &PlantConfig) -> PoseCommand {
    let plan = short_plan(config, &[0], &[0.6]);
    let pose = &plan.spheres[0].poses[0];
    PoseCommand {
        pose: 1,
        orientation: pose.orientation,
        elbow_rad: pose.elbow_rad,
        posture: pose.joints.iter().copied().collect(),
        record: true,
    }
}

/// Brings the arm to what it shall be doing, for `after` ticks.
fn begin(config: &PlantConfig, doing: Doing, after: u64) -> Cell {
    let (home, frame, direction) = places(config);
    let touches = matches!(doing, Doing::Approaching | Doing::Coupled | Doing::Turning);
    let mut cell = Cell::new(config, if touches { &frame } else { &home });
    cell.run(300);
    match doing {
        Doing::Idle => {}
        Doing::Moving => {
            let mut target = home;
            target[0] += 0.9;
            let target: Joints = target.into_iter().collect();
            cell.controller.command(Command::Move { target }).expect("idle");
        }
        Doing::Approaching | Doing::Coupled | Doing::Turning => {
            let approach = ApproachCommand { sphere: 1, direction };
            cell.controller.command(Command::Approach(approach)).expect("idle");
            let phase = if doing == Doing::Approaching {
                Phase::Approaching
            } else {
                Phase::Coupled
            };
            for _ in 0..20_000 {
                if cell.controller.phase() == phase {
                    break;
                }
                cell.tick();
            }
            assert_eq!(cell.controller.phase(), phase);
            if doing == Doing::Turning {
                let pose = Command::Pose(turned(config));
                cell.controller.command(pose).expect("coupled");
                cell.run(300);
                assert_eq!(cell.controller.phase(), Phase::Turning);
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
    /// Speed of the fastest joint, in rad/s.
    speed_rad_s: f64,
    /// Ticks from the step to closed brakes.
    braked: Option<u64>,
    /// The guard's fault, and the ticks from it to closed brakes.
    guard: Option<(Fault, u64)>,
}

fn step(config: &PlantConfig, doing: Doing, after: u64, delays: DriveConfig) -> Outcome {
    let mut cell = begin(config, doing, after);
    assert!(
        cell.enabled(),
        "{doing:?}: the brakes are open before the step {:?}",
        cell.faults
    );
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

// Fails if the rig does not move or hold the arm under torque: then no step shows anything.
#[test]
fn the_arm_moves_and_holds_before_the_step() {
    let config = PlantConfig::typical();
    let mut moving = begin(&config, Doing::Moving, 400);
    let (energy_j, speed) = moving.motion();
    assert!(
        moving.enabled() && speed > 0.1 && energy_j > 0.01,
        "{speed} rad/s, {energy_j} J"
    );
    let mut holding = begin(&config, Doing::Idle, 500);
    let gravity = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool())
        .map(|arm| arm.bodies(&arm.frames(&places(&config).0)).gravity())
        .expect("the built-in robot");
    let sent = holding.command.clone().expect("a command");
    assert!(
        (sent.tau[1] - gravity[1]).abs() < 0.2 * gravity[1].abs(),
        "it carries its weight"
    );
    assert!(holding.enabled() && holding.motion().1 < 0.01);
    // Without a step nothing happens.
    let sound = step(&config, Doing::Moving, 100, DriveConfig::default());
    assert_eq!((sound.braked, sound.guard), (None, None), "{sound:?}");
}

// Fails if the arm has more than 5 J at any tick after a step of the delay, if the brakes
// close later than 20 ms after the guard's fault, or if a joint is faster than 1.5 rad/s
// after a step to 12 ms or less (4 ms in a turn), in a motion or turn than 1.1 times the commanded speed. Fails also if no
// step is one that the law cannot hold.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_step_of_the_delay_is_braked_in_time() {
    let config = PlantConfig::typical();
    let doings = [
        Doing::Idle,
        Doing::Moving,
        Doing::Approaching,
        Doing::Coupled,
        Doing::Turning,
        Doing::Fault,
    ];
    for doing in doings {
        let (mut worst, mut wild, mut braked) = (Outcome::default(), Outcome::default(), 0);
        let bounded_ms = if doing == Doing::Turning {
            TURN_BOUNDED_MS
        } else {
            BOUNDED_MS
        };
        let procedure = Procedure::default();
        let most_rad_s = match doing {
            Doing::Moving => BEYOND * procedure.motion.speed_rad_s,
            Doing::Turning => BEYOND * procedure.turn.speed_rad_s,
            _ => SPEED_RAD_S,
        };
        for latency_ms in [4, 6, 8, 10, BOUNDED_MS, 16, 20] {
            let latency_s = 1e-3 * f64::from(latency_ms);
            let parts = [(0.5, 0.5), (0.0, 1.0), (1.0, 0.0)];
            for (after, (state, command)) in [0u64, 137, 400].into_iter().flat_map(|a| parts.map(|p| (a, p))) {
                let delays = DriveConfig {
                    state_delay_s: state * latency_s,
                    command_delay_s: command * latency_s,
                    ..DriveConfig::default()
                };
                let found = step(&config, doing, after, delays);
                let sum = if latency_ms <= bounded_ms {
                    &mut worst
                } else {
                    &mut wild
                };
                sum.energy_j = sum.energy_j.max(found.energy_j);
                sum.speed_rad_s = sum.speed_rad_s.max(found.speed_rad_s);
                let what = format!("{doing:?}, {latency_ms} ms ({state} in the states) after {after}: {found:?}");
                assert!(found.energy_j < ENERGY_J, "{what}");
                if latency_ms <= bounded_ms {
                    assert!(found.speed_rad_s < most_rad_s, "{what}");
                }
                if let Some((_, ticks)) = found.guard {
                    braked += 1;
                    assert!(ticks <= BRAKES_MS, "{what}");
                }
            }
        }
        println!("{doing:?}: to {bounded_ms} ms {worst:?}; beyond {wild:?}; {braked} braked by the guard");
        assert!(doing != Doing::Moving || braked > 10, "{braked} of 63");
    }
}
