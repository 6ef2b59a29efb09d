//! The drive over the interfaces of Universal Robots against the simulated robot side, on a virtual clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_cyclic::Machine as _;
use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_link::native::{DriveEvent, Undeclared, UrDrive, UrOptions};
use spherecal_link::{Drive, LinkError, LocalDevice, controller_in_process};
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, DriveStatus};
use spherecal_shared::robot::{Arm, Dynamics as _, Robot, built_in, iiwa7_tool};
use spherecal_ur::JOINTS;
use spherecal_ur::client::ClientConfig;
use spherecal_ur::robot::{ArmCommand, ArmHardware, ArmState, RobotConfig, RobotSide, start_robot};
use spherecal_ur::wire::{
    ControllerVersion, HTTP_FORBIDDEN, KinematicsInfo, RobotMode, RuntimeState, SafetyMode, Series,
};

/// Inertia of each joint, motor included, and of its motor, kg m².
const INERTIA: f64 = 0.5;
const MOTOR: f64 = 0.1;
const POSE: [f64; JOINTS] = [0.1, -1.2, 1.3, -1.4, -1.5, 0.6];

/// Six independent joints without friction.
struct Joints {
    q: [f64; JOINTS],
    qd: [f64; JOINTS],
    torque: [f64; JOINTS],
}

impl ArmHardware for Joints {
    fn state(&self) -> ArmState {
        ArmState {
            q: self.q,
            qd: self.qd,
            motor_torque: self.torque,
            ..ArmState::default()
        }
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        self.torque = match command {
            ArmCommand::Torque(torque) => torque,
            ArmCommand::Hold => {
                self.qd = [0.0; JOINTS];
                [0.0; JOINTS]
            }
            ArmCommand::Follow(q, qd) => {
                (self.q, self.qd, self.torque) = (q, qd, [0.0; JOINTS]);
                return self.state();
            }
        };
        for j in 0..JOINTS {
            self.qd[j] += self.torque[j] / INERTIA * step_s;
            self.q[j] += self.qd[j] * step_s;
        }
        self.state()
    }
}

fn ur5e() -> Robot {
    built_in("ur5e").expect("built in")
}

fn robot(world: &World, change: impl FnOnce(&mut RobotConfig)) -> RobotSide {
    let mut config = RobotConfig {
        machine: world.machine(),
        address: LOCAL,
        ..RobotConfig::new(Series::ESeries, KinematicsInfo::default())
    };
    change(&mut config);
    let arm = Joints {
        q: POSE,
        qd: [0.0; JOINTS],
        torque: [0.0; JOINTS],
    };
    start_robot(config, Box::new(arm)).expect("a robot")
}

fn connect(world: &World, side: &RobotSide) -> Result<UrDrive, LinkError> {
    let tool = iiwa7_tool();
    UrDrive::connect(UrOptions {
        config: ClientConfig {
            machine: world.machine(),
            port: side.address().port(),
            ..ClientConfig::new("127.0.0.1")
        },
        robot: ur5e(),
        load: tool.body,
        tool,
        undeclared: Undeclared {
            motor_kg_m2: [MOTOR; JOINTS].into_iter().collect(),
            latency_us: 0,
        },
    })
}

// Fails if the delay of the wire is not what the controller is told, or a delay that no gains are safe for is accepted.
#[test]
fn the_delay_of_the_wire_is_measured_before_anything_moves() {
    for (input_delay, latency_us) in [(0, 2000), (1, 4000), (2, 6000)] {
        let world = World::new(0);
        let side = robot(&world, |robot| robot.input_delay = input_delay);
        let drive = connect(&world, &side).expect("a drive");
        let hello = drive.hello();
        assert_eq!((hello.period_us, hello.latency_us), (2000, latency_us));
        assert!(hello.compensates_gravity && !hello.lock_step && hello.simulated);
        assert_eq!(side.statistics().followed, 0);
        let device = LocalDevice::new(controller_in_process(JOINTS).expect("one"), Box::new(drive), JOINTS);
        match device {
            Ok(_) => assert!(latency_us <= 5000),
            Err(error) => assert!(latency_us > 5000 && error.to_string().contains("6000 µs"), "{error}"),
        }
    }
}

// Fails if a robot that is stopped, switched off, busy, in local control or in use is taken, or the refusal does not say so in
// the robot's words.
#[test]
fn what_is_not_ready_is_refused_in_the_robots_words() {
    let refusal = |prepare: &dyn Fn(&RobotSide)| {
        let world = World::new(0);
        let side = robot(&world, |_| ());
        prepare(&side);
        connect(&world, &side).err().expect("refused").to_string()
    };
    let set = |control: &std::sync::atomic::AtomicI32, number: i32| control.store(number, Ordering::Relaxed);
    let said = refusal(&|side| set(&side.controls().safety_mode, SafetyMode::ProtectiveStop.number()));
    assert!(said.contains("PROTECTIVE_STOP"), "{said}");
    let said = refusal(&|side| set(&side.controls().robot_mode, RobotMode::PowerOff.number()));
    assert!(said.contains("POWER_OFF"), "{said}");
    let said = refusal(&|side| set(&side.controls().runtime_state, RuntimeState::Playing.number()));
    assert!(
        said.contains("a program runs on the robot (runtime_state is PLAYING)"),
        "{said}"
    );
    for polyscope_x in [false, true] {
        let world = World::new(0);
        let side = robot(&world, |robot| {
            if polyscope_x {
                robot.version = ControllerVersion::POLYSCOPE_X;
            }
        });
        side.controls().remote.store(false, Ordering::Relaxed);
        let said = connect(&world, &side).err().expect("refused").to_string();
        assert!(said.contains("remote control: false"), "{said}");
    }
    let world = World::new(0);
    let side = robot(&world, |_| ());
    let first = connect(&world, &side).expect("a drive");
    let said = connect(&world, &side).err().expect("refused").to_string();
    assert!(
        said.contains("another client of the robot writes the RTDE input"),
        "{said}"
    );
    drop(first);
    world.machine().sleep(Duration::from_secs(3));
    connect(&world, &side).expect("the program of the first has ended by itself");
}

// Fails if the torque on the links is not gravity and the motor's torque without what accelerates the motor, a torque does not
// act, one beyond the limit leaves, or an end of the program is not told and mended.
#[test]
fn torques_act_and_are_told_as_those_on_the_links() {
    let world = World::new(0);
    let limits: Vec<f64> = ur5e().joints.iter().map(|joint| joint.limits.torque_nm).collect();
    let side = robot(&world, |robot| {
        robot.limits = std::array::from_fn(|j| (10.0, limits[j]));
    });
    let mut drive = connect(&world, &side).expect("a drive");
    let (mut state, mut events) = (DriveState::default(), Vec::new());
    drive.exchange(None, &mut state).expect("a state");
    let arm = Arm::<f64, JOINTS>::new(&ur5e(), &iiwa7_tool()).expect("an arm");
    let gravity = |q: &[f64]| -> [f64; JOINTS] {
        let q: [f64; JOINTS] = q.try_into().expect("six");
        arm.bodies(&arm.frames(&q)).gravity().into()
    };
    assert!((state.tau[1] - gravity(&state.q)[1]).abs() < 1e-9 && state.tau[1].abs() > 10.0);
    let mut run = |state: &mut DriveState, tau: f64, periods: usize| {
        for _ in 0..periods {
            let command = DriveCommand {
                session: 1,
                tick: state.tick,
                tau: [0.0, 0.0, 0.0, 0.0, 0.0, tau].into_iter().collect(),
                enable: state.status == DriveStatus::Ready,
                ..DriveCommand::default()
            };
            drive.exchange(Some(&command), state).expect("the link lives");
            while let Some(event) = drive.monitor().and_then(|monitor| monitor.next_event()) {
                events.push(event);
            }
        }
    };
    run(&mut state, 0.2, 50);
    // Of 0.2 N m a fifth accelerates the motor.
    assert!(
        (state.tau[5] - gravity(&state.q)[5] - 0.2 * (1.0 - MOTOR / INERTIA)).abs() < 1e-6,
        "{state:?}"
    );
    assert!(state.dq[5] > 0.03 && state.q[5] > POSE[5], "{state:?}");
    let tick = state.tick;
    run(&mut state, 0.0, 10);
    assert_eq!(state.tick, tick + 10);
    run(&mut state, 1000.0, 3);
    run(&mut state, -20.0, 3);
    run(&mut state, 0.0, 5);
    assert_eq!(side.statistics().limits, 0, "a torque beyond its limit has left");
    side.controls().stop_program.store(true, Ordering::Relaxed);
    run(&mut state, 0.0, 5);
    assert_eq!(state.status, DriveStatus::Disabled);
    run(&mut state, 0.0, 700);
    assert_eq!((state.status, side.statistics().programs), (DriveStatus::Ready, 2));
    let ends = events
        .iter()
        .filter(|event| matches!(event, DriveEvent::UrEnded(_)))
        .count();
    let starts = events.iter().filter(|event| **event == DriveEvent::Started).count();
    assert_eq!((ends, starts), (1, 2), "{events:?}");
    assert_eq!(side.statistics().after_stop, 0);
}

// Fails if angles do not act, later than the wire and the look-ahead of `servoj`, if a command without angles does not hand the arm
// back to torques where it is, or if angles that stay away do not end the program.
#[test]
fn angles_are_followed_by_the_robots_own_control() {
    let world = World::new(0);
    let side = robot(&world, |_| ());
    let mut drive = connect(&world, &side).expect("a drive");
    assert!(drive.hello().follows);
    let mut state = DriveState::default();
    drive.exchange(None, &mut state).expect("a state");
    let mut run = |angle: Option<f64>, periods: usize| {
        for _ in 0..periods {
            let command = DriveCommand {
                session: 1,
                tick: state.tick,
                tau: [0.0; JOINTS].into_iter().collect(),
                follow: angle.map_or_else(spherecal_shared::Joints::new, |angle| {
                    let mut q = POSE;
                    q[5] = angle;
                    q.into_iter().collect()
                }),
                enable: state.status == DriveStatus::Ready,
            };
            drive.exchange(Some(&command), &mut state).expect("the link lives");
        }
        (state.q[5], state.dq[5])
    };
    let way = |k: usize| POSE[5] + 1e-3 * k as f64;
    for k in 0..200 {
        run(Some(way(k)), 1);
    }
    // At 0.5 rad/s: 30 ms of look-ahead and three periods are 18 mrad.
    let (q, dq) = run(Some(way(200)), 1);
    assert!(
        (way(200) - q - 0.018).abs() < 3e-3 && (dq - 0.5).abs() < 1e-2,
        "{q} {dq}"
    );
    let (q, dq) = run(Some(way(200)), 200);
    assert!((way(200) - q).abs() < 1e-6 && dq.abs() < 1e-6, "{q} {dq}");
    let held = run(None, 50);
    assert!((held.0 - q).abs() < 1e-9, "{held:?}");
    assert!(side.statistics().followed > 40 && side.statistics().runs);
    run(Some(way(200)), 20);
    drop(drive);
    world.machine().sleep(Duration::from_millis(60));
    assert!(!side.statistics().runs, "24 ms without a number end it");
}

// Fails if a PolyScope X in local control that refuses to end its protective stop is asked more than three times, the refusal is
// not told with what a person has to do, the connection is lost by it, or a person who ends the stop is not enough.
#[test]
fn a_robot_api_that_refuses_leaves_the_stop_to_a_person() {
    let world = World::new(0);
    let side = robot(&world, |robot| robot.version = ControllerVersion::POLYSCOPE_X);
    let mut drive = connect(&world, &side).expect("a drive");
    let mut state = DriveState::default();
    drive.exchange(None, &mut state).expect("a state");
    let mut run = |periods: usize| {
        for _ in 0..periods {
            let command = DriveCommand {
                session: 1,
                tick: state.tick,
                tau: [0.0; JOINTS].into_iter().collect(),
                enable: state.status == DriveStatus::Ready,
                ..DriveCommand::default()
            };
            drive.exchange(Some(&command), &mut state).expect("the link lives");
        }
        let events: Vec<_> = std::iter::from_fn(|| drive.monitor()?.next_event()).collect();
        (state.status, events)
    };
    run(100);
    let controls = side.controls();
    controls.remote.store(false, Ordering::Relaxed);
    let stop = SafetyMode::ProtectiveStop.number();
    controls.safety_mode.store(stop, Ordering::Relaxed);
    let (status, events) = run(15_000);
    assert_eq!(status, DriveStatus::Failed);
    let count = |wanted: DriveEvent| events.iter().filter(|event| **event == wanted).count();
    let refused = DriveEvent::UrUnlockRefused(HTTP_FORBIDDEN);
    assert_eq!((count(DriveEvent::UrUnlocking), count(refused)), (3, 3), "{events:?}");
    assert!(refused.to_string().contains("remote control"), "{refused}");
    assert!(
        matches!(events.last(), Some(DriveEvent::UrPersonNeeded(_))),
        "{events:?}"
    );
    controls.remote.store(true, Ordering::Relaxed);
    controls
        .safety_mode
        .store(SafetyMode::Normal.number(), Ordering::Relaxed);
    let (status, events) = run(1000);
    assert_eq!(
        (status, events.last()),
        (DriveStatus::Ready, Some(&DriveEvent::Started))
    );
}

// Fails if a cable that is out for 1.2 s counts as more or fewer periods than have passed, is not told, or ends the link.
#[test]
fn a_cable_that_is_out_costs_as_many_periods_as_it_lasts() {
    let world = World::new(0);
    let side = robot(&world, |_| ());
    let mut drive = connect(&world, &side).expect("a drive");
    let mut state = DriveState::default();
    drive.exchange(None, &mut state).expect("a state");
    let step = |drive: &mut UrDrive, state: &mut DriveState| {
        let command = DriveCommand {
            session: 1,
            tick: state.tick,
            tau: [0.0; JOINTS].into_iter().collect(),
            enable: state.status == DriveStatus::Ready,
            ..DriveCommand::default()
        };
        drive.exchange(Some(&command), state).expect("the link lives");
        1 + u64::from(drive.missed())
    };
    for _ in 0..100 {
        step(&mut drive, &mut state);
    }
    let (begun, tick) = (world.now(), state.tick);
    world.faults().cable_out.store(true, Ordering::Relaxed);
    let back = world.clone();
    world.after(Duration::from_millis(1200), move || {
        back.faults().cable_out.store(false, Ordering::Relaxed);
    });
    let mut counted = 0;
    while state.tick < tick + 700 {
        counted += step(&mut drive, &mut state);
    }
    let passed = (world.now() - begun).as_micros() as f64 / 2000.0;
    assert!(
        (counted as f64 - passed).abs() < 4.0,
        "{counted} periods are counted, {passed} have passed"
    );
    assert_eq!(state.tick - tick, counted);
    let events: Vec<_> = std::iter::from_fn(|| drive.monitor()?.next_event()).collect();
    assert!(
        events.iter().any(|event| matches!(event, DriveEvent::Silent(_))) && events.contains(&DriveEvent::Back),
        "{events:?}"
    );
}
