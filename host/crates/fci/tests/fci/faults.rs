//! Faults of network, robot and client: each ends in a typed result, and no command leaves after a stop.

use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::common::{config, deviation, hold, patient, robot, robot_with};
use spherecal_cyclic::Machine as _;
use spherecal_cyclic::testing::World;
use spherecal_fci::client::{Client, ClientError, EndCause};
use spherecal_fci::robot::READY;
use spherecal_fci::wire::{RobotMode, RobotState, Version};

// Fails if 1 % or 5 % of lost datagrams stop the robot, move the arm by more than 1 mrad, break a torque limit, or are
// not counted.
#[test]
fn lost_datagrams_are_counted_and_stop_nothing() {
    for (version, loss, seed) in [(Version::V5, 100, 1), (Version::V10, 500, 2)] {
        let world = World::new(seed);
        let (side, _arm) = robot(&world, version);
        let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
        client.start_torque_motion().expect("a motion");
        world.faults().loss.store(loss, Ordering::Relaxed);
        let mut state = RobotState::default();
        let law = hold(READY);
        let (mut worst, mut missed): (f64, u64) = (0.0, 0);
        for _ in 0..1000 {
            missed += client.exchange(&mut state, &law).expect("a cycle").missed;
            worst = worst.max(deviation(&state, &READY));
        }
        world.faults().loss.store(0, Ordering::Relaxed);
        assert!(worst < 1e-3, "{worst}");
        let lost = world.faults().lost.load(Ordering::Relaxed);
        // Of 1,000 exchanges with two datagrams each: 20 or 100 are expected to be lost.
        assert!(lost > u64::from(loss) / 10, "{lost}");
        let counted = client.statistics();
        assert!(missed > 0 && counted.missed + counted.superseded >= missed);
        client.finish().expect("an end");
        let statistics = side.shut_down();
        // A state or its answer was lost: the robot waited in vain.
        assert!(statistics.missing >= lost / 2, "{} of {lost}", statistics.missing);
        assert_eq!(statistics.commands_after_stop, 0);
    }
}

// Fails if 2 ms of jitter lead to anything but a held arm (with a robot that waits) or the robot's named error (with a
// robot that does not).
#[test]
fn jitter_is_held_or_named() {
    let world = World::new(2);
    let (side, _arm) = robot_with(patient(&world, Version::V10));
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    world.faults().jitter_us.store(2000, Ordering::Relaxed);
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    let law = hold(READY);
    for _ in 0..1000 {
        client.exchange(&mut state, &law).expect("a cycle");
        assert!(deviation(&state, &READY) < 1e-3);
    }
    client.finish().expect("an end");
    drop(client);
    assert_eq!(side.shut_down().commands_after_stop, 0);

    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    world.faults().jitter_us.store(20_000, Ordering::Relaxed);
    let ended: Result<(), ClientError> = client.start_torque_motion().and_then(|()| {
        loop {
            client.exchange(&mut state, &law)?;
        }
    });
    let Err(ClientError::Ended(end)) = ended else {
        panic!("{ended:?}")
    };
    assert_eq!(end.cause, EndCause::Reflex);
    assert_eq!(end.errors.to_string(), "communication_constraints_violation");
    world.faults().jitter_us.store(0, Ordering::Relaxed);
    client.recover().expect("a recovery");
    let statistics = side.shut_down();
    assert!(statistics.late > 0);
    assert_eq!(statistics.commands_after_stop, 0);
}

// Fails if a cable that is out for 3 s is not reported, if the robot goes on without commands, or if the client cannot
// recover on the same connection.
#[test]
fn a_cable_that_is_out_stops_the_robot_and_is_reported() {
    let world = World::new(3);
    let (side, _arm) = robot(&world, Version::V10);
    let mut settings = config(&world, side.address());
    settings.state_timeout = Duration::from_secs(1);
    let mut client = Client::connect(&settings).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    let law = hold(READY);
    for _ in 0..200 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    world.faults().cable_out.store(true, Ordering::Relaxed);
    let silent = loop {
        if let Err(error) = client.exchange(&mut state, &law) {
            break error;
        }
    };
    assert!(matches!(silent, ClientError::Silent { .. }), "{silent}");
    let commands = client.statistics().commands;
    assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Reflex)));
    world.sleep(Duration::from_secs(3));
    // Without a state there is nothing to answer.
    assert!(matches!(client.command(&[0.0; 7]), Err(ClientError::NothingToAnswer)));
    world.faults().cable_out.store(false, Ordering::Relaxed);
    let end = loop {
        match client.exchange(&mut state, &law) {
            Err(ClientError::Ended(end)) => break end,
            Err(ClientError::Silent { .. }) => {}
            other => panic!("{other:?}"),
        }
    };
    assert_eq!(end.errors.to_string(), "communication_constraints_violation");
    assert_eq!(client.statistics().commands, commands);
    client.recover().expect("a recovery");
    client.start_torque_motion().expect("a motion");
    for _ in 0..100 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    client.finish().expect("an end");
    assert_eq!(side.shut_down().commands_after_stop, 0);
}

// Fails if a robot that is restarted is not reported as a closed connection, or a new connection does not work.
#[test]
fn a_restarted_robot_closes_the_connection() {
    let world = World::new(4);
    let (side, _arm) = robot(&world, Version::V10);
    let address = side.address();
    let mut client = Client::connect(&config(&world, address)).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    let law = hold(READY);
    for _ in 0..100 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    side.shut_down();
    let closed = loop {
        if let Err(error) = client.exchange(&mut state, &law) {
            break error;
        }
    };
    assert!(matches!(closed, ClientError::Closed), "{closed}");
    assert!(client.stop().is_err());
    assert!(!client.is_moving());
    drop(client);
    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a new connection");
    client.start_torque_motion().expect("a motion");
    client.exchange(&mut state, &law).expect("a cycle");
    client.stop().expect("a stop");
    assert_eq!(side.shut_down().commands_after_stop, 0);
}

// Fails if the robot goes on when its client is killed, or takes no new client.
#[test]
fn a_killed_client_leaves_a_robot_that_holds() {
    let world = World::new(5);
    let (side, arm) = robot(&world, Version::V5);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    let law = hold(READY);
    for _ in 0..100 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    // The process is gone: no StopMove, no more commands, the connections break.
    world.cut();
    assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Idle)));
    let before = arm.lock().expect("the arm").q;
    assert!(world.eventually(|| side.statistics().periods > 500));
    let after = arm.lock().expect("the arm").q;
    assert!((0..7).all(|j| (after[j] - before[j]).abs() < 1e-3));
    drop(client);
    let mut next = Client::connect(&config(&world, side.address())).expect("a new client");
    next.start_torque_motion().expect("a motion");
    next.stop().expect("a stop");
}

// Fails if a client that is dropped in a motion leaves the robot moving.
#[test]
fn a_dropped_client_stops_the_robot() {
    let world = World::new(6);
    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    for _ in 0..20 {
        client.exchange(&mut state, hold(READY)).expect("a cycle");
    }
    drop(client);
    assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Idle)));
    assert_eq!(side.shut_down().commands_after_stop, 0);
}

// Fails if a client that stalls is not stopped by the robot after 20 missing commands.
#[test]
fn a_stalled_client_is_a_named_reflex() {
    let world = World::new(7);
    let (side, _arm) = robot(&world, Version::V7);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    for _ in 0..20 {
        client.exchange(&mut state, hold(READY)).expect("a cycle");
    }
    assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Reflex)));
    let ended = client.exchange(&mut state, hold(READY));
    let Err(ClientError::Ended(end)) = ended else {
        panic!("{ended:?}")
    };
    assert_eq!(end.errors.to_string(), "communication_constraints_violation");
    let statistics = side.shut_down();
    assert!(statistics.missing >= 20);
    assert_eq!(statistics.commands_after_stop, 0);
}

// Fails if repeated or reordered states are answered, or repeated or reordered commands are carried out.
#[test]
fn repeated_and_reordered_datagrams_are_skipped() {
    let world = World::new(8);
    let (side, _arm) = robot(&world, Version::V5);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    world.faults().repeat.store(true, Ordering::Relaxed);
    let mut state = RobotState::default();
    let law = hold(READY);
    let mut last = 0;
    for _ in 0..500 {
        client.exchange(&mut state, &law).expect("a cycle");
        assert!(state.message_id > last);
        last = state.message_id;
    }
    world.faults().repeat.store(false, Ordering::Relaxed);
    let counted = client.statistics();
    assert!(counted.stale > 400, "{counted:?}");
    client.finish().expect("an end");
    let statistics = side.shut_down();
    assert!(statistics.late > 400, "{statistics:?}");
    // One command for each state of the motion, but for those that came together with a newer one.
    assert!(statistics.commands <= client.statistics().commands);
    assert_eq!((statistics.malformed, statistics.commands_after_stop), (0, 0));
}
