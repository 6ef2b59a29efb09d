//! The session with the drive: no torque without a handshake, and none by the rules
//! of another session.

use embassy_time::Instant;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{DriveHello, NO_SESSION, TorqueSign};
use spherecal_shared::protocol::host::{Command, Fault, Phase, Refusal};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

use crate::Controller;
use crate::testing::{Bench, HOME, hello};

// Fails if a configured controller gives a torque before the drive's handshake, or
// does not ask for it.
#[test]
fn there_is_no_torque_without_a_handshake() {
    let bench = Bench::new(Bench::fast_procedure());
    let mut controller = Controller::<7>::default();
    controller
        .command(Command::Robot(iiwa7().driven().expect("seven joints")))
        .expect("a robot");
    let (tool, procedure) = (iiwa7_tool(), Procedure::default());
    controller
        .command(Command::Configure { tool, procedure })
        .expect("a tool");
    for tick in 1..50 {
        let mut state = bench.state();
        state.tick = tick;
        let command = controller.tick(Instant::from_millis(tick), &state);
        assert_eq!(
            (command.enable, command.session, command.tick),
            (false, NO_SESSION, tick)
        );
        assert!(command.tau.iter().all(|tau| *tau == 0.0));
    }
    let target = HOME.iter().copied().collect();
    assert_eq!(controller.command(Command::Move { target }), Err(Refusal::Drive));
    controller.connect(&hello()).expect("a drive that fits");
    let mut state = bench.state();
    state.tick = 50;
    let command = controller.tick(Instant::from_millis(50), &state);
    assert_eq!((command.enable, command.session), (true, hello().session));
}

/// The bench under the rules of another session of its drive.
pub(super) fn again(change: impl FnOnce(&mut DriveHello)) -> DriveHello {
    let mut hello = hello();
    hello.session += 1;
    change(&mut hello);
    hello
}

// Fails if a drive that starts again gets a torque of its last session, if that is
// no fault, or if the arm cannot be enabled again: with ticks from 0, and with
// another sign and gravity compensation.
#[test]
fn a_drive_that_starts_again_is_survived() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.run(5_000);
    bench.session += 1;
    bench.tick = 0;
    for _ in 0..20 {
        bench.run(1);
        assert_eq!((bench.command.enable, bench.command.session), (false, NO_SESSION));
    }
    let faults = bench.faults();
    assert_eq!(faults.len(), 1);
    assert_eq!((faults[0].fault, faults[0].phase), (Fault::Drive, Phase::Idle));
    bench.controller.connect(&again(|_| ())).expect("a drive that fits");
    bench.run(100);
    assert!(bench.command.enable, "it holds again");
    bench.controller.command(Command::ClearFault).expect("always");
    let mut target = HOME;
    target[0] += 0.2;
    bench.go(&target).expect("idle");
    bench.until(Phase::Idle, 5_000);
    assert_eq!(bench.faults().len(), 1);
}

// Fails if a handshake that comes first is no fault, or takes effect while the arm
// is under a torque of the session before.
#[test]
fn a_new_handshake_ends_the_session_before() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let hello = again(|hello| hello.compensates_gravity = true);
    bench.controller.connect(&hello).expect("a drive that fits");
    // A state of the old session gets no torque.
    bench.run(1);
    assert!(!bench.command.enable);
    assert_eq!(bench.controller.phase(), Phase::Fault);
    bench.session += 1;
    bench.tick = 0;
    bench.gravity_by_drive = true;
    bench.run(2_000);
    assert!(bench.command.enable);
    assert!(bench.dq.norm() < 1e-3, "it stands: {}", bench.dq.norm());
    assert_eq!(bench.faults().len(), 1);
}

// Fails if a drive that follows angles gets none in a motion through free space, gets them in the first motion after closed brakes
// or where a nest may be on its sphere, if the torques of its own control pass for a force, or if the law does not go on from where the
// drive is: with a jump of the torque, or a fault.
#[test]
fn a_drive_that_follows_angles_gets_them_in_free_space() {
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.session += 1;
    bench.tick = 0;
    let hello = DriveHello {
        session: bench.session,
        follows: true,
        ..hello()
    };
    bench.controller.connect(&hello).expect("a drive that fits");
    bench.run(50);
    bench.controller.command(Command::ClearFault).expect("always");
    bench.run(50);
    // Whether angles were commanded, and the largest step of a torque.
    let ways = |bench: &mut Bench, by: f64| {
        let mut target: [f64; 7] = bench.q.into();
        target[3] += by;
        let target = target.into_iter().collect();
        bench.controller.command(Command::Move { target }).expect("idle");
        let (mut follows, mut step) = (false, 0.0f64);
        for _ in 0..5_000 {
            let before = bench.command.clone();
            let moves = !before.follow.is_empty() && bench.dq.norm() > 0.1;
            bench.torque_bias[1] = if moves { 60.0 } else { 0.0 };
            bench.run(1);
            follows |= !bench.command.follow.is_empty();
            // Torques that do not act count where they begin to.
            let pairs = bench
                .command
                .tau
                .iter()
                .zip(&before.tau)
                .filter(|_| bench.command.follow.is_empty());
            step = pairs.fold(step, |most, (now, before)| most.max((now - before).abs()));
            if bench.controller.phase() == Phase::Idle {
                break;
            }
        }
        assert!(bench.command.follow.is_empty() && bench.controller.phase() == Phase::Idle);
        (follows, step)
    };
    assert!(!ways(&mut bench, 0.2).0, "the first one is by torques");
    let (follows, step) = ways(&mut bench, -0.2);
    assert!(follows && step < 2.0, "{step} N m");
    bench.run(500);
    assert!(bench.dq.norm() < 1e-3, "it stands: {}", bench.dq.norm());
    let faults = bench.faults();
    assert!(faults.iter().all(|fault| fault.fault == Fault::Drive), "{faults:?}");
}

// Fails if sign, gravity compensation, period or limits change within a session, or
// if the same handshake once more disturbs it.
#[test]
fn nothing_changes_within_a_session() {
    let changes: [fn(&mut DriveHello); 4] = [
        |hello| hello.compensates_gravity = true,
        |hello| hello.torque_sign = TorqueSign::OfLink,
        |hello| hello.period_us = 2000,
        |hello| hello.limits[3].torque_nm *= 0.5,
    ];
    for change in changes {
        let mut bench = Bench::new(Bench::fast_procedure());
        let mut twin = bench.clone();
        let mut changed = hello();
        change(&mut changed);
        assert_eq!(bench.controller.connect(&changed), Err(Refusal::Drive));
        assert_eq!(bench.controller.connect(&hello()), Ok(()));
        bench.run(50);
        twin.run(50);
        assert_eq!(bench.command, twin.command);
    }
}

// Fails if a handshake is taken that this controller cannot work with: another
// period than 1 to 4 ms, impossible limits, another protocol, no session number.
#[test]
fn a_handshake_that_does_not_fit_is_refused() {
    let changes: [fn(&mut DriveHello); 10] = [
        |hello| hello.protocol = PROTOCOL_VERSION + 1,
        |hello| hello.session = NO_SESSION,
        |hello| hello.period_us = 999,
        |hello| hello.period_us = 4001,
        |hello| hello.limits[0].torque_nm = f64::NAN,
        |hello| hello.limits[1].velocity_rad_s = f64::INFINITY,
        |hello| hello.limits[2].torque_nm = 0.0,
        |hello| hello.limits[2].max_rad = hello.limits[2].min_rad,
        |hello| hello.limits[6].min_rad = f64::NEG_INFINITY,
        |hello| {
            hello.limits.pop();
        },
    ];
    for (k, change) in changes.into_iter().enumerate() {
        let mut hello = hello();
        change(&mut hello);
        let mut controller = Controller::<7>::default();
        assert_eq!(controller.connect(&hello), Err(Refusal::Drive), "{k}");
        assert!(!controller.has_session());
    }
    for period_us in [1000, 2000, 4000] {
        let mut controller = Controller::<7>::default();
        assert_eq!(controller.connect(&DriveHello { period_us, ..hello() }), Ok(()));
        assert_eq!(controller.period_us(), period_us);
    }
}

// Fails if the drive's limits are not used where they are tighter than the robot's:
// the range of a target, the torque and the speed.
#[test]
fn the_tighter_limits_of_robot_and_drive_hold() {
    let tighter = again(|hello| {
        hello.limits[0].max_rad = 0.3;
        hello.limits[1].torque_nm = 5.0;
        hello.limits[2].torque_nm *= 10.0;
        hello.limits[2].max_rad *= 10.0;
    });
    let mut bench = Bench::new(Bench::fast_procedure());
    bench.controller.connect(&tighter).expect("a drive that fits");
    bench.session += 1;
    bench.blocked = true;
    bench.run(10);
    bench.controller.command(Command::ClearFault).expect("always");
    let mut target = HOME;
    target[0] = 0.35;
    assert_eq!(bench.go(&target), Err(Refusal::Target), "beyond the drive's range");
    target[0] = 0.0;
    target[2] = iiwa7().joints[2].limits.max_rad + 0.1;
    assert_eq!(bench.go(&target), Err(Refusal::Target), "beyond the robot's range");
    bench.run(200);
    assert!(
        bench.command.tau[1].abs() <= 5.0,
        "gravity takes more: {}",
        bench.command.tau[1]
    );
    // The same when the robot is described after the handshake.
    let mut controller = Controller::<7>::default();
    controller.connect(&tighter).expect("a drive that fits");
    controller
        .command(Command::Robot(iiwa7().driven().expect("seven joints")))
        .expect("a robot");
    let (tool, procedure) = (iiwa7_tool(), Procedure::default());
    controller
        .command(Command::Configure { tool, procedure })
        .expect("a tool");
    assert!(
        controller
            .configured
            .as_ref()
            .is_some_and(|c| c.torque_limits[1] == 5.0)
    );
    // Robot and drive without a common range of a joint.
    let apart = again(|hello| {
        hello.session += 7;
        hello.limits[0].min_rad = 10.0;
        hello.limits[0].max_rad = 11.0;
    });
    assert_eq!(controller.connect(&apart), Err(Refusal::Drive));
}

/// Largest speed (rad/s) of joint `joint` (from 0) in a motion by `by` (rad) that asks for 3 rad/s.
fn fastest(bench: &mut Bench, joint: usize, by: f64) -> f64 {
    let mut target = HOME;
    target[joint] += by;
    bench.go(&target).expect("idle");
    let mut fastest = 0.0f64;
    for _ in 0..8_000 {
        bench.run(1);
        fastest = fastest.max(bench.dq[joint].abs());
    }
    assert_eq!((bench.controller.phase(), bench.faults().len()), (Phase::Idle, 0));
    fastest
}

fn hasty() -> Procedure {
    let mut procedure = Bench::fast_procedure();
    procedure.motion.speed_rad_s = 3.0;
    procedure.motion.acceleration_rad_s2 = 20.0;
    procedure
}

// Fails if a motion may ask for more speed than the limit at which it is stopped, 0.9 of the joint's, or has no room
// below it.
#[test]
fn a_motion_keeps_below_the_speed_that_stops_it() {
    let limit = iiwa7().joints[6].limits.velocity_rad_s;
    let fastest = fastest(&mut Bench::new(hasty()), 6, 2.0);
    assert!(fastest > 0.7 * limit && fastest < 0.75 * limit, "{fastest} rad/s");
}

// Fails if the drive's limit of speed is ignored where it is lower than the robot's: by a motion, or by the monitor.
#[test]
fn the_drives_limit_of_speed_holds() {
    let slow = again(|hello| hello.limits[0].velocity_rad_s = 0.2);
    let mut bench = Bench::new(hasty());
    bench.controller.connect(&slow).expect("a drive that fits");
    bench.session += 1;
    bench.run(10);
    bench.controller.command(Command::ClearFault).expect("always");
    bench.events.clear();
    let fastest = fastest(&mut bench, 0, 0.2);
    assert!(fastest > 0.14 && fastest < 0.15, "{fastest} rad/s");
    bench.dq[0] = 0.25;
    bench.run(1);
    let faults = bench.faults();
    assert_eq!((faults[0].fault, faults[0].joint), (Fault::JointVelocity, 1));
}

// Fails if a tick number beyond all others makes the later ones look old.
#[test]
fn an_absurd_tick_is_not_kept() {
    let mut bench = Bench::new(Bench::fast_procedure());
    let now = bench.tick;
    bench.tick = u64::MAX;
    bench.tick_with(&bench.state());
    bench.tick = now;
    bench.expect_fault(Fault::StaleState, Phase::Idle);
    assert!(bench.command.enable);
}

// Fails if a part of the law counts periods as milliseconds: with 1, 2 and 4 ms a
// motion takes the same time and has the same speed, and the same contact is found.
#[test]
fn a_motion_takes_as_long_at_every_period() {
    let mut target = HOME;
    target[0] += 0.5;
    let mut results = std::vec::Vec::new();
    for period_us in [1000, 2000, 4000] {
        let mut bench = Bench::at_period(Bench::fast_procedure(), period_us);
        bench.go(&target).expect("idle");
        let (mut time_us, mut fastest) = (0, 0.0f64);
        while bench.controller.phase() != Phase::Idle && time_us < 10_000_000 {
            bench.run(1);
            time_us += period_us;
            fastest = fastest.max(bench.dq[0].abs());
        }
        assert!(bench.faults().is_empty(), "{:?}", bench.faults());
        results.push((f64::from(time_us) * 1e-6, fastest));
    }
    for (time_s, fastest) in &results {
        let (expected_s, expected) = results[0];
        assert!((time_s - expected_s).abs() < 0.03, "{results:?}");
        assert!((fastest - expected).abs() < 0.02 * expected, "{results:?}");
    }
}

// Fails if a drive is accepted with a delay or a motor for which no gains are safe.
#[test]
fn a_drive_that_cannot_be_controlled_is_refused() {
    let mut controller = Controller::<7>::default();
    let refused = |controller: &mut Controller<7>, change: fn(&mut DriveHello)| {
        let mut hello = hello();
        change(&mut hello);
        controller.connect(&hello)
    };
    assert_eq!(refused(&mut controller, |h| h.latency_us = 6000), Err(Refusal::Drive));
    for inertia in [f64::NAN, -0.1, 51.0] {
        let mut hello = hello();
        hello.motor_kg_m2.push(inertia).expect("room");
        assert_eq!(controller.connect(&hello), Err(Refusal::Drive), "{inertia}");
    }
    assert_eq!(refused(&mut controller, |h| h.latency_us = 5000), Ok(()));
}
