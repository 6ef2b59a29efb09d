//! Torques by our program: client against robot side, on a virtual clock.

use std::io::{Read as _, Write as _};
use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::sync::{Arc, Mutex};
use std::time::Duration;

use spherecal_cyclic::testing::World;
use spherecal_ur::client::{
    ClientConfig, ClientError, DashboardCommand, ReadOnlyClient, TorqueClient, TorqueState, Unready, ask_dashboard,
};
use spherecal_ur::robot::{ArmCommand, ArmHardware, ArmState, RobotConfig, RobotSide, start_robot};
use spherecal_ur::wire::{
    Answer, INPUTS, Load, Order, PATIENCE_STEPS, PROGRAM, Recipe, Request, SERVO_LOOKAHEAD_S, SafetyMode, Series,
    Value, take_package,
};

use crate::common::{calibration, config};

/// An arm that writes down what it was told.
#[derive(Clone, Default)]
struct Told(Arc<Mutex<(Vec<ArmCommand>, Load)>>);

impl ArmHardware for Told {
    fn state(&self) -> ArmState {
        ArmState::default()
    }

    fn step(&mut self, command: ArmCommand, _: f64) -> ArmState {
        self.0.lock().expect("a lock").0.push(command);
        ArmState::default()
    }

    fn set_load(&mut self, load: &Load) {
        self.0.lock().expect("a lock").1 = *load;
    }
}

impl Told {
    /// What it was told in the last periods, of torques the first one.
    fn last(&self, count: usize) -> Vec<Option<f64>> {
        let told = self.0.lock().expect("a lock");
        let torque = |command: &ArmCommand| match command {
            ArmCommand::Torque(torque) => Some(torque[0]),
            ArmCommand::Hold | ArmCommand::Follow(..) => None,
        };
        told.0[told.0.len() - count..].iter().map(torque).collect()
    }
}

const LOAD: Load = Load {
    mass_kg: 1.5,
    com_m: [0.01, 0.02, 0.03],
    inertia_kg_m2: [0.004, 0.005, 0.006, 0.001, 0.002, 0.003],
};

/// A robot of this world with an arm that writes down, and how it is reached.
fn robot(world: &World, change: impl FnOnce(&mut RobotConfig)) -> (RobotSide, Told, ClientConfig) {
    let told = Told::default();
    let mut settings = RobotConfig {
        machine: world.machine(),
        address: spherecal_cyclic::testing::LOCAL,
        ..RobotConfig::new(Series::ESeries, calibration())
    };
    change(&mut settings);
    let side = start_robot(settings, Box::new(told.clone())).expect("a robot");
    let config = config(world, &side);
    (side, told, config)
}

/// Answers `count` states with this order; the last state.
fn answer(client: &mut TorqueClient, order: &Order, count: usize) -> TorqueState {
    let mut state = TorqueState::default();
    for _ in 0..count {
        client.receive(&mut state).expect("a state");
        client.send(order).expect("sent");
    }
    state
}

/// A client whose program runs.
fn running(config: &ClientConfig) -> TorqueClient {
    let mut client = TorqueClient::connect(config, LOAD).expect("a connection");
    answer(&mut client, &Order::Listen, 5);
    client.upload().expect("sent");
    let state = answer(&mut client, &Order::Listen, 10);
    assert_eq!(state.robot.program().as_deref(), Some("PLAYING"));
    client
}

fn torque(first: f64) -> Order {
    Order::Torque([first, 0.0, 0.0, 0.0, 0.0, 0.0])
}

// Fails if the robot is not told the load, torques do not reach the arm in their order, one of each period, or a number is
// acknowledged before or after its torque acts: two periods after the state that it answers, and three with a wait of two.
#[test]
fn torques_reach_the_arm_and_are_acknowledged_as_they_act() {
    for (input_delay, periods) in [(0, 1), (1, 2), (2, 3)] {
        let world = World::new(0);
        let (side, told, config) = robot(&world, |robot| robot.input_delay = input_delay);
        let mut client = running(&config);
        assert_eq!(told.0.lock().expect("a lock").1, LOAD);
        let mut state = TorqueState::default();
        let mut sent = Vec::new();
        for k in 0..50 {
            client.receive(&mut state).expect("a state");
            sent.push((client.send(&torque(f64::from(k))).expect("sent"), state.robot.timestamp));
        }
        client.receive(&mut state).expect("a state");
        let (_, answered) = sent
            .iter()
            .find(|(number, _)| *number == state.acknowledged)
            .expect("a number");
        let age = state.robot.timestamp - answered;
        assert!((age - 2e-3 * f64::from(periods)).abs() < 1e-9, "{input_delay}: {age} s");
        // The period that began with this state carries out the torque whose number it acknowledged.
        let index = f64::from(state.acknowledged - sent[0].0);
        assert_eq!(told.last(3), [Some(index - 2.0), Some(index - 1.0), Some(index)]);
        let statistics = side.shut_down();
        assert_eq!(
            (statistics.programs, statistics.refused, statistics.after_stop),
            (1, 0, 0)
        );
    }
}

// Fails if an arm follows the last torque for longer than the program's patience after its client has fallen silent, holds
// earlier, or if a torque that comes later is carried out or is not counted.
#[test]
fn a_silent_client_leaves_the_arm_to_the_robot() {
    let world = World::new(0);
    let (side, told, config) = robot(&world, |_| ());
    let mut client = running(&config);
    answer(&mut client, &torque(7.0), 100);
    world.machine().sleep(Duration::from_millis(200));
    let after = told.last(100);
    let followed = after.iter().filter(|torque| **torque == Some(7.0)).count() as u32;
    let [patience, _] = PATIENCE_STEPS;
    // The last package acts two periods later.
    assert_eq!(followed, patience + 1, "{after:?}");
    assert_eq!(side.statistics().silent, 1);
    let state = answer(&mut client, &torque(8.0), 30);
    assert_eq!(state.robot.program(), None);
    assert!(told.last(20).iter().all(Option::is_none));
    assert!(side.statistics().after_stop > 10, "{:?}", side.statistics());
    // The program comes again.
    client.upload().expect("sent");
    answer(&mut client, &torque(9.0), 20);
    assert_eq!(told.last(1), [Some(9.0)]);
}

// Fails if a stop, a person who ends the program, or a torque beyond a limit does not end it at once; or if the robot takes a
// program while it is stopped or in local control.
#[test]
fn stops_end_the_program() {
    let world = World::new(0);
    let (side, told, config) = robot(&world, |robot| robot.limits = [(1.0, 10.0); 6]);
    let mut client = running(&config);
    let controls = side.controls();
    answer(&mut client, &torque(5.0), 10);
    controls
        .safety_mode
        .store(SafetyMode::SafeguardStop.number(), Ordering::Relaxed);
    let state = answer(&mut client, &torque(5.0), 5);
    assert_eq!(
        state.robot.ready(),
        Err(Unready::Stopped(SafetyMode::SafeguardStop.number()))
    );
    assert_eq!((state.robot.program(), told.last(3)), (None, vec![None; 3]));
    client.upload().expect("sent");
    assert_eq!(answer(&mut client, &torque(5.0), 9).robot.program(), None);
    controls
        .safety_mode
        .store(SafetyMode::Normal.number(), Ordering::Relaxed);
    controls.remote.store(false, Ordering::Relaxed);
    client.upload().expect("sent");
    assert_eq!(answer(&mut client, &torque(5.0), 9).robot.program(), None);
    controls.remote.store(true, Ordering::Relaxed);
    client.upload().expect("sent");
    assert!(answer(&mut client, &torque(5.0), 9).robot.program().is_some());
    controls.stop_program.store(true, Ordering::Relaxed);
    assert_eq!(answer(&mut client, &torque(5.0), 5).robot.program(), None);
    client.upload().expect("sent");
    let state = answer(&mut client, &torque(10.1), 9);
    assert_eq!(state.robot.safety_mode, SafetyMode::ProtectiveStop.number());
    assert!(told.last(5).iter().all(Option::is_none));
    assert_eq!(side.statistics().limits, 1);
}

// Fails if a protective stop can be ended within its first five seconds, or not after them; or if remote control is not told.
#[test]
fn the_dashboard_ends_a_protective_stop_after_five_seconds() {
    let world = World::new(0);
    let (side, _told, config) = robot(&world, |_| ());
    let safety = &side.controls().safety_mode;
    safety.store(SafetyMode::ProtectiveStop.number(), Ordering::Relaxed);
    let unlock = [
        DashboardCommand::CloseSafetyPopup,
        DashboardCommand::UnlockProtectiveStop,
    ];
    for (after_s, said, mode) in [
        (4, "Cannot unlock protective stop", SafetyMode::ProtectiveStop),
        (2, "Protective stop releasing", SafetyMode::Normal),
    ] {
        world.machine().sleep(Duration::from_secs(after_s));
        let answer = ask_dashboard(&config, &unlock).expect("an answer");
        assert!(answer.starts_with(said), "{answer}");
        assert_eq!(safety.load(Ordering::Relaxed), mode.number());
    }
    let remote = || ask_dashboard(&config, &[DashboardCommand::IsInRemoteControl]).expect("an answer");
    assert_eq!(remote(), "true");
    side.controls().remote.store(false, Ordering::Relaxed);
    assert_eq!(remote(), "false");
}

// Fails if a second client may write the same registers, gets them not after the first has left, or if software without
// torques is accepted.
#[test]
fn one_client_commands_a_robot_that_takes_torques() {
    let world = World::new(0);
    let (_side, _told, config) = robot(&world, |_| ());
    let client = running(&config);
    let second = || TorqueClient::connect(&config, LOAD);
    let refused = second().err().expect("taken");
    assert!(
        matches!(refused, ClientError::InUse { field } if field == INPUTS[0].0),
        "{refused}"
    );
    drop(client);
    world.machine().sleep(Duration::from_millis(10));
    assert!(second().is_ok());
    for (major, minor, bugfix, torques) in [
        (5, 25, 0, false),
        (5, 25, 1, true),
        (10, 12, 0, false),
        (10, 12, 1, true),
        (3, 15, 8, false),
    ] {
        let world = World::new(0);
        let (_side, _told, config) = robot(&world, |robot| {
            (robot.version.major, robot.version.minor, robot.version.bugfix) = (major, minor, bugfix);
        });
        let connected = TorqueClient::connect(&config, LOAD);
        let refused = matches!(connected, Err(ClientError::NoTorques { .. }));
        assert_eq!(
            (connected.is_ok(), refused),
            (torques, !torques),
            "{major}.{minor}.{bugfix}"
        );
    }
}

/// What a port that takes scripts says to these bytes, if anything.
fn script(world: &World, config: &ClientConfig, below: u16, text: &str) -> Vec<u8> {
    let to: SocketAddr = ([127, 0, 0, 1], config.port - below).into();
    let mut stream = world
        .machine()
        .connect(to, Duration::from_secs(1))
        .expect("a connection");
    stream.write_all(text.as_bytes()).expect("sent");
    stream.set_wait(Some(Duration::from_millis(20))).expect("a wait");
    let mut said = vec![0; 4096];
    let count = stream.read(&mut said).unwrap_or(0);
    said.truncate(count);
    said
}

// Fails if a script that is not ours moves something, ends our program, or is not refused by its name; if ours is not taken at
// each of the three ports; or if one that was changed is taken for ours.
#[test]
fn other_programs_are_refused_by_name() {
    let world = World::new(0);
    let (side, _told, config) = robot(&world, |_| ());
    let mut client = running(&config);
    let mut reader = ReadOnlyClient::connect(&config).expect("a connection");
    let changed = PROGRAM.replace("patience = 12", "patience = 13");
    assert_ne!(changed, PROGRAM);
    assert!(PROGRAM.contains(&format!("lookahead_time={SERVO_LOOKAHEAD_S},")));
    for (text, name) in [
        ("def wave():\n  movej([0,0,0,0,0,0])\nend\n", "wave"),
        (&changed, "spherecal_torque_1"),
    ] {
        let refused = side.statistics().refused;
        script(&world, &config, 2, text);
        assert_eq!(side.statistics().refused, refused + 1);
        let words = format!("the program {name} is none of those");
        reader.receive().expect("a state");
        let message = reader.message().expect("a message").message;
        assert!(message.contains(&words), "{message}");
        assert!(answer(&mut client, &Order::Listen, 5).robot.program().is_some());
    }
    for below in [3, 2, 1] {
        let programs = side.statistics().programs;
        script(&world, &config, below, PROGRAM);
        assert_eq!(side.statistics().programs, programs + 1, "{below}");
    }
}

// Fails if the packages that are made and read in place differ from those of the general encoders.
#[test]
fn fast_packages_are_packages() {
    let world = World::new(0);
    let machine = world.machine();
    let listener = machine.listen(spherecal_cyclic::testing::LOCAL).expect("a port");
    let port = listener.address().expect("an address").port();
    // A robot that says what the test says, and keeps what it hears.
    struct Scripted(
        Box<dyn spherecal_cyclic::Listener>,
        Option<spherecal_cyclic::Wire>,
        Arc<Mutex<Vec<Request>>>,
    );
    impl spherecal_cyclic::Process for Scripted {
        fn turn(&mut self, now: std::time::Instant) -> std::time::Instant {
            if let Ok((stream, _)) = self.0.accept() {
                self.1 = Some(spherecal_cyclic::Wire::new(stream));
            }
            let Some(wire) = &mut self.1 else {
                return now + Duration::from_millis(1);
            };
            wire.poll();
            while let Ok(Some((kind, payload))) = take_package(&mut wire.received, 4096) {
                let request = Request::decode(kind, &payload).expect("a request");
                let types = |names: &[String], of: fn(&str) -> Option<spherecal_ur::wire::FieldType>| {
                    let name = |name: &String| of(name).expect("known").name().to_owned();
                    spherecal_ur::wire::Setup {
                        recipe: 1,
                        types: names.iter().map(name).collect(),
                    }
                };
                let answer = match &request {
                    Request::ProtocolVersion(_) => Some(Answer::ProtocolVersion(true)),
                    Request::ControllerVersion => {
                        Some(Answer::ControllerVersion(spherecal_ur::wire::ControllerVersion {
                            major: 5,
                            minor: 26,
                            bugfix: 0,
                            build: 0,
                        }))
                    }
                    Request::SetupOutputs { names, .. } => {
                        Some(Answer::SetupOutputs(types(names, spherecal_ur::wire::output_type)))
                    }
                    Request::SetupInputs { names } => {
                        Some(Answer::SetupInputs(types(names, spherecal_ur::wire::input_type)))
                    }
                    Request::Start => Some(Answer::Start(true)),
                    _ => None,
                };
                if let Some(answer) = answer {
                    wire.send(&answer.encode());
                }
                if request == Request::Start {
                    let mut values = Vec::new();
                    for value in [
                        Value::Double(1.5),
                        Value::Vector6D([0.1, 0.2, 0.3, 0.4, 0.5, 0.6]),
                        Value::Vector6D([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
                        Value::Int32(7),
                        Value::Int32(1),
                        Value::Uint32(2),
                        Value::Vector6D([-1.0, -2.0, -3.0, -4.0, -5.0, -6.0]),
                        Value::Int32(-9),
                    ] {
                        value.encode(&mut values);
                    }
                    wire.send(&Answer::Data(1, values).encode());
                }
                self.2.lock().expect("a lock").push(request);
            }
            now + Duration::from_millis(1)
        }
    }
    let heard = Arc::default();
    let process = Scripted(listener, None, Arc::clone(&heard));
    let _running = machine.run("scripted", Box::new(process)).expect("a process");
    let settings = ClientConfig {
        machine: world.machine(),
        port,
        ..ClientConfig::new("127.0.0.1")
    };
    let mut client = TorqueClient::connect(&settings, LOAD).expect("a connection");
    let mut state = TorqueState::default();
    client.receive(&mut state).expect("a state");
    assert_eq!(
        (state.robot.timestamp, state.robot.actual_q[5], state.robot.actual_qd[5]),
        (1.5, 0.6, 6.0)
    );
    assert_eq!((state.motor_torque[5], state.acknowledged), (-6.0, -9));
    let number = client
        .send(&Order::Torque([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]))
        .expect("sent");
    world.machine().sleep(Duration::from_millis(5));
    let heard = heard.lock().expect("a lock");
    let Some(Request::Data(1, values)) = heard.last() else {
        panic!("{heard:?}")
    };
    let fields = INPUTS.map(|(name, kind)| (name.to_owned(), kind)).to_vec();
    let read = Recipe { fields }.decode(values).expect("values");
    let doubles = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, LOAD.mass_kg];
    let doubles = doubles.into_iter().chain(LOAD.com_m).chain(LOAD.inertia_kg_m2);
    let expected: Vec<Value> = [Value::Int32(2), Value::Int32(number)]
        .into_iter()
        .chain(doubles.map(Value::Double))
        .collect();
    assert_eq!(read, expected);
}
