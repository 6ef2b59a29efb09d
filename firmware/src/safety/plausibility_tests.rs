//! Jumps, frozen drives and encoders that stick.

use super::*;
use spherecal_shared::robot::iiwa7;

fn joints() -> [JointLimits; 7] {
    core::array::from_fn(|i| iiwa7().joints[i].limits)
}

fn at(q: f64, tau: f64) -> JointState<7> {
    JointState {
        q: [q; 7],
        dq: [0.0; 7],
        tau: [tau; 7],
    }
}

// Fails if a motion counts as a jump or a jump as motion, or if an implausible
// state replaces the last good one.
#[test]
fn an_angle_cannot_jump() {
    let limits = Limits::default();
    let mut watch = Plausibility::default();
    let mut look = |tick, q, tau| watch.check(tick, &at(q, tau), &[0.0; 7], &joints(), &limits, 1e-3);
    assert_eq!(look(1, 0.0, 1.0), None);
    assert_eq!(look(2, 0.003, 1.1), None);
    let jump = look(3, 0.1, 1.0).expect("a jump");
    assert_eq!((jump.fault, jump.joint), (Fault::PositionJump, 1));
    assert!((jump.value - 0.097).abs() < 1e-12);
    assert_eq!(look(4, 0.006, 1.0), None, "back where it was");
    // After 100 ms without a state the arm may be elsewhere.
    assert_eq!(look(104, 0.1, 1.0), None);
    // While it is seen it cannot be.
    assert!((105..1000).all(|tick| look(tick, 0.2, 1.0).is_some()));
}

// Fails if the way that an arm can go in a time has another size than its speed allows,
// by the joint's limit or by its own higher speed before.
#[test]
fn an_angle_may_change_by_speed_times_time() {
    let (limits, joints) = (Limits::default(), joints());
    let moved = |from: &JointState<7>, by: f64| jump(from, &at(by, 0.0), 0.1, &joints, &limits);
    let most = joints[0].velocity_rad_s * SPEED_FACTOR * 0.1 + limits.jump_rad;
    let found = moved(&at(0.0, 0.0), 1.001 * most).expect("a jump");
    assert_eq!((found.joint, found.limit), (1, most));
    assert!(moved(&at(0.0, 0.0), 0.999 * most).is_none_or(|found| found.joint > 1));
    let mut fast = at(0.0, 0.0);
    fast.dq = joints.map(|joint| 3.0 * joint.velocity_rad_s);
    let most = 3.0 * joints[0].velocity_rad_s * SPEED_FACTOR * 0.1 + limits.jump_rad;
    assert_eq!(moved(&fast, 1.001 * most).map(|found| found.limit), Some(most));
    // A speed counts up to twenty times the limit.
    fast.dq = joints.map(|joint| -30.0 * joint.velocity_rad_s);
    let most = 20.0 * joints[0].velocity_rad_s * SPEED_FACTOR * 0.1 + limits.jump_rad;
    assert_eq!(moved(&fast, 1.001 * most).map(|found| found.limit), Some(most));
}

// Fails if one false angle after a gap becomes the place from which all true angles
// are jumps, or if an arm that stays away after the gap may come back at once.
#[test]
fn one_false_angle_after_a_gap_is_forgotten() {
    let limits = Limits::default();
    let run = |away: u64| {
        let mut watch = Plausibility::default();
        let mut look = |tick, q| watch.check(tick, &at(q, tick as f64), &[0.0; 7], &joints(), &limits, 1e-3);
        assert_eq!(look(1, 0.0), None);
        assert!((5..5 + away).all(|tick| look(tick, 0.012).is_none()));
        look(5 + away, 0.0)
    };
    assert_eq!(run(1), None);
    assert_eq!(run(2).map(|found| found.fault), Some(Fault::PositionJump));
}

// Fails if a false angle that an absurd speed before it made room for becomes the place from which all true angles are jumps.
#[test]
fn one_false_angle_after_a_false_speed_is_forgotten() {
    let limits = Limits::default();
    let mut watch = Plausibility::default();
    let mut look = |tick, q, dq| {
        let state = JointState {
            dq: [dq; 7],
            ..at(q, tick as f64)
        };
        watch.check(tick, &state, &[0.0; 7], &joints(), &limits, 1e-3)
    };
    assert_eq!(look(1, 0.0, 0.0), None);
    assert_eq!(look(2, 0.0, 999.0), None);
    assert_eq!(look(3, 0.03, 0.0), None, "by twenty times the limit");
    assert_eq!(look(4, 0.0, 0.0), None);
    assert_eq!(look(5, 0.03, 0.0).map(|found| found.fault), Some(Fault::PositionJump));
}

// Fails if a false angle that is just not a jump becomes a place from which true angles are jumps, because of their noise.
#[test]
fn one_false_angle_at_the_limit_is_forgotten() {
    let (limits, joints) = (Limits::default(), joints());
    let slowest = joints
        .iter()
        .map(|joint| joint.velocity_rad_s)
        .fold(f64::INFINITY, f64::min);
    let most = slowest * SPEED_FACTOR * 1e-3 + limits.jump_rad;
    let mut watch = Plausibility::default();
    let mut look = |tick, q| watch.check(tick, &at(q, tick as f64), &[0.0; 7], &joints, &limits, 1e-3);
    assert_eq!(look(1, 1e-6), None);
    assert_eq!(look(2, most), None);
    assert_eq!(look(3, -1e-6), None, "back where it was");
    assert_eq!(look(4, most).map(|found| found.fault), Some(Fault::PositionJump));
}

// Fails if a frozen drive is not found in time, or if a simulator without
// noise that stands under the same torque is taken for one.
#[test]
fn a_frozen_drive_is_noticed_and_a_still_one_is_not() {
    let limits = Limits::default();
    let run = |torque: &dyn Fn(u64) -> f64, dq: f64| {
        let mut watch = Plausibility::default();
        (1..1000).find(|tick| {
            let mut state = at(1e-5 * (*tick).min(10) as f64, 1.0);
            state.dq = [dq; 7];
            watch
                .check(*tick, &state, &[torque(*tick); 7], &joints(), &limits, 1e-3)
                .is_some()
        })
    };
    let noticed = Some(11 + u64::from(limits.frozen_ticks));
    assert_eq!(run(&|tick| 0.001 * tick as f64, 0.0), noticed, "the torque changes");
    assert_eq!(run(&|_| 3.0, 0.1), noticed, "it says that it moves");
    assert_eq!(run(&|_| 3.0, 0.0), None, "it stands");
}

// Fails if an encoder that sticks while its joint is driven is not found, if a
// joint that stands under friction is taken for one, or if the ticks of an
// earlier standstill count.
#[test]
fn an_encoder_that_sticks_is_noticed() {
    let limits = Limits::default();
    let run = |torque: &dyn Fn(u64) -> f64, stands: &dyn Fn(u64) -> bool| {
        let mut watch = Plausibility::default();
        let mut q4 = 0.0;
        (1..1000).find_map(|tick| {
            let mut state = at(1e-5 * tick as f64, 1.0);
            q4 = if stands(tick) { q4 } else { state.q[3] };
            state.q[3] = q4;
            let mut sent = [0.0; 7];
            sent[3] = torque(tick);
            let found = watch.check(tick, &state, &sent, &joints(), &limits, 1e-3)?;
            assert_eq!((found.fault, found.joint), (Fault::StaleState, 4));
            Some(tick)
        })
    };
    let most = STUCK_NM.max(STUCK_SHARE * iiwa7().joints[3].limits.torque_nm);
    let ramp = |tick: u64| 0.5 * tick as f64;
    let noticed = run(&ramp, &|tick| tick >= 100).expect("noticed");
    assert_eq!(noticed, 100 + (most / 0.5).floor() as u64 + 1);
    assert_eq!(run(&|tick| 0.9 * most * (tick % 2) as f64, &|tick| tick >= 100), None);
    assert_eq!(run(&ramp, &|tick| tick % 20 > 0), None, "it moves now and then");
}

// Fails if an arm whose drive was frozen may reappear farther away than its speed and the frozen
// time allow, or nearer; the time counts up to 0.5 s. A drive that stood was not frozen.
#[test]
fn a_frozen_drive_may_have_moved_for_half_a_second() {
    let limits = Limits {
        frozen_ticks: 0,
        ..Limits::default()
    };
    let joints = [joints()[0]; 7];
    let speed = joints[0].velocity_rad_s;
    let reappears = |ticks: u64, moving: f64, period_s: f64, by: f64| {
        let mut watch = Plausibility::default();
        let mut state = at(0.0, 1.0);
        state.dq = [moving; 7];
        for tick in 1..=1 + ticks {
            assert_eq!(watch.check(tick, &state, &[0.0; 7], &joints, &limits, period_s), None);
        }
        let found = watch.check(2 + ticks, &at(by, 1.1), &[0.0; 7], &joints, &limits, period_s);
        found.map(|found| found.limit)
    };
    for (ticks, moving, period_s, counted) in [
        (0, 0.1, 1e-3, 0.001),
        (1, 0.1, 1e-3, 0.002),
        (100, 0.1, 1e-3, 0.101),
        (100, 0.0, 1e-3, 0.001),
        (499, 0.1, 1e-3, 0.500),
        (900, 0.1, 1e-3, 0.501),
        (900, 0.1, 2e-3, 0.502),
    ] {
        let most = speed * 1.5 * counted + limits.jump_rad;
        assert_eq!(reappears(ticks, moving, period_s, most - 1e-9), None, "{ticks} ticks");
        let limit = reappears(ticks, moving, period_s, most + 1e-9).expect("a jump");
        assert!((limit - most).abs() < 1e-12, "{ticks} ticks: {limit} is not {most}");
    }
}

// Fails if a value that equals its bound is implausible, or the next one beyond it is not.
#[test]
fn what_equals_its_bound_is_plausible() {
    let (limits, joints) = (Limits::default(), joints());
    let next = |x: f64| x * (1.0 + f64::EPSILON);
    let jumps = |by: f64| jump(&at(0.0, 0.0), &at(by, 0.0), 0.0, &joints, &limits).is_some();
    assert!(!jumps(limits.jump_rad) && jumps(-next(limits.jump_rad)));
    // A drive that repeats its state for longer than it may.
    let frozen = |torque: f64, speed: f64| {
        let mut watch = Plausibility::default();
        let mut state = at(0.0, 1.0);
        state.dq[2] = speed;
        (1..100).find(|tick| {
            let mut sent = [0.0; 7];
            sent[3] = if *tick > 2 { -torque } else { 0.0 };
            watch.check(*tick, &state, &sent, &joints, &limits, 1e-3).is_some()
        })
    };
    assert_eq!(frozen(TORQUE_CHANGE_NM, MOVES_RAD_S), None);
    assert_eq!(frozen(next(TORQUE_CHANGE_NM), 0.0), Some(22));
    assert_eq!(frozen(0.0, next(MOVES_RAD_S)), Some(22));
    let stuck = |torque: f64, joint: &JointLimits| {
        let mut stuck = (0, 0.0);
        (1..100).find(|tick| {
            let sent = [if *tick > 1 { torque } else { 0.0 }; 7];
            stuck_encoder(&mut stuck, 6, 0.0, &sent, joint, &limits).is_some()
        })
    };
    let small = &joints[6];
    assert_eq!(
        (stuck(STUCK_NM, small), stuck(-next(STUCK_NM), small)),
        (None, Some(21))
    );
    let mut strong = joints[6];
    strong.torque_nm = 400.0;
    assert_eq!((stuck(20.0, &strong), stuck(-next(20.0), &strong)), (None, Some(21)));
}
