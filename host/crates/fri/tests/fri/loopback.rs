//! Our client against our cabinet, on a virtual clock.

use std::net::SocketAddr;
use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::common::{cabinet, cabinet_with, commanding, config, deviation, for_client, hold, rise, until};
use spherecal_cyclic::testing::{LOCAL, World};
use spherecal_fri::client::{
    Client, ClientError, CommandingEnd, EndCause, MonitoredState, ReadOnlyClient, TorqueLimits, measured_sign,
};
use spherecal_fri::robot::{CabinetConfig, START, joint_arm, start_cabinet};
use spherecal_fri::wire::{ClientCommandMode, Framing, Quality, SafetyState, SessionState};

fn ended(result: Result<impl std::fmt::Debug, ClientError>) -> CommandingEnd {
    match result {
        Err(ClientError::Ended(end)) => end,
        other => panic!("commanding should have ended: {other:?}"),
    }
}

/// Exchanges until commanding ends; fails after many messages.
fn until_the_end(client: &mut Client, state: &mut MonitoredState) -> CommandingEnd {
    let law = hold(START);
    for _ in 0..20_000 {
        let result = client.exchange(state, &law);
        if result.is_err() {
            assert!(!client.is_enabled());
            return ended(result);
        }
    }
    panic!("commanding did not end");
}

// Fails if the session does not rise through all its states in order, or if the overlay does not hold the arm within
// 1 mrad against the error of its gravity compensation.
#[test]
fn the_session_rises_and_the_overlay_holds_the_arm() {
    let world = World::new(1);
    let mut client = Client::listen(&config(&world)).expect("a client");
    let (side, _arm) = cabinet(&world, client.address().expect("an address"));
    let mut state = MonitoredState::default();
    let mut seen: Vec<SessionState> = Vec::new();
    let law = hold(START);
    let mut called_outside = false;
    for _ in 0..2000 {
        let cycle = client
            .exchange(&mut state, |s| {
                called_outside |= s.message.connection.session != SessionState::CommandingActive;
                law(s)
            })
            .expect("a cycle");
        assert_eq!(
            cycle.commanded,
            state.message.connection.session == SessionState::CommandingActive
        );
        if seen.last() != Some(&state.message.connection.session) {
            seen.push(state.message.connection.session);
        }
        if state.message.connection.session == SessionState::MonitoringReady && !client.is_enabled() {
            client.enable().expect("a robot that may move");
            side.controls().command.store(true, Ordering::Relaxed);
        }
    }
    assert!(!called_outside);
    assert_eq!(
        seen,
        [
            SessionState::MonitoringWait,
            SessionState::MonitoringReady,
            SessionState::CommandingWait,
            SessionState::CommandingActive
        ]
    );
    assert_eq!(state.ipo().command_mode, Some(ClientCommandMode::Torque));
    assert!(state.message.connection.quality >= Quality::Good);
    let mut worst: f64 = 0.0;
    for _ in 0..2000 {
        client.exchange(&mut state, &law).expect("a cycle");
        worst = worst.max(deviation(&state, &START));
    }
    // The arm did move: without the overlay it would fall away.
    assert!(worst > 1e-4 && worst < 1e-3, "{worst}");
    client.disable();
    let end = (0..20_000).find(|_| {
        client.exchange(&mut state, &law).expect("a message");
        !state.is_commanding()
    });
    // The client does not answer any more: the cabinet ends the motion.
    assert!(end.is_some());
    let statistics = side.shut_down();
    assert_eq!((statistics.malformed, statistics.torques_after_stop), (0, 0));
}

// Fails if the velocities are not those of the motion, late by the documented delay.
#[test]
fn velocities_are_differentiated() {
    let world = World::new(2);
    let (mut client, _side, arm) = commanding(&config(&world));
    let mut state = MonitoredState::default();
    let mut worst: f64 = 0.0;
    let mut fastest: f64 = 0.0;
    arm.lock().expect("the arm").external[0] = 5.0;
    let mut last: Option<(u32, f64)> = None;
    for _ in 0..600 {
        client.exchange(&mut state, hold(START)).expect("a cycle");
        let here = (state.message.sequence, state.message.measured_position[0]);
        if let Some((sequence, q)) = last
            && here.0 == sequence + 1
        {
            let difference = (here.1 - q) / 1e-3;
            fastest = fastest.max(difference.abs());
            worst = worst.max((state.dq[0] - difference).abs());
        }
        last = Some(here);
    }
    // 3.3 rad/s^2 at most, late by less than 2 ms.
    assert!(fastest > 0.02 && worst < 0.01, "{fastest} {worst}");
}

// Fails if a safety stop, an application that ends and drives that fall are not told apart, or a torque leaves after
// one of them.
#[test]
fn every_end_has_its_cause() {
    let world = World::new(3);
    let (mut client, side, _arm) = commanding(&config(&world));
    let mut state = MonitoredState::default();
    side.controls().safety.store(2, Ordering::Relaxed);
    let end = until_the_end(&mut client, &mut state);
    assert_eq!(end.cause, EndCause::SafetyStop(SafetyState::StopLevel1));
    assert!(end.to_string().contains("SAFETY_STOP_LEVEL_1"));
    assert!(matches!(
        client.enable(),
        Err(ClientError::NotReady(EndCause::SafetyStop(_)))
    ));
    // The connection stays up, and nothing is commanded.
    for _ in 0..200 {
        let cycle = client.exchange(&mut state, |_| [1.0; 7]).expect("a message");
        assert!(!cycle.commanded);
    }
    side.controls().safety.store(0, Ordering::Relaxed);
    side.controls().command.store(false, Ordering::Relaxed);
    rise(&mut client, &side);
    side.controls().command.store(false, Ordering::Relaxed);
    let end = until_the_end(&mut client, &mut state);
    let fell = EndCause::SessionFell {
        from: SessionState::CommandingActive,
        to: SessionState::MonitoringReady,
    };
    assert_eq!(end.cause, fell);
    let statistics = side.shut_down();
    assert_eq!(statistics.torques_after_stop, 0);
}

// Fails if a client that is not enabled lets a motion begin.
#[test]
fn a_client_that_is_not_enabled_commands_nothing() {
    let world = World::new(4);
    let mut client = Client::listen(&config(&world)).expect("a client");
    let (side, _arm) = cabinet(&world, client.address().expect("an address"));
    let mut state = MonitoredState::default();
    until(&mut client, SessionState::MonitoringReady, &mut state).expect("a good connection");
    side.controls().command.store(true, Ordering::Relaxed);
    until(&mut client, SessionState::CommandingWait, &mut state).expect("the application's motion");
    until(&mut client, SessionState::MonitoringWait, &mut state).expect("no motion without answers");
    // Position control held the arm meanwhile.
    assert!(deviation(&state, &START) < 1e-3);
    assert_eq!(side.shut_down().largest_torque, 0.0);
}

// Fails if a torque that is no number is sent, or limits are not kept and counted.
#[test]
fn torques_are_checked_before_they_are_sent() {
    let world = World::new(5);
    let mut settings = config(&world);
    settings.limits = TorqueLimits {
        torque: [8.0; 7],
        torque_rate: 1000.0,
    };
    let (mut client, side, _arm) = commanding(&settings);
    let mut state = MonitoredState::default();
    let mut torque = [0.0; 7];
    torque[2] = f64::INFINITY;
    let refused = client.exchange(&mut state, |_| torque);
    assert!(
        matches!(refused, Err(ClientError::TorqueNotFinite { joint: 3 })),
        "{refused:?}"
    );
    assert!(client.is_enabled());
    let (mut limited, mut clamped) = (0, 0);
    for k in 0..40 {
        let wanted = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, if k % 20 < 10 { 9.0 } else { -9.0 }];
        let cycle = client.exchange(&mut state, |_| wanted).expect("a cycle");
        limited += u64::from(cycle.rate_limited);
        clamped += u64::from(cycle.torque_limited);
    }
    assert_eq!(
        (client.statistics().rate_limited, client.statistics().torque_limited),
        (limited, clamped)
    );
    assert!(limited >= 30 && clamped >= 38, "{limited} {clamped}");
    assert!(side.shut_down().largest_torque <= 8.0);
}

// Fails if the client answers every message where the cabinet expects each fifth, or counts the others as missed.
#[test]
fn each_nth_message_is_answered() {
    let world = World::new(6);
    let mut client = Client::listen(&config(&world)).expect("a client");
    let settings = CabinetConfig {
        receive_multiplier: 5,
        checksum: true,
        ..for_client(&world.machine(), client.address().expect("an address"))
    };
    let (side, _arm) = cabinet_with(settings);
    rise(&mut client, &side);
    let mut state = MonitoredState::default();
    let before = client.statistics();
    for _ in 0..500 {
        client.exchange(&mut state, hold(START)).expect("a cycle");
        assert!(deviation(&state, &START) < 1e-3);
    }
    let after = client.statistics();
    let (messages, commands) = (after.messages - before.messages, after.commands - before.commands);
    assert!(
        commands * 5 <= messages + 5 && commands * 7 >= messages,
        "{commands} of {messages}"
    );
    assert_eq!(after.checksum_differs, 0);
    assert_eq!(side.shut_down().torques_after_stop, 0);
}

// Fails if a cabinet of version 2.7, whose messages have frames, is not answered in frames, or a frame is taken for damaged.
#[test]
fn messages_in_frames_are_answered_in_frames() {
    let world = World::new(0);
    let mut client = Client::listen(&config(&world)).expect("a client");
    let (side, _arm) = cabinet_with(CabinetConfig {
        framing: Framing::Framed,
        ..for_client(&world.machine(), client.address().expect("an address"))
    });
    rise(&mut client, &side);
    let mut state = MonitoredState::default();
    for _ in 0..500 {
        let cycle = client.exchange(&mut state, hold(START)).expect("a cycle");
        assert!(cycle.commanded && deviation(&state, &START) < 1e-3);
    }
    assert_eq!(client.statistics().checksum_differs, 0);
    let statistics = side.shut_down();
    assert_eq!((statistics.malformed, statistics.missing), (0, 0));
}

// Fails if the cabinet sends from another address than it was told: a client that knows the cabinet hears nothing then.
#[test]
fn the_cabinet_sends_from_its_address() {
    let world = World::new(0);
    let machine = world.machine();
    let client = machine.datagrams(LOCAL).expect("a port");
    let address: SocketAddr = "127.0.0.1:30200".parse().expect("an address");
    let settings = CabinetConfig {
        address: Some(address),
        ..for_client(&machine, client.address().expect("an address"))
    };
    let (_side, _arm) = cabinet_with(settings.clone());
    client.set_wait(Some(Duration::from_millis(5))).expect("a wait");
    let (_, from) = client.receive(&mut [0; 2000]).expect("a message");
    assert_eq!(from, address);
    // A second cabinet cannot be there.
    assert!(start_cabinet(settings, Box::new(joint_arm(START))).is_err());
}

// Fails if the read-only mode commands, lets a motion begin, or misses a hand-guided motion.
#[test]
fn the_observer_watches_and_never_commands() {
    let world = World::new(7);
    let mut observer = ReadOnlyClient::listen(&config(&world)).expect("an observer");
    let (side, arm) = cabinet(&world, observer.address().expect("an address"));
    let mut state = MonitoredState::default();
    side.controls().guiding.store(true, Ordering::Relaxed);
    arm.lock().expect("the arm").external[1] = 1.0;
    let moved = (0..5000).any(|_| {
        observer.receive(&mut state).expect("a message");
        (state.message.measured_position[1] - START[1]).abs() > 0.02
    });
    assert!(moved);
    arm.lock().expect("the arm").external[1] = 0.0;
    side.controls().guiding.store(false, Ordering::Relaxed);
    side.controls().command.store(true, Ordering::Relaxed);
    let begun = (0..3000).any(|_| {
        observer.receive(&mut state).expect("a message");
        state.message.connection.session == SessionState::CommandingActive
    });
    assert!(!begun);
    assert_eq!(side.shut_down().largest_torque, 0.0);
}

// Fails if the sign of the measured torques is not found, in either convention.
#[test]
fn the_sign_of_the_measured_torques_is_found_at_rest() {
    let world = World::new(8);
    for sign in [1.0, -1.0] {
        let mut observer = ReadOnlyClient::listen(&config(&world)).expect("an observer");
        let client = observer.address().expect("an address");
        let settings = CabinetConfig {
            measured_sign: sign,
            ..for_client(&world.machine(), client)
        };
        let (_side, arm) = cabinet_with(settings);
        let mut state = MonitoredState::default();
        observer.receive(&mut state).expect("a message");
        let gravity = arm.lock().expect("the arm").gravity;
        let gravity = std::array::from_fn(|j| gravity[j] * state.message.measured_position[j].sin());
        let found = measured_sign(&state.message.measured_torque, &gravity).expect("plain enough");
        assert_eq!(found as i32, i32::from(sign < 0.0));
    }
}

// Fails if two clients can listen at one port, or the error does not say so.
#[test]
fn a_taken_port_is_an_error() {
    let world = World::new(9);
    let first = Client::listen(&config(&world)).expect("a client");
    let mut settings = config(&world);
    settings.address = first.address().expect("an address");
    let error = Client::listen(&settings).err().expect("refused");
    assert!(matches!(&error, ClientError::Listen { .. }), "{error}");
    let mut quiet = config(&world);
    quiet.timeout = Duration::from_millis(20);
    let mut observer = ReadOnlyClient::listen(&quiet).expect("an observer");
    let silent = observer.receive(&mut MonitoredState::default());
    assert!(matches!(silent, Err(ClientError::Silent { .. })));
}
