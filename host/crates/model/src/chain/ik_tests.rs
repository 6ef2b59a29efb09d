use proptest::prelude::*;
use spherecal_shared::robot::{Robot, iiwa7, iiwa7_tool};

use super::*;
use crate::halton::halton;

fn chain(robot: &Robot) -> Chain {
    Chain::new(robot, &iiwa7_tool()).expect("a valid robot")
}

/// The iiwa 7 with errors of a millimetre and a milliradian or two in every row.
fn perturbed(seed: u64) -> Robot {
    let mut robot = iiwa7();
    for (i, joint) in robot.joints.iter_mut().enumerate() {
        let wobble = |k: usize| 2.0 * halton(seed as usize * 7 + i + 1, k) - 1.0;
        joint.mdh.alpha += 2e-3 * wobble(0);
        joint.mdh.a += 1e-3 * wobble(1);
        joint.mdh.theta += 3e-3 * wobble(2);
        joint.mdh.d += 1e-3 * wobble(3);
    }
    robot
}

/// A six-axis industrial arm with an elbow offset, not of the closed-form kind.
fn six_axis() -> Robot {
    let mut robot = iiwa7();
    robot.joints.truncate(6);
    let rows = [
        (0.0, 0.0, 0.0, 0.45),
        (-FRAC_PI_2, 0.075, -FRAC_PI_2, 0.0),
        (0.0, 0.36, 0.0, 0.0),
        (-FRAC_PI_2, 0.09, 0.0, 0.38),
        (FRAC_PI_2, 0.0, 0.0, 0.0),
        (-FRAC_PI_2, 0.0, 0.0, 0.08),
    ];
    for (joint, (alpha, a, theta, d)) in robot.joints.iter_mut().zip(rows) {
        (joint.mdh.alpha, joint.mdh.a, joint.mdh.theta, joint.mdh.d) = (alpha, a, theta, d);
    }
    robot
}

/// Joint angles inside the limits, away from the singular places of the wrist,
/// elbow and shoulder.
fn configuration(chain: &Chain, fractions: &[f64]) -> Vec<f64> {
    chain
        .limits()
        .iter()
        .zip(fractions)
        .map(|(l, f)| l.min_rad + (0.05 + 0.9 * f) * (l.max_rad - l.min_rad))
        .collect()
}

fn assert_solves(chain: &Chain, pose: &TcpPose, q: &[f64]) -> Result<(), TestCaseError> {
    let got = chain.pose(q);
    prop_assert!(
        (got.position - pose.position).norm() < 1e-10,
        "position {:e}",
        (got.position - pose.position).norm()
    );
    prop_assert!((got.rotation.matrix() - pose.rotation.matrix()).amax() < 1e-10);
    if let (Some(wanted), Some(found)) = (pose.elbow, got.elbow) {
        prop_assert!(wrapped(wanted - found).abs() < 1e-10);
    }
    prop_assert!(chain.limit_margin(q) >= 0.0);
    Ok(())
}

proptest! {
    // Fails if a branch misses pose or elbow angle, leaves the limits, or the
    // configuration that made the pose is not among the branches.
    #[test]
    fn every_branch_reaches_the_pose(fractions in prop::array::uniform7(0.0f64..1.0), seed in 0u64..40) {
        for robot in [iiwa7(), perturbed(seed)] {
            let chain = chain(&robot);
            prop_assert!(chain.closed_form());
            let q = configuration(&chain, &fractions);
            prop_assume!([1, 3, 5].into_iter().all(|i: usize| q[i].abs() > 0.1));
            let pose = chain.pose(&q);
            prop_assume!(pose.elbow.is_some());
            let solutions = chain.solve(&pose);
            for solution in &solutions {
                assert_solves(&chain, &pose, solution)?;
            }
            let found = solutions.iter().any(|s| s.iter().zip(&q).all(|(a, b)| (a - b).abs() < 1e-6));
            prop_assert!(found, "{q:?} is not among {solutions:?}");
        }
    }

    // Fails if the elbow's analytic gradient or the Jacobian differs from
    // central differences.
    #[test]
    fn jacobian_is_the_derivative(fractions in prop::array::uniform7(0.0f64..1.0), seed in 0u64..40) {
        let chain = chain(&perturbed(seed));
        let q = configuration(&chain, &fractions);
        prop_assume!([1, 3, 5].into_iter().all(|i: usize| q[i].abs() > 0.3));
        prop_assume!(chain.pose(&q).elbow.is_some());
        let jacobian = chain.jacobian(&chain.posture::<7>(&q), true);
        let h = 1e-6;
        for j in 0..7 {
            let (mut a, mut b) = (q.clone(), q.clone());
            a[j] += h;
            b[j] -= h;
            let (a, b) = (chain.pose(&a), chain.pose(&b));
            let (Some(ea), Some(eb)) = (a.elbow, b.elbow) else { continue };
            let shift = (a.position - b.position) / (2.0 * h);
            let turn = rotation_vector(&(a.rotation * b.rotation.inverse())) / (2.0 * h);
            let swivel = wrapped(ea - eb) / (2.0 * h);
            for k in 0..3 {
                prop_assert!((shift[k] - jacobian[(k, j)]).abs() < 1e-7);
                prop_assert!((turn[k] - jacobian[(k + 3, j)]).abs() < 1e-7);
            }
            prop_assert!((swivel - jacobian[(6, j)]).abs() < 1e-5 * (1.0 + swivel.abs()), "{} {}", swivel, jacobian[(6, j)]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]
    // Fails if the numerical solution of a six-axis arm misses the pose, leaves
    // the limits, or finds nothing for a pose that a configuration reaches.
    #[test]
    fn a_six_axis_arm_is_solved(fractions in prop::array::uniform6(0.1f64..0.9)) {
        let chain = chain(&six_axis());
        prop_assert!(!chain.closed_form());
        let q = configuration(&chain, &fractions);
        prop_assume!(q[4].abs() > 0.2);
        let pose = chain.pose(&q);
        prop_assert!(pose.elbow.is_none());
        let solutions = chain.solve(&pose);
        prop_assert!(!solutions.is_empty());
        for solution in &solutions {
            assert_solves(&chain, &pose, solution)?;
        }
    }
}

#[test]
fn out_of_reach_is_no_solution() {
    let chain = chain(&iiwa7());
    let pose = TcpPose {
        position: Vector3::new(2.0, 0.0, 0.3),
        rotation: Rotation3::identity(),
        elbow: Some(0.0),
    };
    assert!(chain.solve(&pose).is_empty());
}
