//! The drive over the Franka Control Interface against the simulated robot side.

use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::{Duration, Instant};

use spherecal_cyclic::testing::World;
use spherecal_cyclic::{JointArm, Machine, this_machine};
use spherecal_fci::client::{ClientConfig, EndCause};
use spherecal_fci::robot::{ArmLimits, FR3_URDF, READY, RobotConfig, RobotSide, Tolerance, joint_arm, start_robot};
use spherecal_fci::wire::{ErrorFlag, Version};
use spherecal_link::Drive;
use spherecal_link::native::{DriveEvent, FrankaDrive, FrankaOptions, Undeclared, collision_behavior};
use spherecal_link::tcp::Threaded;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, DriveStatus, TorqueSign};
use spherecal_shared::robot::Inertia;

/// What no test waits longer for.
const PATIENCE: Duration = Duration::from_secs(30);

fn options(machine: &Arc<dyn Machine>, port: u16) -> FrankaOptions {
    FrankaOptions {
        config: ClientConfig {
            machine: Arc::clone(machine),
            port,
            connect_timeout: Duration::from_secs(1),
            state_timeout: Duration::from_millis(500),
            ..ClientConfig::new("127.0.0.1")
        },
        load: Inertia {
            mass_kg: 0.7,
            ..Inertia::default()
        },
        thresholds: collision_behavior(&Procedure::default()),
        undeclared: Undeclared {
            motor_kg_m2: [0.25; 7].into_iter().collect(),
            latency_us: 1500,
        },
    }
}

/// A drive under a control law that holds the arm where it was released.
struct Held {
    machine: Arc<dyn Machine>,
    drive: FrankaDrive,
    state: DriveState,
    at: Option<Vec<f64>>,
    events: Vec<DriveEvent>,
}

impl Held {
    fn new(machine: &Arc<dyn Machine>, port: u16) -> Self {
        let mut drive = FrankaDrive::connect(options(machine, port)).expect("a robot");
        let mut state = DriveState::default();
        drive.exchange(None, &mut state).expect("a state");
        Self {
            machine: Arc::clone(machine),
            drive,
            state,
            at: None,
            events: Vec::new(),
        }
    }

    fn command(&mut self) -> DriveCommand {
        let enable = self.state.status == DriveStatus::Ready;
        if !enable {
            self.at = None;
        }
        let at = self.at.get_or_insert_with(|| self.state.q.to_vec());
        let law = |j: usize| 60.0 * (at[j] - self.state.q[j]) - 6.0 * self.state.dq[j];
        let tau: Joints = (0..7).map(|j| if enable { law(j) } else { 0.0 }).collect();
        DriveCommand {
            session: 1,
            tick: self.state.tick,
            tau,
            enable,
            ..DriveCommand::default()
        }
    }

    fn step(&mut self) {
        let command = self.command();
        self.drive
            .exchange(Some(&command), &mut self.state)
            .expect("the link lives");
        let monitor = self.drive.monitor().expect("a monitor");
        while let Some(event) = monitor.next_event() {
            self.events.push(event);
        }
    }

    /// Steps until this is so.
    fn until(&mut self, what: &str, done: impl Fn(&Self) -> bool) {
        let begun = self.machine.now();
        while !done(self) {
            assert!(
                self.waited(begun) < PATIENCE,
                "{what}: {:?} {:?}",
                self.state,
                self.events
            );
            self.step();
        }
    }

    fn waited(&self, begun: Instant) -> Duration {
        self.machine.now().saturating_duration_since(begun)
    }

    fn moves(&self) -> bool {
        self.events.last() == Some(&DriveEvent::Started)
    }
}

/// A robot that does not wait, as a real one does not.
fn settings(machine: &Arc<dyn Machine>, version: Version) -> RobotConfig {
    RobotConfig {
        machine: Arc::clone(machine),
        tolerance: Tolerance::strict(),
        ..RobotConfig::for_tests(version)
    }
}

fn robot_with(config: RobotConfig) -> (RobotSide, Arc<Mutex<JointArm>>) {
    let arm = Arc::new(Mutex::new(joint_arm(READY)));
    let side = start_robot(config, Box::new(Arc::clone(&arm))).expect("a robot side");
    (side, arm)
}

fn robot(machine: &Arc<dyn Machine>, version: Version) -> (RobotSide, Arc<Mutex<JointArm>>) {
    robot_with(settings(machine, version))
}

// Fails if the hello hides that the robot compensates gravity, the load is not declared before the first motion, ticks
// are lost or repeated while the motion runs, or a torque exceeds the robot's rate (a reflex would end the motion).
#[test]
fn the_arm_is_held_and_every_period_has_its_tick() {
    let machine = World::new(1).machine();
    for version in [Version::V5, Version::V10] {
        let (side, _arm) = robot(&machine, version);
        let mut held = Held::new(&machine, side.address().port());
        let hello = held.drive.hello();
        assert!(hello.compensates_gravity && !hello.lock_step);
        assert_eq!((hello.torque_sign, hello.period_us), (TorqueSign::OfActuator, 1000));
        held.until("the motion", Held::moves);
        let (mut tick, start) = (held.state.tick, held.state.q.clone());
        for _ in 0..1000 {
            held.step();
            assert_eq!(held.state.tick, tick + 1 + u64::from(held.drive.missed()));
            tick = held.state.tick;
        }
        for (now, then) in held.state.q.iter().zip(&start) {
            assert!((now - then).abs() < 0.01, "{version}: {:?}", held.state);
        }
        assert_eq!(held.state.status, DriveStatus::Ready);
        let record = held.drive.monitor().expect("a monitor").record();
        assert!(record.cycles >= 900 && record.stops == 0, "{record:?}");
        drop(held);
        let seen = side.shut_down();
        assert!(
            (seen.load_kg - 0.7).abs() < 1e-9 && seen.commands_after_stop == 0,
            "{seen:?}"
        );
    }
}

// Fails if a collision does not become a fault with the robot's own name, a torque leaves after the stop, the recovery
// is not asked for, or the motion does not go on after it.
#[test]
fn a_reflex_is_a_named_fault_and_the_robot_recovers() {
    let machine = World::new(2).machine();
    let (side, arm) = robot(&machine, Version::V10);
    let mut held = Held::new(&machine, side.address().port());
    held.until("the motion", Held::moves);
    arm.lock().expect("an arm").external[4] = 200.0;
    held.until("the reflex", |h| h.state.status == DriveStatus::Failed);
    arm.lock().expect("an arm").external[4] = 0.0;
    let named = held.events.iter().any(|event| {
        matches!(event, DriveEvent::FrankaEnded(end)
            if end.cause == EndCause::Reflex && end.errors.contains(ErrorFlag::JointReflex))
    });
    assert!(named, "{:?}", held.events);
    held.until("the next motion", Held::moves);
    assert!(held.events.contains(&DriveEvent::Recovering));
    let record = held.drive.monitor().expect("a monitor").record();
    assert_eq!((record.stops, record.recoveries), (1, 1));
    assert_eq!(side.statistics().commands_after_stop, 0);
}

// Fails if the user stop is no emergency stop for the controller, a torque leaves while it is pressed, or the arm cannot
// be moved again once it is released.
#[test]
fn the_user_stop_is_an_emergency_stop() {
    let machine = World::new(3).machine();
    let (side, _arm) = robot(&machine, Version::V5);
    let mut held = Held::new(&machine, side.address().port());
    held.until("the motion", Held::moves);
    side.controls().user_stop.store(true, Ordering::Relaxed);
    held.until("the stop", |h| h.state.status == DriveStatus::EmergencyStop);
    for _ in 0..200 {
        held.step();
        assert_eq!(held.state.status, DriveStatus::EmergencyStop);
    }
    side.controls().user_stop.store(false, Ordering::Relaxed);
    held.until("the next motion", Held::moves);
    assert_eq!(side.statistics().commands_after_stop, 0);
}

// Fails if a restarted robot ends the drive for good, or the drive repeats an old state as a new one meanwhile.
#[test]
fn a_restarted_robot_is_found_again() {
    let machine = World::new(4).machine();
    let (side, _arm) = robot(&machine, Version::V10);
    let address = side.address();
    let mut held = Held::new(&machine, address.port());
    held.until("the motion", Held::moves);
    side.shut_down();
    let last = held.state.tick;
    held.until("the loss", |h| h.drive.version().is_none());
    assert!(
        held.state.tick <= last + 2,
        "no state came, so no tick may pass: {} {last}",
        held.state.tick
    );
    let config = RobotConfig {
        address,
        ..settings(&machine, Version::V10)
    };
    let side = start_robot(config, Box::new(joint_arm(READY))).expect("the same port");
    held.until("the next motion", Held::moves);
    assert!(held.events.contains(&DriveEvent::Reconnected));
    assert!(held.state.tick > last);
    assert_eq!(side.statistics().commands_after_stop, 0);
}

// Fails if the loop of the real-time thread allocates memory. On real sockets: a simulated network allocates.
#[test]
fn the_loop_allocates_nothing() {
    let machine = this_machine();
    let (side, _arm) = robot_with(RobotConfig::for_tests(Version::V10));
    let mut held = Held::new(&machine, side.address().port());
    held.until("the motion", Held::moves);
    let at = held.state.q.clone();
    let allocated = allocation_counter::measure(|| {
        for _ in 0..500 {
            let mut tau = Joints::new();
            for j in 0..7 {
                let law = 60.0 * (at[j] - held.state.q[j]) - 6.0 * held.state.dq[j];
                let _ = tau.push(law);
            }
            let command = DriveCommand {
                session: 1,
                tick: held.state.tick,
                tau,
                enable: true,
                ..DriveCommand::default()
            };
            held.drive
                .exchange(Some(&command), &mut held.state)
                .expect("the link lives");
        }
    });
    assert_eq!(held.state.status, DriveStatus::Ready);
    assert_eq!(allocated.count_total, 0, "allocations in 500 cycles");
}

// Fails if a torque waits for the next exchange, is sent twice, or is lost.
#[test]
fn a_torque_leaves_as_soon_as_it_is_computed() {
    let machine = World::new(6).machine();
    let (side, _arm) = robot(&machine, Version::V10);
    let mut held = Held::new(&machine, side.address().port());
    held.until("the motion", Held::moves);
    let monitor = held.drive.monitor().expect("a monitor");
    for _ in 0..300 {
        let command = held.command();
        assert!(command.enable, "{:?}", held.events);
        let before = side.statistics().commands;
        held.drive.answer(&command).expect("the link lives");
        // Nobody asks for the next state yet.
        machine.sleep(Duration::from_millis(1));
        assert_eq!(side.statistics().commands, before + 1);
        held.drive
            .exchange(Some(&command), &mut held.state)
            .expect("the link lives");
    }
    drop(held);
    let (sent, seen) = (monitor.record().cycles, side.shut_down());
    assert_eq!(seen.commands + seen.late, sent, "{seen:?}");
}

// Fails if the robot's own model does not limit the joints, a model without limits is taken for one, or its robot cannot
// be used.
#[test]
fn the_robots_own_model_states_the_limits() {
    let machine = World::new(7).machine();
    let start = |model: &str| {
        let config = RobotConfig {
            model: Some(model.to_owned()),
            ..settings(&machine, Version::V10)
        };
        let side = start_robot(config, Box::new(joint_arm(READY))).expect("a robot side");
        let drive = FrankaDrive::connect(options(&machine, side.address().port())).expect("a robot");
        let event = drive.monitor().expect("a monitor").next_event();
        (drive.hello().limits.clone(), event)
    };
    let (table, event) = start(FR3_URDF);
    assert_eq!(
        (table[0].min_rad, table[6].velocity_rad_s, event),
        (-2.7437, 5.26, None)
    );
    let (narrow, event) = start(&FR3_URDF.replacen("-2.7437", "-2.5", 1));
    assert_eq!((narrow[0].min_rad, event), (-2.5, None));
    let (limits, event) = start("<robot/>");
    assert_eq!(limits, table);
    let words = event.expect("an event").to_string();
    assert!(
        words.contains("0 revolute joints") && words.contains("data sheet"),
        "{words}"
    );
}

// Fails if a free motion with the procedure's speed and acceleration, which ends 2 degrees before the margin of a stop as
// the tightest plans do, would be faster than the FR3 permits there: its limit falls near the stops.
#[test]
fn planned_motions_are_slower_than_the_fr3_permits_near_its_stops() {
    let (procedure, limits) = (Procedure::default(), &ArmLimits::FR3);
    let (speed, acceleration) = (procedure.motion.speed_rad_s, procedure.motion.acceleration_rad_s2);
    let room = 2_f64.to_radians() + procedure.limits.position_margin_rad;
    let mut most = 0.0_f64;
    for joint in 0..7 {
        let range = limits.upper[joint] - limits.lower[joint] - 2.0 * room;
        for part in 1..=100 {
            let distance = range * f64::from(part) / 100.0;
            // The controller's profile: a quintic from rest to rest.
            let duration = (1.875 * distance / speed).max((5.773_502_7 * distance / acceleration).sqrt());
            for k in 1..200 {
                let x = f64::from(k) / 200.0;
                let way = distance * x.powi(3) * (10.0 + x * (-15.0 + 6.0 * x));
                let velocity = distance / duration * 30.0 * (x * (1.0 - x)).powi(2);
                let left = distance - way + room;
                let (_, upper) = limits.velocity_at(joint, limits.upper[joint] - left);
                let (lower, _) = limits.velocity_at(joint, limits.lower[joint] + left);
                most = most.max(velocity / upper.min(-lower));
            }
        }
    }
    assert!(most < 0.9, "{most} of what the robot permits");
    assert!(most > 0.5, "the test sees no limit: {most}");
}

// Fails if a reflex that the robot cannot clear by itself is not told within seconds, or the drive goes on asking.
#[test]
fn a_joint_beyond_its_limit_needs_a_person() {
    let machine = World::new(9).machine();
    let (side, _arm) = robot(&machine, Version::V5);
    let mut held = Held::new(&machine, side.address().port());
    held.until("the motion", Held::moves);
    let begun = machine.now();
    while held.state.status != DriveStatus::Failed {
        assert!(held.waited(begun) < PATIENCE, "{:?} {:?}", held.state, held.events);
        // Joint 4 of the Panda turns to its upper stop, with 1 rad/s.
        if let Some(at) = &mut held.at {
            at[3] += 1e-3;
        }
        held.step();
    }
    let needed = |held: &Held| {
        let last = held.events.last();
        matches!(last, Some(DriveEvent::PersonNeeded(errors))
            if errors.contains(ErrorFlag::JointPositionLimitsViolation))
    };
    held.until("a person", needed);
    let tick = held.state.tick;
    held.until("some time", |held| held.state.tick > tick + 3000);
    assert!(needed(&held), "{:?}", held.events);
    assert_eq!(held.state.status, DriveStatus::Failed);
    assert_eq!(held.drive.monitor().expect("a monitor").record().recoveries, 1);
    assert_eq!(side.statistics().commands_after_stop, 0);
}

// Fails if a controller's thread goes on after a run that ended before it had anything to say, as one does whose poses
// cannot be planned: the program would never end.
#[test]
fn a_controller_that_was_told_nothing_ends_with_its_run() {
    let machine = this_machine();
    let (side, _arm) = robot_with(RobotConfig::for_tests(Version::V10));
    let port = side.address().port();
    let (done, ended) = std::sync::mpsc::channel();
    std::thread::spawn(move || {
        let drive = FrankaDrive::connect(options(&machine, port)).expect("a robot");
        drop(Threaded::start(Box::new(drive), 7).expect("a controller"));
        done.send(()).expect("somebody waits");
    });
    ended
        .recv_timeout(Duration::from_secs(20))
        .expect("the controller's thread ends");
}
