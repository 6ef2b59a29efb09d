//! The transitions of Algorithm 2, each under its own condition.

use std::vec::Vec;

use spherecal_shared::Joints;
use spherecal_shared::protocol::host::{Command, Event, Fault, Phase, Refusal};

use crate::phases::Activity;
use crate::testing::{Bench, HOME};

#[test]
fn idle_holds_where_it_began() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.run(1_000);
    assert_eq!(bench.controller.phase(), Phase::Idle);
    assert!(
        (bench.q - nalgebra::SVector::from(HOME)).norm() < 1e-9,
        "an exact model holds exactly"
    );
}

#[test]
fn a_move_ends_at_its_target_and_holds_there() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let mut target = HOME;
    target[0] = 0.5;
    target[3] = -1.0;
    bench.go(&target).expect("idle");
    assert_eq!(bench.controller.phase(), Phase::Moving);
    bench.until(Phase::Idle, 5_000);
    bench.run(500);
    assert!((bench.q - nalgebra::SVector::from(target)).norm() < 1e-3);
    assert_eq!(bench.phases(), [Phase::Moving, Phase::Idle]);
}

/// Fails if joints whose axes align become unstable, or if a force that cannot be
/// determined there stops the arm: twelve motions through the vertical, with
/// errors of the torque sensors.
#[test]
fn the_upper_arm_swings_through_the_vertical() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.torque_bias = nalgebra::SVector::from([2.0, -2.0, 2.0, 2.0, -0.5, 0.5, -0.5]);
    for k in 0..12 {
        let side = if k % 2 == 0 { -1.0 } else { 1.0 };
        let spread = 0.2 * f64::from(k);
        let target = [spread, side * 0.7, -spread, -1.2, 0.5 * side, 0.8 * side, 0.3];
        bench.go(&target).expect("idle");
        bench.until(Phase::Idle, 10_000);
        bench.run(200);
        assert!((bench.q - nalgebra::SVector::from(target)).norm() < 0.05);
    }
    assert!(bench.faults().is_empty(), "{:?}", bench.faults());
}

/// Fails if an arm whose nest may be on a sphere is not allowed to leave it, or if
/// an arm that has left it may do so again.
#[test]
fn a_sphere_is_left_once() {
    let mut bench = Bench::coupled();
    bench.controller.command(Command::Decouple).expect("coupled");
    bench.run(50);
    assert_eq!(bench.controller.phase(), Phase::Decoupling);
    bench.controller.command(Command::Stop).expect("always");
    assert_eq!(bench.controller.phase(), Phase::Idle);
    bench
        .controller
        .command(Command::Decouple)
        .expect("it may still hang there");
    bench.until(Phase::Idle, 5_000);
    assert_eq!(bench.controller.command(Command::Decouple), Err(Refusal::Phase));
}

/// Fails if a phase is skipped, repeated or entered without its condition.
#[test]
fn a_sphere_is_touched_recorded_and_left_in_order() {
    let mut bench = Bench::coupled();
    bench.pose(0.2, true).expect("coupled");
    bench.until(Phase::Coupled, 5_000);
    bench.pose(-0.2, false).expect("coupled");
    bench.until(Phase::Coupled, 5_000);
    bench.controller.command(Command::Decouple).expect("coupled");
    bench.until(Phase::Idle, 5_000);
    let expected = [
        Phase::Taring,
        Phase::Approaching,
        Phase::Coupling,
        Phase::Verifying,
        Phase::Coupled,
        Phase::Turning,
        Phase::Recording,
        Phase::Coupled,
        Phase::Turning,
        Phase::Coupled,
        Phase::Decoupling,
        Phase::Idle,
    ];
    assert_eq!(bench.phases(), expected);
    assert!(bench.faults().is_empty());
    // The promise of each condition.
    let contact = bench
        .events
        .iter()
        .find_map(|e| if let Event::Contact(c) = e { Some(*c) } else { None });
    let contact = contact.expect("a contact");
    assert!(contact.force_n >= 7.5 && contact.sphere == 3 && contact.latency_ticks >= 20);
    let recordings = bench.recordings();
    assert_eq!(recordings.len(), 1, "a pose to pass is not recorded");
    assert_eq!(
        (recordings[0].count, recordings[0].gaps, recordings[0].pose),
        (100, 0, 7)
    );
    assert!(bench.events.iter().any(|e| matches!(e, Event::Passed { pose: 7 })));
    let sphere = bench.sphere.expect("a sphere");
    assert!((bench.tcp() - sphere).norm() > 0.030, "the arm has left");
}

/// Fails if the hold after contact is shorter than configured or starts late.
#[test]
fn the_magnet_gets_its_time() {
    let mut bench = Bench::coupled();
    let at = |phase| {
        let change = bench.events.iter().find_map(|e| match e {
            Event::Phase(p) if p.phase == phase => Some(p.tick),
            _ => None,
        });
        change.expect("the phase was entered")
    };
    let hold = at(Phase::Verifying) - at(Phase::Coupling);
    assert!((299..=301).contains(&hold), "held for {hold} ms");
    bench.run(10);
}

/// Fails if the recording contains samples of a moving arm.
#[test]
fn a_disturbed_recording_is_begun_anew() {
    let mut bench = Bench::coupled();
    bench.pose(0.1, true).expect("coupled");
    bench.until(Phase::Recording, 5_000);
    bench.run(180);
    // A push at the elbow: the joints move, the nest stays on the sphere.
    bench.dq[2] += 0.05;
    bench.run(30);
    assert!(bench.recordings().is_empty());
    bench.until(Phase::Coupled, 3_000);
    let recordings = bench.recordings();
    assert_eq!((recordings.len(), recordings[0].count, recordings[0].gaps), (1, 100, 0));
    assert!(recordings[0].q.iter().all(|q| q.std < 1e-3));
}

/// Fails if an arm whose angles rest is never recorded because its drive shows speeds: 10 mrad/s at every third tick, as of a
/// contact that chatters faster than it is sampled, or an offset of 4 mrad/s.
#[test]
fn an_arm_whose_angles_rest_is_at_rest() {
    let speeds: [fn(u64) -> f64; 2] = [|tick| if tick % 3 == 0 { 0.010 } else { -0.000_8 }, |_| 0.004];
    for speed in speeds {
        let mut bench = Bench::coupled();
        bench.pose(0.1, true).expect("coupled");
        for _ in 0..8_000 {
            bench.run_with(1, |_, state| state.dq[6] += speed(state.tick));
        }
        assert_eq!(
            (bench.recordings().len(), bench.faults().len()),
            (1, 0),
            "{:?}",
            bench.faults()
        );
    }
}

/// Fails if a recording counts although its nest came loose while the arm stood
/// still, or if it does not count without the pull: then the test proves nothing.
#[test]
fn a_recording_counts_when_its_nest_has_borne_a_pull() {
    for check_s in [0.15, 0.0] {
        let mut procedure = Bench::fast_procedure();
        procedure.seating.check_s = check_s;
        let mut bench = Bench::coupled_by(procedure);
        bench.pose(0.1, true).expect("coupled");
        bench.until(Phase::Recording, 5_000);
        bench.run(150);
        // Nothing holds the nest any more, and nothing moves it.
        bench.sphere = None;
        bench.run(600);
        let told: Vec<_> = bench.faults().iter().map(|f| (f.fault, f.phase)).collect();
        if check_s > 0.0 {
            assert_eq!(told, [(Fault::ContactLost, Phase::Recording)]);
            assert!(bench.recordings().is_empty());
        } else {
            assert_eq!((told.len(), bench.recordings().len()), (0, 1));
        }
    }
}

/// Fails if a recording counts, or only starts anew, although its TCP was moved by 0.5
/// mm: so slowly that the arm counts as still all the time, or faster.
#[test]
fn a_recording_ends_where_its_tcp_has_moved() {
    for (ticks, step_m) in [(250, 2e-6), (50, 1e-5)] {
        let mut procedure = Bench::fast_procedure();
        procedure.record.samples = 400;
        let mut bench = Bench::coupled_by(procedure);
        bench.pose(0.1, true).expect("coupled");
        bench.until(Phase::Recording, 5_000);
        bench.run(200);
        // The sphere creeps and takes the arm along.
        for _ in 0..ticks {
            if let Some(sphere) = &mut bench.sphere {
                sphere.x += step_m;
            }
            bench.run(1);
        }
        bench.run(100);
        let told: Vec<_> = bench.faults().iter().map(|f| (f.fault, f.phase)).collect();
        assert_eq!(told, [(Fault::ContactLost, Phase::Recording)]);
        assert!(bench.recordings().is_empty(), "the first samples are of another place");
    }
}

/// Fails if the arm does not follow a hand of 20 N, drifts after its release with
/// a gravity error of 2 N m, or is faster than allowed at any time.
#[test]
fn hand_guiding_lets_the_arm_be_led() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.command(Command::HandGuide { on: true }).expect("idle");
    let before = bench.tcp();
    bench.push = nalgebra::Vector3::new(0.0, 20.0, 0.0);
    let mut last = before;
    for _ in 0..1_000 {
        bench.run(1);
        let speed = (bench.tcp() - last).norm() / 1e-3;
        assert!(speed < 0.4, "{speed} m/s");
        last = bench.tcp();
    }
    assert!((bench.tcp() - before).y > 0.05, "the arm follows the hand");
    // A load that the model does not know: 2 N m on a big joint.
    bench.push = nalgebra::Vector3::new(0.0, 0.0, -4.0);
    bench.run(1_000);
    let left = bench.tcp();
    bench.run(5_000);
    assert!(bench.dq.norm() < 0.001, "it stops when let go");
    assert!((bench.tcp() - left).norm() < 0.002, "and stays");
    bench
        .controller
        .command(Command::HandGuide { on: false })
        .expect("guiding");
    assert_eq!(bench.controller.phase(), Phase::Idle);
    bench.run(1_000);
    let sag = (bench.tcp() - left).norm();
    assert!(sag < 0.006, "moved {sag} m when it held again");
}

/// Fails if a hand can move a joint through the wall before its limit, which would
/// be a fault.
#[test]
fn hand_guiding_ends_before_the_limits() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.command(Command::HandGuide { on: true }).expect("idle");
    // Downwards: joints 2 and 4 move towards their limits.
    bench.push = nalgebra::Vector3::new(0.0, 60.0, -60.0);
    bench.run(20_000);
    assert_eq!(
        bench.controller.phase(),
        Phase::HandGuiding,
        "{:?}",
        bench.events.last()
    );
}

/// Fails if the torque jumps when the phase changes.
#[test]
fn phase_changes_are_bumpless() {
    let mut bench = Bench::coupled();
    let mut last = bench.command.tau.clone();
    for step in 0..4_000 {
        if step == 10 {
            bench.pose(0.2, true).expect("coupled");
        }
        bench.run(1);
        for (a, b) in bench.command.tau.iter().zip(&last) {
            assert!((a - b).abs() <= 4.0 + 1e-9, "4,000 N m/s is the limit");
        }
        last.clone_from(&bench.command.tau);
    }
    assert_eq!(bench.recordings().len(), 1);
}

// Fails if a waiting command starts under another tick number than that of its
// start time: the host's clock would then be off by a period.
#[test]
fn what_starts_bears_the_number_of_its_tick() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.run(3);
    let mut target = HOME;
    target[0] = 0.1;
    let target = Joints::from_slice(&target).expect("seven of eight");
    let start_us = (bench.tick + 20) * 1_000;
    assert!(bench.controller.queue_command(1, start_us, &Command::Move { target }));
    bench.until(Phase::Moving, 30);
    bench.until(Phase::Idle, 5_000);
    let changes: Vec<_> = bench
        .events
        .iter()
        .filter_map(|e| {
            if let Event::Phase(p) = e {
                Some((p.tick, p.time_us))
            } else {
                None
            }
        })
        .collect();
    assert_eq!(changes.len(), 2);
    assert_eq!(changes[0].1, start_us);
    assert!(changes.iter().all(|(tick, time)| tick * 1_000 == *time), "{changes:?}");
}

// Fails if the end of a turn changes the torque: what friction keeps of the spring's moment would press
// the nest on its sphere.
#[test]
fn the_end_of_a_turn_leaves_the_torque_as_it_is() {
    let mut bench = Bench::coupled();
    bench.pose(0.3, true).expect("coupled");
    bench.until(Phase::Turning, 10);
    // Half way, the tool is behind its setpoint.
    bench.run(200);
    let snapshot = bench.controller.snapshot.clone().expect("a state");
    let turning = bench.controller.torque(&snapshot);
    let setpoint = bench.controller.cartesian.setpoint;
    let plain = bench.controller.cartesian.impedance.force(&snapshot, &setpoint, 0.7);
    let seated = bench
        .controller
        .cartesian
        .impedance
        .seated_force(&snapshot, &setpoint, 0.7);
    let reaction = (seated - plain).fixed_rows::<3>(0).norm();
    assert!(reaction > 0.1, "nothing to keep: {reaction} N");
    bench.controller.activity = Activity::Coupled;
    let after = bench.controller.torque(&snapshot);
    assert!((after - turning).amax() < 1e-9, "{after} is not {turning}");
}
