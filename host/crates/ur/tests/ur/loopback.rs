//! Our client against our robot side, on a virtual clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_cyclic::testing::World;
use spherecal_ur::client::{ClientConfig, ClientError, ReadOnlyClient, Unready, read_kinematics};
use spherecal_ur::wire::Series;

use crate::common::{POSE, calibration, config, robot};

// Fails if a CB3 is not read at 125 Hz or an e-Series robot not at 500 Hz, or if an angle or a time is wrong.
#[test]
fn both_series_are_read_at_their_rate() {
    for (series, rate) in [(Series::Cb3, 125), (Series::ESeries, 500)] {
        let world = World::new(0);
        let (side, arm) = robot(&world, series);
        let mut client = ReadOnlyClient::connect(&config(&world, &side)).expect("a connection");
        assert_eq!(client.series(), series);
        let first = client.receive().expect("a state");
        assert_eq!(first.actual_q, POSE);
        assert_eq!((first.ready(), first.program()), (Ok(()), None));
        arm.lock().expect("a lock").q = [0.5; 6];
        let mut last = first;
        for _ in 0..rate {
            last = client.receive().expect("a state");
        }
        assert_eq!(last.actual_q, [0.5; 6]);
        assert!(
            (last.timestamp - first.timestamp - 1.0).abs() < 1e-9,
            "{series:?}: {last:?}"
        );
        assert_eq!(client.skipped(), 0);
        drop(client);
        assert!(world.eventually(|| side.statistics().clients == 0));
        assert_eq!(side.shut_down().broken, 0);
    }
}

// Fails if a client that was late reads old states, or does not count those that it left out.
#[test]
fn a_late_client_reads_the_newest_state() {
    let world = World::new(0);
    let (side, arm) = robot(&world, Series::ESeries);
    let mut client = ReadOnlyClient::connect(&config(&world, &side)).expect("a connection");
    client.receive().expect("a state");
    world.machine().sleep(Duration::from_millis(100));
    arm.lock().expect("a lock").q = [0.25; 6];
    world.machine().sleep(Duration::from_millis(3));
    assert_eq!(client.receive().expect("a state").actual_q, [0.25; 6]);
    assert!((40..=60).contains(&client.skipped()), "{}", client.skipped());
}

// Fails if a stop, a mode or a running program is not told in the robot's own words, or a word that is not known here is
// taken for readiness.
#[test]
fn stops_modes_and_programs_have_the_robots_words() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let mut client = ReadOnlyClient::connect(&config(&world, &side)).expect("a connection");
    let controls = side.controls();
    for (mode, safety, words) in [
        (7, 1, None),
        (6, 2, None),
        (3, 1, Some("POWER_OFF")),
        (5, 1, Some("IDLE")),
        (-1, 1, Some("NO_CONTROLLER")),
        (42, 1, Some("the mode 42")),
        (7, 3, Some("PROTECTIVE_STOP")),
        (7, 7, Some("ROBOT_EMERGENCY_STOP")),
        (7, 9, Some("FAULT")),
        (7, 77, Some("(77)")),
    ] {
        controls.robot_mode.store(mode, Ordering::Relaxed);
        controls.safety_mode.store(safety, Ordering::Relaxed);
        world.machine().sleep(Duration::from_millis(5));
        let ready = client.receive().expect("a state").ready();
        let said = ready.err().map(|unready: Unready| unready.to_string());
        match words {
            None => assert_eq!(said, None),
            Some(words) => assert!(said.as_ref().is_some_and(|said| said.contains(words)), "{said:?}"),
        }
    }
    for (program, words) in [
        (0, Some("STOPPING")),
        (1, None),
        (2, Some("PLAYING")),
        (4, None),
        (9, Some("9")),
    ] {
        controls.runtime_state.store(program, Ordering::Relaxed);
        world.machine().sleep(Duration::from_millis(5));
        assert_eq!(client.receive().expect("a state").program().as_deref(), words);
    }
}

// Fails if a cable that is out, a robot that is switched off, and a port where nobody listens are not told apart.
#[test]
fn lost_robots_are_told_apart() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let settings = config(&world, &side);
    let mut client = ReadOnlyClient::connect(&settings).expect("a connection");
    client.receive().expect("a state");
    world.faults().cable_out.store(true, Ordering::Relaxed);
    assert!(matches!(client.receive(), Err(ClientError::Silent { .. })));
    world.faults().cable_out.store(false, Ordering::Relaxed);
    client.receive().expect("a state");
    drop(side);
    let ended = (0..1000).find_map(|_| client.receive().err());
    assert!(matches!(ended, Some(ClientError::Closed)), "{ended:?}");
    assert!(matches!(
        ReadOnlyClient::connect(&settings),
        Err(ClientError::Connect { .. })
    ));
}

// Fails if a port that accepts and says nothing keeps the client for ever, or is taken for a robot.
#[test]
fn a_silent_port_is_no_robot() {
    let world = World::new(0);
    let machine = world.machine();
    let silent = machine.listen(spherecal_cyclic::testing::LOCAL).expect("a port");
    let port = silent.address().expect("an address").port();
    let settings = ClientConfig {
        machine,
        port,
        ..ClientConfig::new("127.0.0.1")
    };
    let error = ReadOnlyClient::connect(&settings).err().expect("no robot");
    assert!(error.to_string().contains("is this port its RTDE?"), "{error}");
}

// Fails if the calibration does not come as the robot has it, or RTDE's port is taken for the primary interface.
#[test]
fn the_calibration_is_read_from_the_primary_interface() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let settings = config(&world, &side);
    assert_eq!(read_kinematics(&settings).expect("a calibration"), calibration());
    let wrong = ClientConfig {
        port: settings.port + 3,
        ..settings
    };
    let error = read_kinematics(&wrong).expect_err("no calibration there").to_string();
    assert!(error.contains("is this port its primary interface?"), "{error}");
}
