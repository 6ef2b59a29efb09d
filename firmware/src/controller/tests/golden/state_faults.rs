//! Drive states that are late, frozen, false or beyond a limit.

use nalgebra::Vector3;
use spherecal_shared::protocol::drive::{DriveState, DriveStatus};
use spherecal_shared::protocol::host::Phase;
use spherecal_shared::robot::iiwa7;

use super::starts::{at, described, idle_by, procedure};
use super::{Scenario, recover};
use crate::testing::Bench;

pub(super) const ALL: &[Scenario] = &[
    ("a state that is repeated three times", || repeated(3)),
    ("a state that is repeated four times", || repeated(4)),
    ("a state that is repeated until the brakes close", || repeated(30)),
    ("three states are missing", || missing(3)),
    ("four states are missing", || missing(4)),
    ("states that are not numbers", || {
        let mut bench = at(Phase::Moving);
        bench.run_with(3, |_, state| state.q[2] = f64::NAN);
        bench.run(20);
        bench.run_with(2, |_, state| state.dq[0] = f64::NEG_INFINITY);
        bench.run_with(2, |_, state| {
            state.tau.pop();
        });
        recover(bench)
    }),
    ("the largest values of any arm, and larger ones", || {
        let mut bench = at(Phase::Idle);
        bench.run_with(2, |k, state| state.tau[3] = 1e5 + f64::from(k));
        bench.run(20);
        bench.run_with(3, |k, state| state.dq[5] = -1e3 - f64::from(k));
        bench.run(20);
        bench.run_with(5, |k, state| state.q[6] = 1e4 + f64::from(k));
        recover(bench)
    }),
    ("states that are late by less than they may", || late(3_499, 5)),
    ("states that are late by three", || late(3_501, 3)),
    ("states that are late", || late(3_600, 30)),
    ("clocks that drift apart", || {
        let mut bench = at(Phase::Idle);
        bench.lag_us = 20_000;
        for _ in 0..4_200 {
            bench.lag_us += 1;
            bench.run(1);
        }
        for _ in 0..6_000 {
            bench.lag_us += 2;
            bench.run(1);
        }
        recover(bench)
    }),
    ("a drive that freezes in a motion", || frozen(at(Phase::Moving), 30)),
    ("a drive that freezes for a while", || frozen(at(Phase::Moving), 15)),
    ("a drive that freezes for long", || frozen(at(Phase::Moving), 700)),
    ("a drive that freezes while it stands", || {
        let mut bench = at(Phase::Idle);
        bench.noise = 0.0;
        bench.run(400);
        frozen(bench, 100)
    }),
    ("an encoder that sticks", || {
        let mut bench = at(Phase::Moving);
        let angle = bench.q[0];
        bench.run_with(400, |_, state| state.q[0] = angle);
        recover(bench)
    }),
    ("an angle that jumps three times", || jumped(3, 0.1)),
    ("an angle that jumps four times", || jumped(4, -0.1)),
    ("a small jump", || jumped(10, 0.0046)),
    ("one false angle after a gap", || {
        let mut bench = at(Phase::Idle);
        bench.tick += 3;
        bench.run_with(1, |_, state| state.q[3] += 0.009);
        bench.run(100);
        bench.tick += 3;
        bench.run_with(6, |_, state| state.q[3] += 0.009);
        recover(bench)
    }),
    ("a joint beyond its end", || beyond(|bench| bench.q[1] = -2.1)),
    ("a joint beyond its other end", || beyond(|bench| bench.q[1] = 2.2)),
    ("a joint that leaves through its margin", || {
        let mut bench = described(|robot| robot.joints[0].limits.max_rad = 0.005, procedure());
        bench.dq[0] = 0.05;
        bench.run(100);
        recover(bench)
    }),
    ("a joint that rests in its margin", || {
        let mut bench = described(|robot| robot.joints[4].limits.min_rad = -0.005, procedure());
        bench.dq[4] = -0.015;
        bench.run(300);
        bench
    }),
    ("a joint that is too fast", || beyond(|bench| bench.dq[4] = -2.4)),
    ("a joint that is faster than it can be", || {
        beyond(|bench| bench.dq[6] = 4.0)
    }),
    ("an arm with too much energy", || {
        beyond(|bench| {
            bench.dq[0] = 1.5;
            bench.dq[1] = -1.5;
            bench.dq[3] = 1.5;
        })
    }),
    ("a hold that oscillates", || {
        let mut bench = at(Phase::Idle);
        bench.delay = 8;
        bench.push.x += 0.5;
        bench.run(1_500);
        bench.delay = 0;
        recover(bench)
    }),
    ("a motion that oscillates", || {
        let mut bench = at(Phase::Moving);
        bench.delay = 7;
        bench.run(1_000);
        bench.delay = 0;
        recover(bench)
    }),
    ("a force for ten milliseconds", || forced(18, 150.0)),
    ("a force that lasts", || forced(200, -150.0)),
    ("a torque at its limit", || {
        let mut bench = described(|robot| robot.joints[1].limits.torque_nm = 12.0, procedure());
        bench.run(200);
        recover(bench)
    }),
    ("a motor that gives less", || torque(1, -32.0, 400)),
    ("a motor that gives more", || torque(3, 18.0, 400)),
    ("a motor that almost gives its torque", || torque(1, -20.0, 400)),
    ("a wrist motor that gives less", || torque(5, -11.0, 25)),
    ("a drive that is disabled", || status(DriveStatus::Disabled)),
    ("an emergency stop", || status(DriveStatus::EmergencyStop)),
    ("a drive that has failed", || status(DriveStatus::Failed)),
    ("periods that are missed", || {
        let mut bench = at(Phase::Coupled);
        for ticks in [2, 0, 1, 2, 0, 2, 2] {
            bench.controller.record_missed(ticks);
            bench.run(3);
        }
        recover(bench)
    }),
    ("a procedure that allows no missing state", || {
        let mut procedure = procedure();
        procedure.limits.missed_ticks = 0;
        procedure.limits.frozen_ticks = 0;
        let mut bench = idle_by(procedure);
        let state = bench.state();
        bench.run_with(40, |_, spoilt| *spoilt = values_of(&state, spoilt));
        bench.tick_with(&state);
        recover(bench)
    }),
];

/// The values of `old` under the tick of `new`.
fn values_of(old: &DriveState, new: &DriveState) -> DriveState {
    DriveState {
        tick: new.tick,
        ..old.clone()
    }
}

fn repeated(times: u32) -> Bench {
    let mut bench = at(Phase::Moving);
    let state = bench.state();
    for _ in 0..times {
        bench.tick_with(&state);
    }
    recover(bench)
}

fn missing(ticks: u64) -> Bench {
    let mut bench = at(Phase::Moving);
    bench.tick += ticks;
    recover(bench)
}

fn late(by_us: u64, times: u32) -> Bench {
    let mut bench = at(Phase::Moving);
    bench.lag_us = by_us;
    bench.run(times);
    bench.lag_us = 0;
    recover(bench)
}

fn frozen(mut bench: Bench, ticks: u32) -> Bench {
    let state = bench.state();
    bench.run_with(ticks, |_, spoilt| *spoilt = values_of(&state, spoilt));
    recover(bench)
}

fn jumped(times: u32, by: f64) -> Bench {
    let mut bench = at(Phase::Moving);
    bench.run_with(times, |_, state| state.q[1] += by);
    recover(bench)
}

fn beyond(change: fn(&mut Bench)) -> Bench {
    let mut procedure = procedure();
    procedure.limits.jump_rad = 10.0;
    let mut bench = idle_by(procedure);
    change(&mut bench);
    bench.run(60);
    recover(bench)
}

fn forced(ticks: u32, newton: f64) -> Bench {
    let mut bench = at(Phase::Idle);
    bench.push += Vector3::new(newton, 0.0, 0.2 * newton);
    bench.run(ticks);
    bench.push = Vector3::zeros();
    recover(bench)
}

fn torque(joint: usize, by: f64, ticks: u32) -> Bench {
    let mut bench = at(Phase::Idle);
    assert!(by.abs() < iiwa7().joints[joint].limits.torque_nm);
    bench.torque_bias[joint] += by;
    bench.run(ticks);
    bench.torque_bias[joint] -= by;
    recover(bench)
}

fn status(status: DriveStatus) -> Bench {
    let mut bench = at(Phase::Moving);
    bench.status = status;
    bench.run(40);
    bench.status = DriveStatus::Ready;
    recover(bench)
}
