//! The loop on rigid arms.

use nalgebra::{Matrix3, SMatrix, SVector, Vector3, Vector6};
use spherecal_shared::procedure::Law;
use spherecal_shared::robot::{Arm, Dynamics, built_in, iiwa7_tool};

use crate::{
    Actuation, Axes, CartesianSetpoint, Goal, ImpedanceLoop, JointSetpoint, LawError, Output, Stiffness, rotation_error,
};

pub(crate) const PERIOD_S: f64 = 1e-3;

/// A rigid arm under a loop.
pub(crate) struct Bench<const N: usize> {
    arm: Arm<f64, N>,
    pub(crate) control: ImpedanceLoop<N>,
    q: SVector<f64, N>,
    dq: SVector<f64, N>,
    torque: SVector<f64, N>,
    gravity_by_drive: bool,
}

impl<const N: usize> Bench<N> {
    pub(crate) fn new(name: &str, q: [f64; N], gravity_by_drive: bool) -> Self {
        let (robot, tool) = (built_in(name).expect("a built-in robot"), iiwa7_tool());
        let arm = Arm::new(&robot, &tool).expect("an arm");
        let (law, drive) = (Law::default(), Actuation::default());
        let mut control =
            ImpedanceLoop::new(&robot, &tool, law, drive, gravity_by_drive, PERIOD_S).expect("the defaults");
        control
            .set_stiffness(Stiffness::isotropic(400.0, 30.0), Axes::Base)
            .expect("a stiffness");
        Self {
            torque: arm.bodies(&arm.frames(&q)).gravity(),
            arm,
            control,
            q: q.into(),
            dq: SVector::zeros(),
            gravity_by_drive,
        }
    }

    /// One cycle under a wrench (F0, at the TCP).
    pub(crate) fn step(&mut self, push: &Vector6<f64>) -> Output<N> {
        let (q, dq) = (self.q.into(), self.dq.into());
        let out = self.control.step(&q, &dq, &self.torque.into()).expect("finite");
        let frames = self.arm.frames(&q);
        let bodies = self.arm.bodies(&frames);
        self.torque = out.torque.into();
        if self.gravity_by_drive {
            self.torque += bodies.gravity();
        }
        let jacobian: SMatrix<f64, 6, N> = self.arm.jacobian(&frames, &out.tcp.position);
        let free = self.torque + jacobian.transpose() * push - bodies.gravity() - bodies.coriolis(&dq);
        let acceleration = bodies.mass_matrix().cholesky().expect("a mass matrix").solve(&free);
        self.dq += acceleration * PERIOD_S;
        self.q += self.dq * PERIOD_S;
        out
    }

    pub(crate) fn run(&mut self, cycles: u32, push: &Vector6<f64>) -> Output<N> {
        for _ in 1..cycles {
            self.step(push);
        }
        self.step(push)
    }

    /// Kinetic energy, in J.
    pub(crate) fn kinetic_j(&self) -> f64 {
        let bodies = self.arm.bodies(&self.arm.frames(&self.q.into()));
        0.5 * self.dq.dot(&(bodies.mass_matrix() * self.dq))
    }
}

pub(crate) const IIWA: [f64; 7] = [0.0, 0.7, 0.0, -1.2, 0.0, 1.24, 0.0];
pub(crate) const UR: [f64; 6] = [0.1, -1.2, 1.5, -1.4, -1.5, 0.2];

/// Checks the deflection under a force and a moment, the wrench, and that the arm returns.
fn renders<const N: usize>(name: &str, q: [f64; N], gravity_by_drive: bool) {
    let mut bench = Bench::new(name, q, gravity_by_drive);
    let none = Vector6::zeros();
    let start = bench.run(200, &none).tcp;
    let push = Vector6::new(4.0, -6.0, 5.0, 0.6, -0.3, 0.9);
    let out = bench.run(3_000, &push);
    let moved = out.tcp.position - start.position;
    let turned = rotation_error(&out.tcp.rotation, &start.rotation);
    assert!((moved * 400.0 - push.xyz()).norm() < 0.05, "{name}: {moved}");
    assert!(
        (turned * 30.0 - Vector3::new(0.6, -0.3, 0.9)).norm() < 0.01,
        "{name}: {turned}"
    );
    assert!(
        (out.wrench.force - push.xyz()).norm() < 0.05,
        "{name}: {}",
        out.wrench.force
    );
    let back = bench.run(3_000, &none).tcp;
    assert!((back.position - start.position).norm() < 2e-5);
}

// Fails if the loop renders another stiffness than the one that is set, in translation or rotation, feels another
// wrench than the true one, or counts gravity twice or never: seven and six joints, with and without a drive that
// carries gravity.
#[test]
fn the_loop_renders_its_stiffness() {
    renders("iiwa7", IIWA, false);
    renders("fr3", [0.0, -0.3, 0.1, -2.0, 0.0, 1.8, 0.4], true);
    renders("ur5e", UR, false);
}

// Fails if a setpoint that moves is followed with a lag, as with a damper on the velocity alone.
#[test]
fn a_streamed_path_is_followed() {
    let mut bench = Bench::new("iiwa7", IIWA, false);
    let none = Vector6::zeros();
    let start = bench.run(200, &none).tcp;
    let mut off = 0.0f64;
    for cycle in 1..=2_000 {
        let mut goal = CartesianSetpoint::at(start.position, start.rotation);
        goal.position.z += 0.025 * f64::from(cycle) * PERIOD_S;
        goal.velocity[2] = 0.025;
        bench.control.goal = Some(Goal::Pose(goal));
        let out = bench.step(&none);
        if cycle > 1_500 {
            off = off.max((out.tcp.position - goal.position).norm());
        }
    }
    assert!(off < 1e-4, "{off} m");
}

// Fails if joint impedance misses its angles, rings, or lets a torque jump as it takes over from the Cartesian spring.
#[test]
fn joints_follow_their_goal() {
    let mut bench = Bench::new("ur5e", UR, false);
    bench.run(100, &Vector6::zeros());
    let q = UR.map(|q| q + 0.05);
    let setpoint = JointSetpoint { q, dq: [0.0; 6] };
    let natural_rad_s = 10.0;
    bench.control.goal = Some(Goal::Joints {
        setpoint,
        natural_rad_s,
    });
    let (mut beyond, mut last) = (0.0f64, bench.torque);
    for _ in 0..2_000 {
        bench.step(&Vector6::zeros());
        assert!((bench.torque - last).amax() < 4.001);
        last = bench.torque;
        beyond = beyond.max((bench.q - SVector::from(q)).max());
    }
    assert!((bench.q - SVector::from(q)).amax() < 1e-4, "{}", bench.q);
    assert!(beyond < 0.008, "{beyond} of 0.05 rad");
}

// Fails if a state that is not finite changes anything, or gives a torque.
#[test]
fn a_state_that_is_not_finite_changes_nothing() {
    let mut bench = Bench::new("iiwa7", IIWA, false);
    let push = Vector6::new(1.0, 0.0, 0.0, 0.0, 0.0, 0.0);
    bench.run(100, &push);
    let (q, dq, torque): ([f64; 7], [f64; 7], [f64; 7]) = (bench.q.into(), bench.dq.into(), bench.torque.into());
    let mut twin = bench.control.clone();
    for bad in [f64::NAN, f64::INFINITY] {
        let spoilt = [q[0], bad, q[2], q[3], q[4], q[5], q[6]];
        assert!(twin.step(&spoilt, &dq, &torque).is_none());
        assert!(twin.step(&q, &spoilt, &torque).is_none());
        assert!(twin.step(&q, &dq, &spoilt).is_none());
    }
    let (own, other) = (bench.control.step(&q, &dq, &torque), twin.step(&q, &dq, &torque));
    assert_eq!(own.expect("finite").torque, other.expect("finite").torque);
}

// Fails if a stiffness that no spring has is taken, or one at the ends of the range is refused.
#[test]
fn impossible_stiffnesses_are_refused() {
    let mut control = Bench::new("iiwa7", IIWA, false).control;
    let skew = Vector3::new(1.0, 2.0, 3.0).cross_matrix() * 50.0;
    let diagonal = |x: f64| Matrix3::from_diagonal(&Vector3::new(x, 400.0, 0.0));
    let along = Vector3::new(0.6, 0.0, 0.8);
    let wide = along * along.transpose();
    for (translation, rotation, field) in [
        (diagonal(5000.0), 300.0, None),
        (diagonal(0.0), 0.0, None),
        (wide * 5000.0, 10.0, None),
        (wide * 5001.0, 10.0, Some("translation")),
        (wide * -1.0, 10.0, Some("translation")),
        (diagonal(400.0) + skew, 10.0, Some("translation")),
        (diagonal(f64::NAN), 10.0, Some("translation")),
        (diagonal(400.0), 300.1, Some("rotation")),
        (diagonal(400.0), f64::NAN, Some("rotation")),
    ] {
        let refused = match control.set_stiffness(Stiffness { translation, rotation }, Axes::Base) {
            Err(LawError::Stiffness { field, .. }) => Some(field),
            _ => None,
        };
        assert_eq!(refused, field, "{translation} {rotation}");
    }
}
