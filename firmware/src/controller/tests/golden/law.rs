//! Every part of the law on every built-in arm, in postures all over their ranges.

use std::string::String;
use std::vec::Vec;

use nalgebra::{SVector, Vector3, Vector6};
use spherecal_shared::robot::{Arm, JointLimits, built_in, iiwa7_tool};

use super::row;
use crate::law::rotation_about;
use crate::law::{
    Actuation, CartesianSetpoint, Giving, Impedance, JointSetpoint, NullSpace, Observer, Snapshot, Stiffness,
    TorqueLoop, TorqueShaper, guide_torque, joint_spring, poles,
};
use crate::safety::Instability;
use crate::testing::{Digest, NO_LIMITS, random};

/// The rows: one of each built-in arm.
pub(super) const NAMES: &[&str] = &[
    "the law of iiwa7",
    "the law of iiwa14",
    "the law of panda",
    "the law of fr3",
    "the law of ur5e",
    "the law of ur10e",
    "the law of irb120",
];

const PERIOD_S: f64 = 1e-3;

pub(super) fn rows() -> Vec<(&'static str, String, u64)> {
    let of = |name: &'static str| {
        let arm = name.rsplit(' ').next().expect("a name");
        let dof = built_in(arm).expect("a built-in robot").dof();
        row(name, if dof == 7 { digest::<7>(arm) } else { digest::<6>(arm) })
    };
    NAMES.iter().map(|name| of(name)).collect()
}

/// Numbers that never repeat.
struct Draw(u64);

impl Draw {
    fn next(&mut self, size: f64) -> f64 {
        self.0 += 1;
        size * random(self.0)
    }

    fn array<const N: usize>(&mut self, size: f64) -> [f64; N] {
        core::array::from_fn(|_| self.next(size))
    }

    fn vector<const N: usize>(&mut self, size: f64) -> SVector<f64, N> {
        self.array(size).into()
    }
}

/// What lives from tick to tick.
struct State<const N: usize> {
    impedance: Impedance,
    observer: Observer<N>,
    shaper: TorqueShaper<N>,
    feedback: TorqueLoop<N>,
    instability: Instability<N>,
    motors: [f64; N],
}

fn digest<const N: usize>(name: &str) -> Digest {
    let mut robot = built_in(name).expect("a built-in robot");
    let mut draw = Draw(name.bytes().map(u64::from).sum::<u64>() << 32);
    for joint in &mut robot.joints {
        joint.rotor_kg_m2 = 0.2 + draw.next(0.2);
    }
    let limits: [JointLimits; N] = core::array::from_fn(|i| robot.joints[i].limits);
    let arm = Arm::<f64, N>::new(&robot, &iiwa7_tool()).expect("an arm");
    let mut digest = Digest::default();
    for (motor, latency_s) in [(0.0, 0.0), (0.3, 2e-3)] {
        let motors = core::array::from_fn(|i| motor * (1.0 + i as f64));
        let drive = Actuation::new(motors, PERIOD_S, latency_s);
        digest.numbers(&[drive.fastest_rad_s, drive.joint_rad_s]);
        let mut state = State {
            impedance: Impedance::new(Stiffness::isotropic(200.0, 150.0)),
            observer: Observer::default(),
            shaper: TorqueShaper::default(),
            feedback: TorqueLoop::default(),
            instability: Instability::default(),
            motors,
        };
        for k in 0..60 {
            let q: [f64; N] = core::array::from_fn(|i| {
                let (low, high) = (limits[i].min_rad, limits[i].max_rad);
                let angle = 0.5 * (low + high) + 0.5 * (high - low) * draw.next(1.02);
                // Of some the axes of several joints align, and of some the arm is stretched.
                if k % 9 == 0 && i % 2 == 1 { 0.0 } else { angle }
            });
            let dq = draw.array(1.2);
            let snapshot = Snapshot::on(&drive, &arm, &q, &dq).expect("a mass matrix");
            one(&mut digest, &snapshot, &limits, &mut state, &mut draw, k);
        }
    }
    digest
}

fn one<const N: usize>(
    digest: &mut Digest,
    snapshot: &Snapshot<N>,
    limits: &[JointLimits; N],
    state: &mut State<N>,
    draw: &mut Draw,
    k: u32,
) {
    digest.numbers(snapshot.jacobian.iter().chain(&snapshot.velocity));
    digest.numbers(snapshot.gravity.iter().chain(&snapshot.coriolis));
    digest.numbers(snapshot.momentum.iter().chain(&snapshot.transposed_coriolis));
    digest.numbers(snapshot.inertia.iter().chain(snapshot.mass.lower()));
    digest.numbers(snapshot.whitened.iter().chain(snapshot.mobility.lower()));
    digest.numbers(&[snapshot.fastest_rad_s, snapshot.joint_rad_s, snapshot.tcp_speed()]);
    digest.count(u64::from(snapshot.near_singular));
    digest.numbers(&snapshot.joint_torque(&draw.vector(20.0)));
    digest.numbers(&snapshot.task_force(&draw.vector(20.0)));
    digest.numbers(&snapshot.point_force(&draw.vector(20.0)));
    digest.numbers(&snapshot.reaction(&draw.vector(3.0)));

    // The stiffness always ramps, or has just ended to.
    if k.is_multiple_of(15) {
        let along: Vector3<f64> = draw.vector(1.0);
        let along = along / along.norm();
        let values = [50.0, 70.0, if k.is_multiple_of(2) { 100.0 } else { 2_000.0 }];
        let ramp_s = if k == 30 { 0.0 } else { 9.5 * PERIOD_S };
        state
            .impedance
            .ramp_to(Stiffness::about(values, &along, 200.0), ramp_s, PERIOD_S);
    }
    let axis: Vector3<f64> = draw.vector(1.0);
    let axis = axis / axis.norm();
    let angle = if k.is_multiple_of(5) {
        draw.next(1e-7)
    } else {
        draw.next(3.0)
    };
    let setpoint = CartesianSetpoint {
        position: snapshot.tcp.position + draw.vector(0.05),
        rotation: rotation_about(&axis, angle) * snapshot.tcp.rotation,
        velocity: draw.vector(0.3),
        acceleration: draw.vector(1.0),
        feed_forward: draw.vector(5.0),
    };
    digest.numbers(&state.impedance.force(snapshot, &setpoint, 0.7));
    digest.count(u64::from(state.impedance.settled()));
    digest.numbers(&state.impedance.seated_force(snapshot, &setpoint, 0.7));
    let force: Vector6<f64> = draw.vector(10.0);
    digest.numbers(&state.impedance.stiffness().times(&force));

    for null_space in [
        NullSpace::Elbow {
            angle: draw.next(4.0),
            rate: draw.next(0.5),
            acceleration: draw.next(1.0),
        },
        NullSpace::Posture(draw.array(2.0)),
        NullSpace::Free,
    ] {
        digest.numbers(&null_space.torque(snapshot, &[NO_LIMITS; N], 50.0, 0.7));
        digest.numbers(&[null_space.elbow_error(snapshot)]);
    }

    let near = |draw: &mut Draw, by: f64| JointSetpoint {
        q: core::array::from_fn(|i| snapshot.q[i] + draw.next(by)),
        dq: draw.array(0.5),
    };
    let hold = near(draw, 0.1);
    let torque = joint_spring(snapshot, &hold, 20.0, 0.9).torque;
    digest.numbers(&torque);
    let mut hold = near(draw, 0.03);
    digest.numbers(&guide_torque(snapshot, &mut hold, limits, 0.01));
    digest.numbers(hold.q.iter().chain(&hold.dq));
    let mut hold = near(draw, 0.1);
    let from = snapshot.tcp.position + draw.vector(0.08);
    Giving::new(from, 2.0).follow(snapshot, &(torque * 0.3), &mut hold, limits, 0.01);
    digest.numbers(&hold.q);

    let measured = draw.array(30.0);
    let wrench = state.observer.update(snapshot, &measured, 60.0, PERIOD_S);
    digest.numbers(
        wrench
            .force
            .iter()
            .chain(&wrench.torque)
            .chain(state.observer.residual()),
    );
    let exerted = state.feedback.exerted(&measured, &snapshot.dq, &state.motors, PERIOD_S);
    let poles = poles(&state.motors, 6.0, 10.0);
    let correction = *state.feedback.correction(&exerted, 6.0, &poles, 2.0, PERIOD_S);
    digest.numbers(exerted.iter().chain(&poles).chain(&correction));
    let torques = core::array::from_fn(|i| limits[i].torque_nm * 0.4);
    let (tau, shaped) = state.shaper.shape(&torque, &measured, &torques, 12.0, 1.0);
    state.feedback.sent(&tau);
    digest.numbers(&tau);
    digest.count(u64::from(shaped.saturated) * 2 + u64::from(shaped.rate_limited));

    let mean = core::array::from_fn(|i| 0.1 * snapshot.dq[i]);
    let wanted = draw.array(0.5);
    let wanted = k.is_multiple_of(2).then_some(&wanted);
    if let Some(found) = state.instability.check(snapshot, &mean, wanted, limits, PERIOD_S) {
        digest.count(u64::from(found.fault as u8) * 8 + u64::from(found.joint));
        digest.numbers(&[found.value, found.limit]);
    }
    if k % 20 == 19 {
        state.observer.reset();
        state.shaper.reset();
        state.feedback.reset();
        state.instability.reset();
    }
}
