//! Our client against our robot side, on a virtual clock.

use std::sync::atomic::Ordering;
use std::time::Duration;

use spherecal_cyclic::testing::World;
use spherecal_ur::client::{ClientConfig, ClientError, ReadOnlyClient, Unready, read_kinematics};
use spherecal_ur::wire::Series;

use crate::common::{POSE, calibration, config, robot};

/// A state that the robot sends after what the test did before this call.
fn newest(client: &mut ReadOnlyClient) -> spherecal_ur::client::RobotState {
    for _ in 0..5 {
        client.receive().expect("a state");
    }
    client.receive().expect("a state")
}

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

// Fails if a client that is late loses states, gets them out of order, or gets some that are older than a second.
#[test]
fn a_late_client_gets_every_state_of_the_last_second() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let mut client = ReadOnlyClient::connect(&config(&world, &side)).expect("a connection");
    let mut last = client.receive().expect("a state").timestamp;
    // Of the 450 states of 900 ms, 49 still wait when the 750 of 1500 ms come.
    for (late_ms, skipped) in [(300, 0), (900, 0), (1500, 299)] {
        world.machine().sleep(Duration::from_millis(late_ms));
        let before = client.skipped();
        let mut step = client.receive().expect("a state").timestamp - last;
        let left_out = client.skipped() - before;
        assert!(left_out.abs_diff(skipped) <= 2, "{late_ms} ms: {left_out} left out");
        assert!(
            (step - 2e-3 * (left_out + 1) as f64).abs() < 1e-9,
            "{late_ms} ms: {step}"
        );
        last += step;
        for _ in 0..400 {
            step = client.receive().expect("a state").timestamp - last;
            assert!((step - 2e-3).abs() < 1e-9, "{late_ms} ms: {step}");
            last += step;
        }
    }
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
        (7, 22, Some("SAFETY_API_SAFEGUARD_STOP")),
        (7, 77, Some("(77)")),
    ] {
        controls.robot_mode.store(mode, Ordering::Relaxed);
        controls.safety_mode.store(safety, Ordering::Relaxed);
        let ready = newest(&mut client).ready();
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
        assert_eq!(newest(&mut client).program().as_deref(), words);
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
