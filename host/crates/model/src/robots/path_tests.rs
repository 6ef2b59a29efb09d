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

// Fails if a slide's direction as it was found is not the one of the file that is written, behind a turned hinge of a
// corrected table too, or if the file differs from the table with the slide at zero.
#[test]
fn found_directions_of_slides_are_written() {
    let joint = |name: &str, kind: &str, parent: usize, rpy: &str, axis: &str| {
        format!(
            "<link name=\"l{}\"/><joint name=\"{name}\" type=\"{kind}\"><parent link=\"l{parent}\"/><child link=\"l{}\"/>\
             <origin xyz=\"0.1 0.2 0.3\" rpy=\"{rpy}\"/>{axis}<limit lower=\"-1\" upper=\"1\"/></joint>",
            parent + 1,
            parent + 1
        )
    };
    let text = [
        "<robot name=\"r\"><link name=\"l0\"/>".to_owned(),
        joint("rail", "prismatic", 0, "0 0 0.5", ""),
        joint("a", "revolute", 1, "0.2 0 0", "<axis xyz=\"0 0 1\"/>"),
        joint("b", "revolute", 2, "0 0.4 0", "<axis xyz=\"0 1 0\"/>"),
        joint("quill", "prismatic", 3, "0.1 0.2 0.3", "<axis xyz=\"0 0 -1\"/>"),
        joint("c", "revolute", 4, "0 0 0", "<axis xyz=\"1 0 0\"/>"),
        "</robot>".to_owned(),
    ]
    .concat();
    let mut model = super::super::urdf_in::load_path("r.urdf", &text, Some("l5"), None).unwrap();
    model.slides = vec![
        Vector3::new(0.9, 0.4, -0.1).normalize(),
        Vector3::new(0.2, -0.1, -1.0).normalize(),
    ];
    let mut rows = model.rows();
    for row in &mut rows {
        row.theta += 0.02;
        row.alpha -= 0.01;
    }
    let written = super::super::write_urdf(&model, &rows, &[]);
    let again = super::super::urdf_in::load_path("r.urdf", &written, Some("l5"), None).unwrap();
    let path = again.joint_path().unwrap();
    assert_eq!(path.columns, ["rail", "a", "b", "quill", "c"]);
    let tip = |q: &[f64]| path.frames(&path.positions(q)).tip;
    let zero = tip(&[0.0; 5]);
    for (k, direction) in [0, 3].into_iter().zip(&model.slides) {
        let mut q = [0.0; 5];
        q[k] = 0.5;
        assert!((tip(&q).position - zero.position - direction * 0.5).norm() < 1e-12);
    }
    let q = [0.0, 0.3, -0.7, 0.0, 0.4];
    assert!(distance(&tip(&q), &model.flange_with(&rows, &[0.3, -0.7, 0.4])) < 1e-12);
}
