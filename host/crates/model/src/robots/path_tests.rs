//! The Jacobian of a path against finite differences, and paths of tables.

use proptest::prelude::*;

use super::super::frames::{distance, from_rpy};
use super::*;

fn pose() -> impl Strategy<Value = Pose<f64>> {
    (
        proptest::array::uniform3(-1.0..1.0_f64),
        proptest::array::uniform3(-3.0..3.0_f64),
    )
        .prop_map(|(at, rpy)| Pose {
            rotation: from_rpy(rpy),
            position: at.into(),
        })
}

/// Up to 20 joints of both kinds, each driven by one or two columns.
fn path() -> impl Strategy<Value = (JointPath, Vec<f64>)> {
    let joint = (
        pose(),
        any::<bool>(),
        proptest::array::uniform3(-1.0..1.0_f64),
        -1.0..1.0_f64,
        any::<bool>(),
    );
    (
        proptest::collection::vec(joint, 1..=20),
        pose(),
        proptest::collection::vec(-2.0..2.0_f64, 20),
    )
        .prop_map(|(joints, end, q)| {
            let count = joints.len();
            let joints = joints
                .into_iter()
                .enumerate()
                .map(|(k, (origin, slides, axis, factor, coupled))| PathJoint {
                    name: format!("j{k}"),
                    kind: if slides { JointKind::Slides } else { JointKind::Turns },
                    origin,
                    axis: (Vector3::from(axis) + Vector3::z() * 2.0).normalize(),
                    terms: if coupled {
                        vec![(k, 1.0), ((k + 1) % count, factor)]
                    } else {
                        vec![(k, 1.0)]
                    },
                    offset: factor,
                });
            let joints: Vec<PathJoint> = joints.collect();
            let columns = (0..count).map(|k| format!("j{k}")).collect();
            (JointPath { columns, joints, end }, q[..count].to_vec())
        })
}

/// A pose shifted along and turned about its own axis `n` of six.
fn nudged(pose: &Pose<f64>, n: usize, step: f64) -> Pose<f64> {
    let axis = Vector3::from_fn(|r, _| f64::from(r == n % 3));
    let own = if n < 3 {
        Pose {
            position: axis * step,
            ..Pose::identity()
        }
    } else {
        Pose {
            rotation: rot_axis(&axis, step),
            ..Pose::identity()
        }
    };
    compose(pose, &own)
}

/// Half the difference of two tips per step, as a motion of the tip's origin and a turn.
fn difference(plus: &Pose<f64>, minus: &Pose<f64>, step: f64) -> (Vector3<f64>, Matrix3<f64>) {
    (
        (plus.position - minus.position) / (2.0 * step),
        (plus.rotation - minus.rotation) * minus.rotation.transpose() / (2.0 * step),
    )
}

proptest! {
    // Fails if a column of the Jacobian is not what a small motion of a joint or a small error of an origin does, for
    // turning and sliding joints, or if a coupled joint does not follow its columns.
    #[test]
    fn columns_are_the_finite_differences((path, columns) in path()) {
        let step = 1e-6;
        let q = path.positions(&columns);
        let frames = path.frames(&q);
        let check = |twist: Twist, plus: &Pose<f64>, minus: &Pose<f64>| {
            let (linear, turn) = difference(plus, minus, step);
            let reach = 1.0 + frames.tip.position.norm() + 20.0;
            let off = (twist.linear - linear).amax() / reach;
            // To first order in the step, the turn is that of the angular part.
            let turned = (twist.angular.cross_matrix() - turn).amax();
            off < 1e-6 && turned < 1e-5
        };
        for k in 0..path.joints.len() {
            let moved = |s: f64| { let mut q = q.clone(); q[k] += s; path.frames(&q).tip };
            let column = path.joint_column(&frames, k, &frames.tip.position);
            prop_assert!(check(column, &moved(step), &moved(-step)), "joint {}", k);
        }
        for k in 0..=path.joints.len() {
            let columns = path.origin_columns(&frames, k, &frames.tip.position);
            for (n, column) in columns.into_iter().enumerate() {
                let moved = |s: f64| {
                    let mut path = path.clone();
                    let pose = path.joints.get_mut(k).map(|j| &mut j.origin);
                    match pose {
                        Some(pose) => *pose = nudged(pose, n, s),
                        None => path.end = nudged(&path.end, n, s),
                    }
                    path.frames(&q).tip
                };
                prop_assert!(check(column, &moved(step), &moved(-step)), "origin {} {}", k, n);
            }
        }
    }
}

// Fails if the path of a built-in robot ends elsewhere than its table.
#[test]
fn the_path_of_a_table_is_the_table() {
    for name in spherecal_shared::robot::BUILT_IN {
        let model = super::super::built_in(name).unwrap();
        let path = model.joint_path().unwrap();
        let q: Vec<f64> = (0..model.robot.dof()).map(|k| 0.3 - 0.4 * k as f64).collect();
        assert!(distance(&path.frames(&q).tip, &model.flange_at(&q)) < 1e-12, "{name}");
    }
}
