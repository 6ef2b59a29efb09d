//! The guards, the contact and the recorder under many values about their limits.

use std::string::String;
use std::vec::Vec;

use nalgebra::{SMatrix, SVector, Vector3, Vector6};
use spherecal_shared::procedure::{Approach, Limits, Seating};
use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

use super::row;
use crate::contact::{ContactTrigger, SeatingWatch};
use crate::law::{Shaped, Snapshot};
use crate::recorder::{Recorder, RecorderSample};
use crate::safety::{Ends, JointState, Pressing, SafetyMonitor, Touch, Violation};
use crate::testing::{Digest, HOME, random};

pub(super) const NAMES: &[&str] = &[
    "joints about their limits",
    "a TCP about its limits",
    "torques about their limits",
    "forces about their limits",
    "presses of every size and length",
    "contacts of every size and length",
    "a nest that moves",
    "recordings",
];

const PERIOD_S: f64 = 1e-3;

pub(super) fn rows() -> Vec<(&'static str, String, u64)> {
    let runs: [fn(&mut Digest); 8] = [joints, tcp, torques, forces, presses, contacts, nest, recordings];
    NAMES
        .iter()
        .zip(runs)
        .map(|(name, run)| {
            let mut digest = Digest::default();
            run(&mut digest);
            row(name, digest)
        })
        .collect()
}

fn add(digest: &mut Digest, found: Option<Violation>) {
    digest.count(found.map_or(0, |v| 1 + u64::from(v.fault as u8) * 8 + u64::from(v.joint)));
    if let Some(found) = found {
        digest.numbers(&[found.value, found.limit]);
    }
}

fn monitor() -> SafetyMonitor<7> {
    let mut monitor = SafetyMonitor::default();
    let robot = iiwa7().driven().expect("seven joints");
    monitor.configure(&robot, None).expect("the built-in robot");
    monitor
}

fn joints(digest: &mut Digest) {
    let (monitor, limits) = (monitor(), Limits::default());
    for k in 0..3_000 {
        let mut state = JointState {
            q: HOME,
            dq: [0.0; 7],
            tau: [0.0; 7],
        };
        let (i, side) = (k as usize % 7, if random(k) > 0.0 { 1.0 } else { -1.0 });
        let joint = iiwa7().joints[i].limits;
        state.q[i] = side * (joint.max_rad + 0.015 * random(k + 10_000));
        state.dq[i] = if k % 3 == 0 {
            joint.velocity_rad_s * (0.9 + 0.1 * random(k + 20_000)) * -side
        } else {
            0.04 * random(k + 20_000)
        };
        if k % 3 == 0 {
            state.q[i] *= 0.5;
        }
        for ends in [Ends::Keep, Ends::Return, Ends::Leave] {
            add(digest, monitor.joint_state(&state, &limits, ends));
        }
        for margin in [0.0, 0.01] {
            digest.count(u64::from(monitor.reachable(&state.q, margin)));
        }
    }
}

fn tcp(digest: &mut Digest) {
    let limits = Limits {
        workspace_min_m: [-1.0, -1.0, -0.5],
        workspace_max_m: [1.0, 1.0, 2.0],
        plate_normal: [0.6, 0.0, 0.8],
        plate_offset_m: 0.1,
        ..Limits::default()
    };
    let mut monitor = monitor();
    for k in 0..6_000 {
        // A place and a velocity for nine ticks.
        let at = k / 9 * 6;
        let place = Vector3::new(1.02 * random(at), 1.02 * random(at + 1), 0.75 + 1.3 * random(at + 2));
        let speed = if k.is_multiple_of(2) { 1.0 } else { 0.01 };
        let velocity = Vector6::from_fn(|i, _| speed * random(at + 3 + i as u64));
        add(digest, monitor.parts().1.tcp(&place, &velocity, &limits, PERIOD_S));
        let speed = 1.3 + 0.1 * random(at + 3);
        let inside = Vector3::new(0.0, 0.0, 0.75);
        let velocity = Vector6::new(0.0, speed, 0.0, 1.0, 1.0, 1.0);
        if k % 9 < 8 {
            add(digest, monitor.parts().1.tcp(&inside, &velocity, &limits, PERIOD_S));
        }
    }
}

fn torques(digest: &mut Digest) {
    let mut monitor = monitor();
    for k in 0..6_000 {
        let at = k / 25 * 7;
        let sent = [3.0; 7];
        let delivered = core::array::from_fn(|i| 3.0 + 31.0 * random(at + i as u64));
        let (joints, envelope) = monitor.parts();
        add(
            digest,
            envelope.torque(&sent, &delivered, joints, &Limits::default(), PERIOD_S),
        );
    }
}

fn forces(digest: &mut Digest) {
    let mut monitor = monitor();
    for k in 0..6_000 {
        let at = k / 13;
        let force = Vector3::new(0.6, 0.0, -0.8) * (100.0 + 4.0 * random(at));
        let shaped = Shaped {
            saturated: if k % 200 < 60 { 1 + (at % 7) as u8 } else { 0 },
            rate_limited: false,
        };
        add(digest, monitor.watch(&force, &shaped, &Limits::default(), PERIOD_S));
    }
}

fn presses(digest: &mut Digest) {
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
    let snapshot = Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix");
    let touches = [
        Touch::Rest,
        Touch::Free,
        Touch::Seated,
        Touch::Free,
        Touch::Leaving(60),
        Touch::Wanted,
    ];
    let mut guard = Pressing::default();
    for k in 0..12_000_u64 {
        let at = k / 70;
        let touch = touches[(k / 333 % 6) as usize];
        let size = match touch {
            Touch::Rest => 9.0,
            Touch::Free => 17.0,
            _ => 38.0,
        };
        let force = Vector3::from_fn(|i, _| 0.6 * size * random(3 * at + i as u64) + 2.0);
        let bias = SVector::<f64, 7>::from_fn(|i, _| 2.0 * random(7 * at + i as u64));
        let external = snapshot.jacobian.fixed_rows::<3>(0).transpose() * force + bias;
        add(digest, guard.check(touch, &snapshot, &force, &external, PERIOD_S));
        digest.numbers(&[guard.rest_n()]);
    }
}

fn contacts(digest: &mut Digest) {
    let mut trigger = ContactTrigger::default();
    for k in 0..6_000 {
        let at = k / 17;
        let force = if random(at) > 0.6 { 7.5 } else { 7.5 + random(at) };
        let speed = 0.01 + 0.002 * random(at + 5_000).min(0.0);
        let found = trigger.push(force, speed, &Approach::default(), 60.0, PERIOD_S);
        digest.count(u64::from(found) * 1_000 + u64::from(trigger.latency_ticks()));
        digest.count(u64::from(trigger.early_crossings()));
        digest.numbers(&[trigger.peak_n()]);
    }
}

fn nest(digest: &mut Digest) {
    let at = |k: u64, size: f64| SMatrix::<f64, 6, 7>::from_fn(|r, c| size * random(k * 42 + r as u64 * 7 + c as u64));
    let mut watch = SeatingWatch::new(Vector3::new(0.1, 0.2, 0.3), &at(0, 0.5));
    for k in 0..4_000 {
        let jacobian = at(0, 0.5) + at(1, 1e-5) * (k % 500) as f64;
        let tcp = watch.centre() + Vector3::from_fn(|i, _| 0.0036 * random(k / 14 * 3 + i as u64));
        let speed = 0.015 + 0.002 * random(k / 14 + 9_000);
        let found = watch.push(&tcp, speed, &jacobian, &Seating::default(), PERIOD_S);
        digest.count(u64::from(found.is_some()));
        digest.numbers(found.as_slice());
    }
}

fn recordings(digest: &mut Digest) {
    for count in [1, 2, 57] {
        let mut recorder = Recorder::<2>::default();
        for k in 0..count {
            let tick = k + k / 9 * 2;
            recorder.push(&RecorderSample {
                tick,
                time_us: tick * 1_000 + 7,
                q: &[random(k), 2.0 + 1e-5 * random(k + 1)],
                tau: &[random(k + 2), 30.0 + random(k + 3)],
                tcp: &Vector3::from_fn(|i, _| 0.5 + 1e-4 * random(3 * k + i as u64)),
                force: &Vector3::from_fn(|i, _| random(5 * k + i as u64)),
            });
        }
        digest.event(&spherecal_shared::protocol::host::Event::Recording(
            recorder.finish(4, 5),
        ));
    }
}
