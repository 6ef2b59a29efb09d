//! The control law against theory: modal damping of the linearised closed
//! loop, and static deflection.

use nalgebra::{SMatrix, SVector, UnitQuaternion, Vector3, Vector6};
use spherecal_firmware::law::{Actuation, CartesianSetpoint, Impedance, NullSpace, Snapshot, Stiffness};
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Arm, Dynamics, JointLimits, elbow::elbow};
use spherecal_tests::rig::{SEED, down, nominal, solve};

/// Limits that no pose of these tests comes near.
const FAR: [JointLimits; 7] = [JointLimits {
    min_rad: -1e3,
    max_rad: 1e3,
    velocity_rad_s: 1e3,
    torque_nm: 1e3,
}; 7];

type Joints = [f64; 7];

/// The law at a pose, with its damping design settled there.
struct Loop {
    arm: Arm<f64, 7>,
    drive: Actuation<7>,
    impedance: Impedance,
    setpoint: CartesianSetpoint,
    null_space: NullSpace<7>,
    procedure: Procedure,
}

impl Loop {
    fn new(q: &Joints, stiffness: Stiffness) -> Self {
        Self::on(Actuation::default(), q, stiffness)
    }

    fn on(drive: Actuation<7>, q: &Joints, stiffness: Stiffness) -> Self {
        let arm = nominal();
        let frames = arm.frames(q);
        let tcp = arm.tcp_frame(&frames);
        let angle = elbow(&frames).expect("a bent arm").angle;
        let mut this = Self {
            arm,
            drive,
            impedance: Impedance::new(stiffness),
            setpoint: CartesianSetpoint::at(tcp.position, tcp.rotation),
            null_space: NullSpace::Elbow {
                angle,
                rate: 0.0,
                acceleration: 0.0,
            },
            procedure: Procedure::default(),
        };
        for _ in 0..30 {
            this.torque(q, &[0.0; 7]);
        }
        this
    }

    /// Spring-damper torque without gravity and Coriolis.
    fn torque(&mut self, q: &Joints, dq: &Joints) -> SVector<f64, 7> {
        let snapshot = Snapshot::on(&self.drive, &self.arm, q, dq).expect("a mass matrix");
        let law = &self.procedure.law;
        let force = self.impedance.force(&snapshot, &self.setpoint, law.damping_ratio);
        let null = self
            .null_space
            .torque(&snapshot, &FAR, law.elbow_nm_rad, law.elbow_damping_ratio);
        snapshot.joint_torque(&force) + null
    }
}

/// Twenty poses over the three spheres, orientations and elbow angles.
fn poses() -> Vec<Joints> {
    let arm = nominal();
    let mut out = Vec::new();
    for k in 0..20 {
        let t = f64::from(k);
        let position = Vector3::new(0.45 + 0.008 * t, 0.12 * (t * 1.7).sin(), 0.30 + 0.1 * (t * 0.9).cos());
        let turn = Vector3::new((t * 2.1).sin(), (t * 1.3).cos(), (t * 0.7).sin()) * 0.35;
        let rotation = UnitQuaternion::from_scaled_axis(turn).to_rotation_matrix().into_inner() * down(3.0);
        let mut seed = SEED;
        seed[2] = 0.4 * (t * 1.1).sin();
        out.push(solve(&arm, &position, &rotation, &seed));
    }
    out
}

/// The stiffness of every phase.
fn stiffnesses() -> Vec<Stiffness> {
    let p = Procedure::default();
    let r = p.law.rotation_nm_rad;
    let down = -Vector3::z();
    vec![
        Stiffness::about(p.approach.stiffness_n_m, &down, r),
        Stiffness::isotropic(p.couple.stiffness_n_m, r),
        Stiffness::isotropic(p.turn.stiffness_n_m, r),
        Stiffness::isotropic(p.record.stiffness_n_m, r),
        Stiffness::isotropic(p.decouple.stiffness_n_m, r),
    ]
}

/// Eigenvalues of the closed loop, linearised by differences of the very torque that
/// the controller commands.
fn eigenvalues(closed: &mut Loop, q: &Joints) -> Vec<nalgebra::Complex<f64>> {
    let h = 1e-6;
    let mut k = SMatrix::<f64, 7, 7>::zeros();
    let mut d = SMatrix::<f64, 7, 7>::zeros();
    for i in 0..7 {
        let shifted = |sign: f64| core::array::from_fn(|j| q[j] + if i == j { sign * h } else { 0.0 });
        let column = (closed.torque(&shifted(-1.0), &[0.0; 7]) - closed.torque(&shifted(1.0), &[0.0; 7])) / (2.0 * h);
        k.set_column(i, &column);
        let mut dq = [0.0; 7];
        dq[i] = 1.0;
        d.set_column(i, &-closed.torque(q, &dq));
    }
    let mut mass = closed.arm.bodies(&closed.arm.frames(q)).mass_matrix();
    for i in 0..7 {
        mass[(i, i)] += closed.drive.motors[i];
    }
    let factor = Cholesky::new(&mass).expect("a mass matrix");
    let mut a = SMatrix::<f64, 14, 14>::zeros();
    for i in 0..7 {
        a[(i, i + 7)] = 1.0;
        let column = |m: &SMatrix<f64, 7, 7>| factor.solve(&m.column(i).into_owned());
        a.fixed_view_mut::<7, 1>(7, i).copy_from(&-column(&k));
        a.fixed_view_mut::<7, 1>(7, i + 7).copy_from(&-column(&d));
    }
    a.complex_eigenvalues().iter().copied().collect()
}

/// A drive with a quarter of the iiwa's motors visible, and one that answers late.
fn drives() -> [Actuation<7>; 3] {
    let motors = [0.46, 1.11, 0.81, 0.45, 0.35, 0.35, 0.35];
    [
        Actuation::default(),
        Actuation::new(motors, 1e-3, 0.0),
        Actuation::new([0.0; 7], 1e-3, 4e-3),
    ]
}

/// Fails if any mode of the closed loop is damped otherwise than 0.70 ± 0.01, on
/// any drive, or is faster than the drive allows.
#[test]
fn every_mode_is_damped_as_lehr_asks() {
    for drive in drives() {
        for stiffness in stiffnesses() {
            for q in poses() {
                let mut closed = Loop::on(drive, &q, stiffness);
                for value in eigenvalues(&mut closed, &q) {
                    let zeta = -value.re / value.norm();
                    let k = stiffness.translation.diagonal();
                    assert!(
                        (zeta - 0.70).abs() < 0.01,
                        "zeta {zeta} of {value} at {q:?}, K {k:?}, {drive:?}"
                    );
                    assert!(
                        value.norm() < 1.01 * drive.fastest_rad_s,
                        "{value} at {q:?}, K {k:?}, {drive:?}"
                    );
                }
            }
        }
    }
}

/// Fails if an axis without stiffness has no damping.
#[test]
fn an_axis_without_stiffness_is_damped_too() {
    let q = poses()[0];
    let mut closed = Loop::new(&q, Stiffness::isotropic(0.0, 200.0));
    let snapshot = Snapshot::new(&closed.arm, &q, &[0.0; 7]).expect("a mass matrix");
    for axis in 0..3 {
        let mut moving = closed.setpoint;
        moving.velocity = Vector6::zeros();
        moving.velocity[axis] = 1.0;
        let force = closed.impedance.force(&snapshot, &moving, 0.7);
        assert!(force[axis] > 0.3, "axis {axis}: {force:?}");
    }
}

/// Fails if the arm under a known wrench does not come to rest at `K⁻¹ F`
/// within 1 % (the closed loop is integrated until it stands).
#[test]
fn deflection_is_force_over_stiffness() {
    let q0 = poses()[3];
    for (stiffness, force) in [(50.0, 0.4), (100.0, -0.6), (20.0, 0.1), (2000.0, 8.0)] {
        for axis in 0..3 {
            let mut closed = Loop::new(&q0, Stiffness::isotropic(stiffness, 200.0));
            let mut wrench = Vector6::zeros();
            wrench[axis] = force;
            let (mut q, mut dq) = (SVector::<f64, 7>::from(q0), SVector::<f64, 7>::zeros());
            for _ in 0..20_000 {
                let frames = closed.arm.frames(&q.into());
                let tcp = closed.arm.tcp_frame(&frames).position;
                let external = closed.arm.jacobian(&frames, &tcp).transpose() * wrench;
                let bodies = closed.arm.bodies(&frames);
                // Gravity and Coriolis are compensated exactly, as in the controller.
                let torque = closed.torque(&q.into(), &dq.into()) + external;
                let factor = Cholesky::new(&bodies.mass_matrix()).expect("a mass matrix");
                dq += factor.solve(&torque) * 1e-3;
                q += dq * 1e-3;
            }
            let tcp = closed.arm.tcp_frame(&closed.arm.frames(&q.into())).position;
            let deflection = tcp - closed.setpoint.position;
            let expected = force / stiffness;
            assert!(
                (deflection[axis] - expected).abs() < 0.01 * expected.abs(),
                "{deflection:?} is not {expected}"
            );
        }
    }
}
