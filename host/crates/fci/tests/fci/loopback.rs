//! Our client against our robot side, on a virtual clock.

use std::sync::atomic::Ordering;

use crate::common::{config, deviation, hold, on_this_machine, robot, robot_with};
use spherecal_cyclic::testing::World;
use spherecal_fci::client::{Client, ClientError, EndCause, ReadOnlyClient, TorqueLimits};
use spherecal_fci::robot::{READY, RobotConfig};
use spherecal_fci::wire::{CollisionBehavior, ErrorFlag, FlangeLoad, RobotMode, RobotState, Status, Version};

fn ended(result: Result<impl std::fmt::Debug, ClientError>) -> spherecal_fci::client::MotionEnd {
    match result {
        Err(ClientError::Ended(end)) => end,
        other => panic!("the motion should have ended: {other:?}"),
    }
}

/// Exchanges until the motion ends; fails after many cycles.
fn until_the_end(client: &mut Client) -> spherecal_fci::client::MotionEnd {
    let mut state = RobotState::default();
    let law = hold(READY);
    for _ in 0..20_000 {
        let result = client.exchange(&mut state, &law);
        if result.is_err() {
            assert!(!client.is_moving());
            return ended(result);
        }
    }
    panic!("the motion did not end");
}

// Fails if a version is not agreed, if settings do not arrive, or if a motion does not hold the arm within 1 mrad
// against the error of its gravity compensation.
#[test]
fn every_version_holds_the_arm() {
    let world = World::new(0);
    for version in Version::ALL.into_iter().filter(|v| v.can_move()) {
        let (side, _arm) = robot(&world, version);
        let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
        assert_eq!(client.version(), version);
        let model = client.robot_model().expect("a model");
        assert_eq!(model.is_some(), version >= Version::V8);
        if let Some(model) = model {
            assert_eq!(model.matches("<position_based_velocity_limits ").count(), 7);
        }
        let load = FlangeLoad {
            mass: 1.5,
            centre_of_mass: [0.0, 0.0, 0.05],
            inertia: [0.0; 9],
        };
        client.set_load(&load).expect("a load");
        client
            .set_collision_behavior(&CollisionBehavior::uniform([30.0; 7], [40.0; 7], [30.0; 6], [40.0; 6]))
            .expect("thresholds");
        client.start_torque_motion().expect("a motion");
        let mut state = RobotState::default();
        let law = hold(READY);
        let mut worst: f64 = 0.0;
        for _ in 0..1500 {
            let cycle = client.exchange(&mut state, &law).expect("a cycle");
            assert!(!cycle.torque_limited);
            worst = worst.max(deviation(&state, &READY));
        }
        assert_eq!(state.m_load, 1.5);
        assert!(worst < 1e-3, "version {version}: {worst}");
        // The arm did move: without the law it would fall away.
        assert!(worst > 1e-4, "version {version}: {worst}");
        assert!(state.control_command_success_rate > 0.8);
        client.finish().expect("an end");
        assert!(!client.is_moving());
        assert!(matches!(client.command(&[0.0; 7]), Err(ClientError::NothingToAnswer)));
        let statistics = side.shut_down();
        assert_eq!(statistics.commands_after_stop, 0);
        assert_eq!(statistics.malformed, 0);
        assert!(statistics.load_kg == 1.5);
    }
}

// Fails if the clamp lets a jump pass that the robot punishes, or does not count it.
#[test]
fn a_jump_of_the_law_is_clamped_and_counted() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    let mut limited = 0;
    for cycle in 0..40 {
        let wanted = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, if cycle % 20 < 10 { 5.0 } else { -5.0 }];
        limited += u64::from(client.exchange(&mut state, |_| wanted).expect("no reflex").rate_limited);
    }
    assert!(limited >= 20, "{limited}");
    assert_eq!(client.statistics().rate_limited, limited);
    client.stop().expect("a stop");
    let before = client.statistics().commands;
    assert!(matches!(client.command(&[0.0; 7]), Err(ClientError::NothingToAnswer)));
    assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Idle)));
    assert_eq!(client.statistics().commands, before);
    assert_eq!(side.shut_down().commands_after_stop, 0);
}

// Fails if a jump of 5,000 N m/s does not end in the right reflex with the robot's own name, or the robot does not
// recover.
#[test]
fn a_torque_jump_is_a_named_reflex_and_recovers() {
    let world = World::new(0);
    for version in Version::ALL.into_iter().filter(|v| v.can_move()) {
        let (side, _arm) = robot(&world, version);
        let mut settings = config(&world, side.address());
        settings.limits = TorqueLimits {
            torque_rate: 10_000.0,
            ..TorqueLimits::default()
        };
        let mut client = Client::connect(&settings).expect("a connection");
        client.start_torque_motion().expect("a motion");
        let mut state = RobotState::default();
        for _ in 0..50 {
            client.exchange(&mut state, hold(READY)).expect("a cycle");
        }
        client
            .exchange(&mut state, |s| std::array::from_fn(|j| s.tau_J_d[j] + 5.0))
            .expect("the jump");
        let end = until_the_end(&mut client);
        assert_eq!(end.cause, EndCause::Reflex);
        assert_eq!(end.status, Some(Status::ReflexAborted));
        assert_eq!(end.mode, RobotMode::Reflex);
        assert_eq!(end.errors.to_string(), "controller_torque_discontinuity");
        assert!(matches!(
            client.start_torque_motion(),
            Err(ClientError::NotReady {
                mode: RobotMode::Reflex,
                ..
            })
        ));
        client.recover().expect("a recovery");
        client.start_torque_motion().expect("a motion after the recovery");
        for _ in 0..50 {
            client.exchange(&mut state, hold(READY)).expect("a cycle");
        }
        client.finish().expect("an end");
        assert_eq!(side.shut_down().commands_after_stop, 0);
    }
}

// Fails if a push on the arm is not the reflex that the thresholds promise.
#[test]
fn pushes_are_reflexes_by_joint_and_by_force() {
    let world = World::new(0);
    let (side, arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client
        .set_collision_behavior(&CollisionBehavior::uniform([2.0; 7], [10.0; 7], [2.0; 6], [10.0; 6]))
        .expect("thresholds");
    let mut state = RobotState::default();
    // A contact below the upper threshold is shown and stops nothing.
    client.start_torque_motion().expect("a motion");
    arm.lock().expect("the arm").wrench[2] = 7.5;
    let seen = (0..200).any(|_| {
        client.exchange(&mut state, hold(READY)).expect("no reflex");
        state.cartesian_contact[2] == 1.0 && state.cartesian_collision[2] == 0.0
    });
    assert!(seen);
    arm.lock().expect("the arm").wrench[2] = 12.0;
    let end = until_the_end(&mut client);
    assert_eq!(
        (end.cause, end.errors.to_string().as_str()),
        (EndCause::Reflex, "cartesian_reflex")
    );
    arm.lock().expect("the arm").wrench[2] = 0.0;
    client.recover().expect("a recovery");
    client.start_torque_motion().expect("a motion");
    arm.lock().expect("the arm").external[3] = -11.0;
    let end = until_the_end(&mut client);
    assert_eq!(
        (end.cause, end.errors.to_string().as_str()),
        (EndCause::Reflex, "joint_reflex")
    );
    assert_eq!(side.shut_down().commands_after_stop, 0);
}

// Fails if what a person at the robot does is not told apart.
#[test]
fn stops_by_a_person_are_told_apart() {
    let world = World::new(0);
    for version in [Version::V5, Version::V10] {
        let (side, _arm) = robot(&world, version);
        let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
        let controls = side.controls();
        for (control, cause) in [
            (&controls.user_stop, EndCause::UserStop),
            (&controls.guiding, EndCause::Guiding),
            (&controls.safety_stop, EndCause::SafetyFunction),
        ] {
            client.start_torque_motion().expect("a motion");
            control.store(true, Ordering::Relaxed);
            let end = until_the_end(&mut client);
            // Version 5 has no status for safety functions.
            let expected = match cause {
                EndCause::SafetyFunction if version == Version::V5 => EndCause::Preempted,
                other => other,
            };
            assert_eq!(end.cause, expected, "version {version}");
            assert!(matches!(
                client.start_torque_motion(),
                Err(ClientError::NotReady { .. })
            ));
            if cause == EndCause::UserStop {
                assert!(matches!(client.recover(), Err(ClientError::Refused { .. })));
            }
            control.store(false, Ordering::Relaxed);
            assert!(world.eventually(|| side.statistics().mode == Some(RobotMode::Idle)));
        }
        assert_eq!(side.shut_down().commands_after_stop, 0);
    }
}

// Fails if a joint can leave its limits, or if the robot recovers by itself from there.
#[test]
fn a_joint_at_its_limit_needs_a_person() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    // Drives joint 4 slowly towards its upper stop.
    let law = |s: &RobotState| {
        let mut torque = hold(READY)(s);
        torque[3] = 40.0 * (0.5 - s.dq[3]);
        torque
    };
    let end = loop {
        match client.exchange(&mut state, law) {
            Ok(_) => {}
            Err(ClientError::Ended(end)) => break end,
            Err(error) => panic!("{error}"),
        }
    };
    // Near the stop the FR3 permits less and less velocity, so that one comes first.
    assert_eq!(end.errors.to_string(), "joint_velocity_violation");
    client.recover().expect("a recovery");

    let (side, _arm) = robot(&world, Version::V5);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let end = loop {
        match client.exchange(&mut state, law) {
            Ok(_) => {}
            Err(ClientError::Ended(end)) => break end,
            Err(error) => panic!("{error}"),
        }
    };
    assert!(end.errors.contains(ErrorFlag::JointPositionLimitsViolation));
    let refused = client.recover();
    let expected = Status::ManualRecoveryRequired;
    assert!(
        matches!(refused, Err(ClientError::Refused { status, .. }) if status == expected),
        "{refused:?}"
    );
}

// Fails if a torque that is no number leaves the client, or costs the cycle.
#[test]
fn a_torque_that_is_no_number_is_not_sent() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V10);
    let mut client = Client::connect(&config(&world, side.address())).expect("a connection");
    client.start_torque_motion().expect("a motion");
    let mut state = RobotState::default();
    client.receive(&mut state).expect("a state");
    let mut torque = [0.0; 7];
    torque[4] = f64::NAN;
    assert!(matches!(
        client.command(&torque),
        Err(ClientError::TorqueNotFinite { joint: 5 })
    ));
    client.command(&[0.0; 7]).expect("the state can still be answered");
    assert!(matches!(client.command(&[0.0; 7]), Err(ClientError::NothingToAnswer)));
    client.stop().expect("a stop");
    assert_eq!(side.shut_down().malformed, 0);
}

// Fails if the read-only mode asks for a motion, sends a command, or misses what the robot does.
#[test]
fn the_observer_reads_and_never_commands() {
    let world = World::new(0);
    for version in Version::ALL {
        let (side, arm) = robot(&world, version);
        let mut observer = ReadOnlyClient::connect(&config(&world, side.address())).expect("a connection");
        assert_eq!(observer.version(), version);
        let mut state = RobotState::default();
        side.controls().guiding.store(true, Ordering::Relaxed);
        let changed = (0..5000).find_map(|_| observer.receive(&mut state).expect("a state").mode_before);
        assert_eq!((changed, state.robot_mode), (Some(RobotMode::Idle), RobotMode::Guiding));
        let start = state.q[1];
        arm.lock().expect("the arm").external[1] = 1.0;
        let moved = (0..5000).any(|_| {
            observer.receive(&mut state).expect("a state");
            (state.q[1] - start).abs() > 0.02
        });
        assert!(moved);
        assert_eq!(
            observer.robot_model().expect("an answer").is_some(),
            version >= Version::V8
        );
        drop(observer);
        let statistics = side.shut_down();
        assert_eq!(
            (statistics.commands, statistics.late, statistics.commands_after_stop),
            (0, 0, 0)
        );
    }
}

// Fails if a client that moves connects to a robot that is only read, or if the error does not say so.
#[test]
fn a_version_that_is_only_read_moves_nothing() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V4);
    let error = Client::connect(&config(&world, side.address()))
        .err()
        .expect("an error");
    assert!(
        matches!(error, ClientError::ReadOnly { version: Version::V4 }),
        "{error}"
    );
    let mut observer = ReadOnlyClient::connect(&config(&world, side.address())).expect("a connection");
    let mut state = RobotState::default();
    observer.receive(&mut state).expect("a state");
    assert!(deviation(&state, &READY) < 1e-3);
    assert_eq!(side.shut_down().commands, 0);
}

// Fails if a client that connects right after the one before it has left is turned away.
#[test]
fn a_client_that_left_makes_room_at_once() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V5);
    for k in 0..30 {
        let observer = ReadOnlyClient::connect(&config(&world, side.address()));
        assert!(observer.is_ok(), "connection {k}: {:?}", observer.err());
    }
}

// Fails if a client that may not speak the robot's version connects, or its error does not name both.
#[test]
fn a_version_that_is_not_permitted_is_an_error() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V10);
    let mut settings = config(&world, side.address());
    settings.versions = vec![Version::V8, Version::V5];
    let error = Client::connect(&settings).err().expect("an error");
    assert!(
        matches!(&error, ClientError::Version { robot: 10, permitted } if *permitted == [8, 5]),
        "{error}"
    );
    drop(side);
    let refused = Client::connect(&settings).err().expect("an error");
    assert!(matches!(refused, ClientError::Connect { .. }), "{refused}");
    assert!(refused.to_string().contains("activate FCI in Desk"));
}

// Fails if a second client can take the robot from the first.
#[test]
fn a_second_client_is_turned_away() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Version::V10);
    let mut first = Client::connect(&config(&world, side.address())).expect("a connection");
    let second = Client::connect(&config(&world, side.address()));
    assert!(
        matches!(second, Err(ClientError::Closed | ClientError::Io(_))),
        "{:?}",
        second.err()
    );
    first.start_torque_motion().expect("a motion");
    first.stop().expect("a stop");
}

// Fails if the option for busy polling is not set, or a system that refuses it is not named.
#[cfg(target_os = "linux")]
#[test]
fn busy_polling_is_set_or_its_refusal_is_named() {
    let (side, _arm) = robot_with(RobotConfig::for_tests(Version::V10));
    let mut settings = on_this_machine(side.address());
    settings.busy_poll_us = Some(50);
    match ReadOnlyClient::connect(&settings) {
        Ok(mut observer) => {
            observer.receive(&mut RobotState::default()).expect("a state");
        }
        Err(error) => assert!(error.to_string().contains("SO_BUSY_POLL"), "{error}"),
    }
}
