//! The law against explicit inverses, numeric derivatives and closed forms.
//!
//! The law solves with factors of the mass matrix, in few instructions. These tests invert the
//! matrices instead, and move the arm a little.

use nalgebra::{Matrix3, Matrix6, SMatrix, SVector, Vector3, Vector6};
use spherecal_shared::robot::elbow::elbow;
use spherecal_shared::robot::{Arm, Dynamics, JointLimits, built_in, iiwa7_tool};

use super::damping::Damping;
use super::{
    Actuation, CartesianSetpoint, Giving, Impedance, JointSetpoint, NullSpace, Snapshot, Stiffness, guide_torque,
    rotation_about, rotation_error,
};
use crate::testing::{HOME, NO_LIMITS, random};

/// The built-in arm in some posture and motion, with what the tests compute themselves.
struct Case {
    arm: Arm<f64, 7>,
    limits: [JointLimits; 7],
    snapshot: Snapshot<7>,
    inverse_mass: SMatrix<f64, 7, 7>,
    /// `J M⁻¹ Jᵀ`.
    mobility: Matrix6<f64>,
}

/// Regular postures about home, with random speeds.
fn cases() -> impl Iterator<Item = Case> {
    (0..30).map(|k| {
        let robot = built_in(["iiwa7", "fr3"][k as usize % 2]).expect("a built-in robot");
        let arm = Arm::<f64, 7>::new(&robot, &iiwa7_tool()).expect("an arm");
        let q = core::array::from_fn(|i| {
            let home = [0.0, 0.7, 0.0, -1.5, 0.0, 1.9, 0.0][i];
            home + 0.4 * random(k * 20 + i as u64)
        });
        let dq = core::array::from_fn(|i| random(k * 20 + 10 + i as u64));
        let snapshot = Snapshot::new(&arm, &q, &dq).expect("a mass matrix");
        let mut mass = arm.bodies(&arm.frames(&q)).mass_matrix();
        arm.add_rotors(&mut mass);
        let inverse_mass = mass.try_inverse().expect("a mass matrix");
        let mobility = snapshot.jacobian * inverse_mass * snapshot.jacobian.transpose();
        assert!(!snapshot.near_singular, "posture {k}");
        Case {
            limits: core::array::from_fn(|i| robot.joints[i].limits),
            arm,
            snapshot,
            inverse_mass,
            mobility,
        }
    })
}

fn vector<const N: usize>(seed: u64, size: f64) -> SVector<f64, N> {
    SVector::from_fn(|i, _| size * random(seed * 100 + i as u64))
}

// Fails if a speed of the TCP, a torque of a force at the TCP, or the force that accelerates the
// TCP like a torque has a wrong entry.
#[test]
fn task_space_is_that_of_the_jacobian() {
    for (k, case) in (0..).zip(cases()) {
        let snapshot = &case.snapshot;
        let h = 1e-6;
        let at = |t: f64| {
            let q = core::array::from_fn(|i| snapshot.q[i] + t * snapshot.dq[i]);
            case.arm.tcp_frame(&case.arm.frames(&q))
        };
        let linear = (at(h).position - at(-h).position) / (2.0 * h);
        let angular = rotation_error(&at(h).rotation, &at(-h).rotation) / (2.0 * h);
        for i in 0..3 {
            assert!((snapshot.velocity[i] - linear[i]).abs() < 1e-7);
            assert!((snapshot.velocity[3 + i] - angular[i]).abs() < 1e-7);
        }
        assert!((snapshot.tcp_speed() - linear.norm()).abs() < 1e-7);
        let force = vector::<6>(k, 20.0);
        assert!((snapshot.joint_torque(&force) - snapshot.jacobian.transpose() * force).norm() < 1e-9);
        let torque = vector::<7>(k, 10.0);
        let inverse = case.mobility.try_inverse().expect("regular");
        let expected = inverse * (snapshot.jacobian * (case.inverse_mass * torque));
        let is = snapshot.task_force(&snapshot.mass.solve_lower(&torque));
        assert!(
            (is - expected).norm() < 1e-6 * expected.norm(),
            "{is} is not {expected}"
        );
    }
}

// Fails if the force that explains a torque is not the damped least-squares one: for it the gradient
// of `|J' f − tau|² + 0.01 |f|²` is zero.
#[test]
fn the_force_that_explains_a_torque_is_the_best_one() {
    for (k, case) in (0..).zip(cases()) {
        let jacobian = case.snapshot.jacobian.fixed_rows::<3>(0).into_owned();
        let torque = vector::<7>(k, 10.0);
        let force = case.snapshot.point_force(&torque);
        let gradient = jacobian * (jacobian.transpose() * force - torque) + force * 0.01;
        assert!(force.norm() > 0.1 && gradient.norm() < 1e-9, "{gradient}");
    }
}

// Fails if a mode is not damped with the ratio: with the mobility `B` the damping `D` of all modes
// solves `D B D = 4 ζ² K`.
#[test]
fn every_mode_has_the_damping_ratio() {
    for case in cases() {
        let along = Vector3::new(0.48, -0.6, -0.64);
        let stiffness = Stiffness::about([900.0, 1500.0, 2500.0], &along, 250.0);
        // A drive that allows every frequency.
        let drive = Actuation::new([0.0; 7], 1e-6, 0.0);
        let (q, dq) = (case.snapshot.q, case.snapshot.dq);
        let snapshot = Snapshot::on(&drive, &case.arm, &q, &dq).expect("a mass matrix");
        let mut damping = Damping::default();
        for _ in 0..30 {
            damping.update(&snapshot, &stiffness);
        }
        let mut d = Matrix6::zeros();
        for i in 0..6 {
            let velocity = Vector6::from_fn(|k, _| if k == i { 1.0 } else { 0.0 });
            let force = damping.force(&snapshot, &stiffness, 0.7, &Vector6::zeros(), &velocity);
            d.set_column(i, &force);
        }
        let mut k = Matrix6::zeros();
        k.fixed_view_mut::<3, 3>(0, 0).copy_from(&stiffness.translation);
        k.fixed_view_mut::<3, 3>(3, 3)
            .copy_from(&Matrix3::from_diagonal_element(250.0));
        let expected = k * (4.0 * 0.7 * 0.7);
        let off = (d * case.mobility * d - expected).norm() / expected.norm();
        assert!(off < 1e-6, "{off}");
    }
}

// Fails if force or torque of the spring is not stiffness times error, the feed-forward is left out,
// or the stiffness does not change straight from one value to the other within its time.
#[test]
fn the_spring_pulls_in_proportion_and_ramps_straight() {
    let case = cases().next().expect("a case");
    let arm = case.arm;
    let still = Snapshot::new(&arm, &case.snapshot.q, &[0.0; 7]).expect("a mass matrix");
    let mut impedance = Impedance::new(Stiffness::isotropic(20.0, 10.0));
    impedance.ramp_to(Stiffness::isotropic(120.0, 30.0), 0.008, 1e-3);
    let axis = Vector3::new(0.48, -0.6, 0.64);
    let setpoint = CartesianSetpoint {
        position: still.tcp.position + Vector3::new(0.01, -0.02, 0.03),
        rotation: rotation_about(&axis, 0.2) * still.tcp.rotation,
        velocity: Vector6::zeros(),
        acceleration: Vector3::zeros(),
        feed_forward: Vector6::new(1.0, 2.0, 3.0, 4.0, 5.0, 6.0),
    };
    for tick in 1..=10 {
        let share = f64::from(tick.min(8)) / 8.0;
        let (k, kr) = (20.0 + 100.0 * share, 10.0 + 20.0 * share);
        let force = impedance.force(&still, &setpoint, 0.7) - setpoint.feed_forward;
        for i in 0..3 {
            assert!(
                (force[i] - k * [0.01, -0.02, 0.03][i]).abs() < 1e-9,
                "tick {tick}: {force}"
            );
            assert!((force[3 + i] - kr * 0.2 * axis[i]).abs() < 1e-9, "tick {tick}: {force}");
        }
        assert_eq!(impedance.settled(), tick >= 8);
    }
}

// Fails if the rotation vector is not axis times angle, up to half a turn.
#[test]
fn the_rotation_error_is_axis_times_angle() {
    for k in 0..50 {
        let axis = vector::<3>(k, 1.0).normalize();
        let from = rotation_about(&vector::<3>(k + 50, 1.0).normalize(), 2.0);
        for angle in [0.0, 1e-9, 1e-7, 3e-6, 0.01, 1.0, 2.0, 3.1] {
            let error = rotation_error(&(rotation_about(&axis, angle) * from), &from);
            assert!((error - axis * angle).norm() < 1e-9 * angle + 1e-15, "{angle}: {error}");
        }
        // At half a turn the axis is unknown; the error must not explode.
        assert!(rotation_error(&(rotation_about(&axis, core::f64::consts::PI) * from), &from).norm() < 3.2);
    }
}

// Fails if the pull to a posture accelerates the TCP, or is another one than that of the springs less
// what accelerates it.
#[test]
fn the_pull_to_a_posture_leaves_the_tcp_alone() {
    for (k, case) in (0..).zip(cases()) {
        let snapshot = &case.snapshot;
        let posture: [f64; 7] = core::array::from_fn(|i| snapshot.q[i] + random(k * 9 + i as u64));
        let torque = NullSpace::Posture(posture).torque(snapshot, &[NO_LIMITS; 7], 50.0, 0.7);
        let pull = SVector::<f64, 7>::from_fn(|i, _| {
            let damping = 2.0 * 0.7 * libm::sqrt(50.0 * snapshot.inertia[i]);
            50.0 * (posture[i] - snapshot.q[i]) - damping * snapshot.dq[i]
        });
        let inverse = case.mobility.try_inverse().expect("regular");
        let accelerated = snapshot.jacobian * (case.inverse_mass * pull);
        let expected = pull - snapshot.jacobian.transpose() * (inverse * accelerated);
        assert!(
            (torque - expected).norm() < 1e-6 * pull.norm(),
            "{torque} is not {expected}"
        );
        let left = snapshot.jacobian * (case.inverse_mass * torque);
        assert!(left.norm() < 1e-6 * accelerated.norm(), "{left}");
    }
}

// Fails if a spring about the tool's axis is softened by another mobility than that of the arm about it, or is ever
// called harder than asked.
#[test]
fn a_spring_about_the_tool_is_softened_by_its_inertia() {
    for case in cases() {
        let (snapshot, axis) = (&case.snapshot, case.snapshot.tcp.z());
        let mobility = axis.dot(&(case.mobility.fixed_view::<3, 3>(3, 3) * axis));
        let hardest = snapshot.fastest_rad_s * snapshot.fastest_rad_s / mobility;
        assert!((snapshot.softened(3.0 * hardest) - 3.0).abs() < 1e-6);
        assert_eq!(snapshot.softened(0.5 * hardest), 1.0);
    }
}

// Fails if the elbow's spring does other work on the self-motion than stiffness times error, on the
// shorter way about the circle.
#[test]
fn the_elbow_is_pulled_the_shorter_way() {
    for case in cases() {
        let arm = &case.arm;
        let q = case.snapshot.q;
        let still = Snapshot::new(arm, &q, &[0.0; 7]).expect("a mass matrix");
        let now = elbow(&still.frames).expect("an elbow");
        let gradient = SVector::from(now.gradient(&still.frames));
        for (error, short) in [(0.3, 0.3), (-0.4, -0.4), (core::f64::consts::TAU - 0.45, -0.45)] {
            let null_space = NullSpace::Elbow {
                angle: now.angle + error,
                rate: 0.0,
                acceleration: 0.0,
            };
            assert!((null_space.elbow_error(&still) - short).abs() < 1e-9);
            let torque = null_space.torque(&still, &[NO_LIMITS; 7], 50.0, 0.7);
            // Along the acceleration that it causes the angle changes, and the TCP stays.
            let motion = case.inverse_mass * torque;
            let work = 50.0 * short * gradient.dot(&motion);
            assert!((torque.dot(&motion) - work).abs() < 1e-6 * work.abs());
        }
    }
}

// Fails if a hand feels another spring or damper: the spring carries 1.5 % of the joint's torque limit
// and yields at 15 mrad; its damping is eleven times as large at twice the speed of a joint (0.8 rad/s)
// or of the TCP (0.25 m/s); the wall before a limit has its own.
#[test]
fn a_hand_feels_a_spring_that_yields_and_brakes() {
    let case = cases().next().expect("a case");
    let (arm, limits) = (&case.arm, &case.limits);
    let guide = |q: [f64; 7], joint: usize, dq: f64, off: f64| {
        let mut speeds = [0.0; 7];
        speeds[joint] = dq;
        let snapshot = Snapshot::new(arm, &q, &speeds).expect("a mass matrix");
        let mut hold = JointSetpoint { q, dq: [0.1; 7] };
        hold.q[joint] += off;
        let torque = guide_torque(&snapshot, &mut hold, limits, 0.01)[joint];
        assert_eq!(hold.dq, [0.0; 7]);
        let damping = libm::sqrt(snapshot.inertia[joint] * limits[joint].torque_nm);
        (torque, hold.q[joint] - q[joint], damping, snapshot)
    };
    for joint in [0, 3, 6] {
        let limit = limits[joint].torque_nm;
        for (off, kept) in [(0.01, 0.01), (-0.01, -0.01), (0.1, 0.015), (-0.1, -0.015)] {
            let (torque, rest, ..) = guide(HOME, joint, 0.0, off);
            assert!((torque - limit * kept).abs() < 1e-9, "joint {joint}: {torque} N m");
            assert!((rest - kept).abs() < 1e-12);
        }
        let (torque, _, damping, _) = guide(HOME, joint, 0.1, 0.0);
        assert!((torque + damping * 0.1).abs() < 1e-9, "joint {joint}: {torque} N m");
    }
    let (torque, _, damping, snapshot) = guide(HOME, 6, 1.6, 0.0);
    assert!(snapshot.tcp_speed() < 0.25);
    assert!((torque + 11.0 * damping * 1.6).abs() < 1e-9, "{torque} N m");
    let metre = guide(HOME, 0, 1.0, 0.0).3.tcp_speed();
    let dq = 0.5 / metre;
    assert!(dq < 1.2, "the TCP is the faster one");
    let (torque, _, damping, _) = guide(HOME, 0, dq, 0.0);
    assert!((torque + 11.0 * damping * dq).abs() < 1e-9, "{torque} N m");
    let mut q = HOME;
    q[0] = limits[0].max_rad - 0.01 - 0.05;
    let (torque, _, damping, snapshot) = guide(q, 0, -0.1, 0.0);
    let stiffness = 0.4 * limits[0].torque_nm / 0.15;
    let wall = -0.1 * stiffness + 2.0 * libm::sqrt(snapshot.inertia[0] * stiffness) * 0.1;
    assert!((torque - damping * 0.1 - wall).abs() < 1e-9, "{torque} N m");
}

// Fails if the hold gives way at another force than 5 N beyond the model's error, by another amount
// than keeps that force, farther than 0.1 m, or into a joint's margin.
#[test]
fn a_hold_gives_way_to_what_is_too_strong() {
    let case = cases().next().expect("a case");
    let mut snapshot = case.snapshot;
    let q = snapshot.q;
    let stretched: [f64; 7] = core::array::from_fn(|i| q[i] + 0.02 * (i as f64 - 3.0));
    let mut follow = |newton: f64, away: f64, limits: &[JointLimits; 7]| {
        let torque = snapshot.jacobian.fixed_rows::<3>(0).transpose() * Vector3::new(0.0, 0.6, -0.8);
        let torque = torque * (newton / snapshot.point_force(&torque).norm());
        let from = snapshot.tcp.position;
        snapshot.tcp.position = from + Vector3::new(0.6, 0.8, 0.0) * away;
        let mut hold = JointSetpoint {
            q: stretched,
            dq: [0.0; 7],
        };
        Giving::new(from, 3.0).follow(&snapshot, &torque, &mut hold, limits, 0.01);
        snapshot.tcp.position = from;
        hold.q
    };
    assert_eq!(follow(7.99, 0.05, &case.limits), stretched);
    assert_eq!(follow(16.0, 0.101, &case.limits), stretched);
    let mut at_the_end = Snapshot::new(&case.arm, &q, &[0.0; 7]).expect("a mass matrix");
    at_the_end.tcp.position = Vector3::new(0.1, 0.0, 0.0);
    let torque = at_the_end.jacobian.fixed_rows::<3>(0).transpose() * Vector3::new(0.0, 0.0, 50.0);
    let mut hold = JointSetpoint {
        q: stretched,
        dq: [0.0; 7],
    };
    Giving::new(Vector3::zeros(), 3.0).follow(&at_the_end, &torque, &mut hold, &case.limits, 0.01);
    assert_eq!(hold.q, stretched, "it has given way by 0.1 m");
    let given = follow(16.0, 0.099, &case.limits);
    for i in 0..7 {
        assert!((given[i] - 0.5 * (q[i] + stretched[i])).abs() < 1e-9, "joint {i}");
    }
    let mut tight = case.limits;
    tight[0].min_rad = q[0];
    tight[6].max_rad = q[6];
    let given = follow(16.0, 0.0, &tight);
    assert!((given[0] - q[0] - 0.01).abs() < 1e-12 && (given[6] - q[6] + 0.01).abs() < 1e-12);
}

// Fails if a stiffness has other axes than the approach's, or other values along them.
#[test]
fn a_stiffness_has_the_axes_of_the_approach() {
    for (along, reference) in [
        (Vector3::new(0.48, -0.6, 0.64), Vector3::z()),
        (Vector3::new(0.6, 0.8, 0.0), Vector3::z()),
        (Vector3::new(0.0, 0.28, -0.96), Vector3::x()),
    ] {
        let k = Stiffness::about([50.0, 70.0, 100.0], &along, 200.0).translation;
        let across = along.cross(&reference).normalize();
        let first = across.cross(&along);
        assert!(first.dot(&reference) > 0.0);
        for (axis, value) in [(first, 50.0), (across, 70.0), (along, 100.0)] {
            assert!((k * axis - axis * value).norm() < 1e-9, "{value} N/m along {axis}: {k}");
        }
    }
}
