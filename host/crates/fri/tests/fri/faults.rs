//! Faults of network, cabinet and client: each ends in a typed result, and no torque leaves after a stop.

use std::sync::atomic::Ordering;
use std::time::Duration;

use crate::common::{cabinet, cabinet_with, commanding, config, deviation, for_client, hold, rise};
use spherecal_cyclic::Machine as _;
use spherecal_cyclic::testing::World;
use spherecal_fri::client::{Client, ClientError, EndCause, MonitoredState};
use spherecal_fri::robot::{CabinetConfig, CabinetSide, START, Tolerance};
use spherecal_fri::wire::SessionState;

/// A client that commands, in a world whose faults depend on `seed`.
fn in_a_world(seed: u64) -> (World, Client, CabinetSide) {
    let world = World::new(seed);
    let mut settings = config(&world);
    settings.timeout = Duration::from_secs(1);
    let (client, side, _arm) = commanding(&settings);
    (world, client, side)
}

// Fails if 1 % or 5 % of lost datagrams end the session, move the arm by more than 1 mrad, or are not counted.
#[test]
fn lost_datagrams_are_counted_and_stop_nothing() {
    for (loss, seed) in [(100, 1), (500, 2)] {
        let (world, mut client, side) = in_a_world(seed);
        world.faults().loss.store(loss, Ordering::Relaxed);
        let mut state = MonitoredState::default();
        let law = hold(START);
        for _ in 0..1000 {
            client.exchange(&mut state, &law).expect("a cycle");
            assert!(deviation(&state, &START) < 1e-3);
        }
        let lost = world.faults().lost.load(Ordering::Relaxed);
        assert!(lost > u64::from(loss) / 10, "{lost}");
        let counted = client.statistics();
        // Each loss is counted once: a message that is missed or a command that is not reflected.
        assert!(counted.missed > 0 && counted.commands_lost > 0, "{counted:?}");
        assert!(counted.missed <= lost, "{counted:?} of {lost}");
        client.disable();
        let statistics = side.shut_down();
        assert!(statistics.missing >= lost / 2, "{} of {lost}", statistics.missing);
        assert_eq!(statistics.torques_after_stop, 0);
    }
}

// Fails if 2 ms of jitter lead to anything but a held arm (with a cabinet that waits) or a session that falls by name
// (with a cabinet that does not).
#[test]
fn jitter_is_held_or_named() {
    let world = World::new(2);
    let mut client = Client::listen(&config(&world)).expect("a client");
    let (side, _arm) = cabinet_with(CabinetConfig {
        tolerance: Tolerance::tolerant(),
        ..for_client(&world.machine(), client.address().expect("an address"))
    });
    rise(&mut client, &side);
    world.faults().jitter_us.store(2000, Ordering::Relaxed);
    let mut state = MonitoredState::default();
    let law = hold(START);
    for _ in 0..1000 {
        client.exchange(&mut state, &law).expect("a cycle");
        assert!(deviation(&state, &START) < 1e-3);
    }
    drop((client, side));

    // A cabinet that does not wait: with 20 ms it never gets an answer in time.
    let mut client = Client::listen(&config(&world)).expect("a client");
    world.faults().jitter_us.store(20_000, Ordering::Relaxed);
    let (side, _arm) = cabinet(&world, client.address().expect("an address"));
    client.exchange(&mut state, &law).expect("a message");
    client.enable().expect("a robot that may move");
    side.controls().command.store(true, Ordering::Relaxed);
    for _ in 0..300 {
        match client.exchange(&mut state, &law) {
            Ok(_) => assert_ne!(state.message.connection.session, SessionState::CommandingActive),
            Err(ClientError::Ended(end)) => assert!(matches!(end.cause, EndCause::SessionFell { .. }), "{end}"),
            Err(error) => panic!("{error}"),
        }
    }
    let statistics = side.shut_down();
    assert!(statistics.late > 0);
    assert_eq!((statistics.largest_torque, statistics.torques_after_stop), (0.0, 0));
}

// Fails if a cable that is out for 3 s is not reported, if the cabinet goes on without answers, or if the client sends a
// torque when the cable is back.
#[test]
fn a_cable_that_is_out_ends_the_motion_and_is_reported() {
    let (world, mut client, side) = in_a_world(5);
    let mut state = MonitoredState::default();
    let law = hold(START);
    for _ in 0..100 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    world.faults().cable_out.store(true, Ordering::Relaxed);
    let silent = loop {
        if let Err(error) = client.exchange(&mut state, &law) {
            break error;
        }
    };
    assert!(matches!(silent, ClientError::Silent { .. }), "{silent}");
    assert!(world.eventually(|| side.statistics().session == Some(SessionState::MonitoringWait)));
    world.sleep(Duration::from_secs(3));
    world.faults().cable_out.store(false, Ordering::Relaxed);
    let end = loop {
        match client.exchange(&mut state, &law) {
            Err(ClientError::Ended(end)) => break end,
            Err(ClientError::Silent { .. }) => {}
            other => panic!("{other:?}"),
        }
    };
    let from = SessionState::CommandingActive;
    assert!(
        matches!(end.cause, EndCause::SessionFell { from: f, .. } if f == from),
        "{end}"
    );
    side.controls().command.store(false, Ordering::Relaxed);
    rise(&mut client, &side);
    for _ in 0..100 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    assert_eq!(side.shut_down().torques_after_stop, 0);
}

// Fails if a restarted cabinet is commanded without a new permission.
#[test]
fn a_restarted_cabinet_is_a_named_end() {
    let world = World::new(4);
    let (mut client, side, _arm) = commanding(&config(&world));
    let address = client.address().expect("an address");
    let mut state = MonitoredState::default();
    let law = hold(START);
    for _ in 0..300 {
        client.exchange(&mut state, &law).expect("a cycle");
    }
    side.shut_down();
    let (side, _arm) = cabinet(&world, address);
    side.controls().command.store(true, Ordering::Relaxed);
    let end = loop {
        match client.exchange(&mut state, &law) {
            Err(ClientError::Ended(end)) => break end,
            Err(error) => panic!("{error}"),
            Ok(_) => {}
        }
    };
    assert_eq!(end.cause, EndCause::Restarted);
    assert_eq!(client.statistics().restarts, 1);
    for _ in 0..300 {
        assert!(!client.exchange(&mut state, &law).expect("a message").commanded);
    }
    side.controls().command.store(false, Ordering::Relaxed);
    rise(&mut client, &side);
    assert_eq!(side.shut_down().torques_after_stop, 0);
}

// Fails if the cabinet goes on when its client is killed, or takes no new client.
#[test]
fn a_killed_client_leaves_closed_brakes() {
    let world = World::new(5);
    let (client, side, arm) = commanding(&config(&world));
    let address = client.address().expect("an address");
    // The process is gone: no more answers.
    drop(client);
    assert!(world.eventually(|| side.statistics().session == Some(SessionState::MonitoringWait)));
    let before = arm.lock().expect("the arm").q;
    let periods = side.statistics().periods;
    assert!(world.eventually(|| side.statistics().periods > periods + 300));
    assert_eq!(before, arm.lock().expect("the arm").q);
    let mut settings = config(&world);
    settings.address = address;
    let mut next = Client::listen(&settings).expect("a new client");
    side.controls().command.store(false, Ordering::Relaxed);
    rise(&mut next, &side);
    assert_eq!(side.shut_down().torques_after_stop, 0);
}
