//! The robot model against values that this project's code did not make: a
//! NumPy formulation (`reference_kinematics.json`) and MuJoCo (`ref_dyn.json`).
//! Fails if any frame, Jacobian column, mass, inertia or sign is wrong.

use nalgebra::{SMatrix, SVector, Vector3};
use serde::Deserialize;
use spherecal_shared::linalg::Cholesky;
use spherecal_shared::robot::{Arm, Dynamics, Inertia, Tool, iiwa7, iiwa7_tool};
use spherecal_tests::data;

#[derive(Deserialize)]
struct KinematicsCase {
    tcp_mm: [f64; 3],
    #[serde(rename = "R")]
    rotation: [[f64; 3]; 3],
    #[serde(rename = "J_3x28")]
    jacobian: [Vec<f64>; 3],
}

#[derive(Deserialize)]
struct Configuration {
    q: [f64; 7],
    nominal_flange: KinematicsCase,
    nominal_tool: KinematicsCase,
    perturbed_tool: KinematicsCase,
}

#[derive(Deserialize)]
struct KinematicsReference {
    mdh_perturbed: [[f64; 4]; 7],
    configs: Vec<Configuration>,
}

/// The arm of one table in mm and rad, with a TCP in mm.
fn arm_mm(table: Option<&[[f64; 4]; 7]>, tcp_mm: [f64; 3]) -> Arm<f64, 7> {
    let mut robot = iiwa7();
    for (joint, row) in robot.joints.iter_mut().zip(table.into_iter().flatten()) {
        joint.mdh.alpha = row[0];
        joint.mdh.a = row[1] / 1000.0;
        joint.mdh.theta = row[2];
        joint.mdh.d = row[3] / 1000.0;
    }
    let tool = Tool {
        tcp_m: tcp_mm.map(|x| x / 1000.0),
        ..iiwa7_tool()
    };
    Arm::new(&robot, &tool).expect("a valid robot")
}

fn check(arm: &Arm<f64, 7>, q: &[f64; 7], case: &KinematicsCase) {
    let frames = arm.frames(q);
    let tcp = arm.tcp_frame(&frames);
    for i in 0..3 {
        assert!((tcp.position[i] * 1000.0 - case.tcp_mm[i]).abs() < 1e-9);
        for j in 0..3 {
            assert!((tcp.rotation[(i, j)] - case.rotation[i][j]).abs() < 1e-12);
        }
    }
    let joint = arm.jacobian(&frames, &tcp.position);
    for (k, columns) in arm.parameter_jacobian(&frames, &tcp.position).iter().enumerate() {
        for i in 0..3 {
            // Angles: m/rad to mm/rad; lengths: mm per mm.
            let ours = [
                columns.alpha[i] * 1000.0,
                columns.a[i],
                columns.theta[i] * 1000.0,
                columns.d[i],
            ];
            for (c, value) in ours.iter().enumerate() {
                let theirs = case.jacobian[i][4 * k + c];
                assert!(
                    (value - theirs).abs() < 1e-9,
                    "row {k}, parameter {c}: {value} is not {theirs}"
                );
            }
            assert!((joint[(i, k)] - columns.theta[i]).abs() < 1e-15);
        }
    }
}

#[test]
fn kinematics_and_parameter_jacobians_agree_with_numpy() {
    let reference: KinematicsReference = data("reference_kinematics.json");
    assert_eq!(reference.configs.len(), 10);
    for configuration in &reference.configs {
        let q = &configuration.q;
        check(&arm_mm(None, [0.0; 3]), q, &configuration.nominal_flange);
        check(&arm_mm(None, [50.0, 0.0, 100.0]), q, &configuration.nominal_tool);
        check(
            &arm_mm(Some(&reference.mdh_perturbed), [50.0, 0.0, 100.0]),
            q,
            &configuration.perturbed_tool,
        );
    }
}

/// Known values of the nominal arm, from the identification paper of the project.
#[test]
fn flange_and_tool_stand_where_they_are_known_to() {
    let q = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
    let flange = arm_mm(None, [0.0; 3]);
    let at = |arm: &Arm<f64, 7>, q: &[f64; 7]| arm.tcp_frame(&arm.frames(q)).position * 1000.0;
    assert!((at(&flange, &q) - Vector3::new(37.383021353769, -4.711631683163, 1239.147982619095)).norm() < 1e-9);
    let tool = arm_mm(None, [50.0, 0.0, 100.0]);
    assert!((at(&tool, &q) - Vector3::new(56.155312501635, 74.692325885578, 1315.584967171609)).norm() < 1e-9);
    let mut bent = [0.0; 7];
    bent[3] = core::f64::consts::FRAC_PI_2;
    assert!((at(&flange, &bent) - Vector3::new(-526.0, 0.0, 740.0)).norm() < 1e-9);
}

#[derive(Deserialize)]
struct State {
    q: [f64; 7],
    dq: [f64; 7],
    tau: [f64; 7],
    #[serde(rename = "M")]
    mass: [[f64; 7]; 7],
    bias: [f64; 7],
    qacc: [f64; 7],
    tcp: [f64; 3],
    #[serde(rename = "J")]
    jacobian: [[f64; 7]; 6],
}

#[derive(Deserialize)]
struct DynamicsReference {
    states: Vec<State>,
}

#[test]
fn dynamics_agree_with_mujoco() {
    let reference: DynamicsReference = data("ref_dyn.json");
    assert_eq!(reference.states.len(), 50);
    let tool = Tool {
        tcp_m: [0.05, 0.0, 0.07],
        body: Inertia {
            mass_kg: 1.5,
            com_m: [0.025, 0.0, 0.032],
            inertia_kg_m2: [0.0012, 0.0022, 0.0022, 0.0, 0.0, 0.0],
        },
    };
    let arm = Arm::<f64, 7>::new(&iiwa7(), &tool).expect("a valid robot");
    for state in &reference.states {
        let frames = arm.frames(&state.q);
        let tcp = arm.tcp_frame(&frames).position;
        assert!((tcp - Vector3::from(state.tcp)).norm() < 1e-12);
        let jacobian = arm.jacobian(&frames, &tcp);
        let theirs = SMatrix::<f64, 6, 7>::from_fn(|i, j| state.jacobian[i][j]);
        assert!((jacobian - theirs).norm() < 1e-11 * theirs.norm());

        let bodies = arm.bodies(&frames);
        let mass = bodies.mass_matrix();
        let theirs = SMatrix::<f64, 7, 7>::from_fn(|i, j| state.mass[i][j]);
        assert!(
            (mass - theirs).norm() < 1e-9 * theirs.norm(),
            "mass matrix off by {}",
            (mass - theirs).norm()
        );

        let bias = bodies.coriolis(&state.dq) + bodies.gravity();
        let theirs = SVector::from(state.bias);
        assert!(
            (bias - theirs).norm() < 1e-9 * theirs.norm(),
            "bias off by {}",
            (bias - theirs).norm()
        );

        let acceleration = Cholesky::new(&mass)
            .expect("a mass matrix")
            .solve(&(SVector::from(state.tau) - bias));
        let theirs = SVector::from(state.qacc);
        assert!(
            (acceleration - theirs).norm() < 1e-9 * theirs.norm(),
            "acceleration off by {}",
            (acceleration - theirs).norm()
        );
    }
}

/// `Cᵀ q̇` against its definition: `Ṁ q̇ − C q̇`, with `Ṁ` by central differences.
#[test]
fn momentum_terms_satisfy_their_definition() {
    let reference: DynamicsReference = data("ref_dyn.json");
    let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("a valid robot");
    for state in &reference.states {
        let bodies = arm.bodies(&arm.frames(&state.q));
        let (momentum, transposed) = bodies.momentum(&state.dq);
        let dq = SVector::from(state.dq);
        assert!((momentum - bodies.mass_matrix() * dq).norm() < 1e-12);
        let h = 1e-6;
        let mass_at = |sign: f64| {
            let q = core::array::from_fn(|i| state.q[i] + sign * h * state.dq[i]);
            arm.bodies(&arm.frames(&q)).mass_matrix()
        };
        let mass_rate = (mass_at(1.0) - mass_at(-1.0)) / (2.0 * h);
        let expected = mass_rate * dq - bodies.coriolis(&state.dq);
        assert!((transposed - expected).norm() < 1e-7 * (1.0 + expected.norm()));
    }
}
