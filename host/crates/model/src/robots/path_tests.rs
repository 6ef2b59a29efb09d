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

/// A robot with two arms, of which the left one has a slide and a joint that follows another, and a head.
fn two_arms() -> String {
    let joint = |name: &str, kind: &str, parent: &str, child: &str, rpy: &str, more: &str| {
        format!(
            "<link name=\"{child}\"/>\n<joint name=\"{name}\" type=\"{kind}\"><parent link=\"{parent}\"/><child \
             link=\"{child}\"/><origin xyz=\"0.1 0.2 0.3\" rpy=\"{rpy}\"/>{more}<limit lower=\"-1\" \
             upper=\"1\"/></joint>\n"
        )
    };
    let (x, y, z) = (
        "<axis xyz=\"1 0 0\"/>",
        "<axis xyz=\"0 1 0\"/>",
        "<axis xyz=\"0 0 1\"/>",
    );
    let follows = "<axis xyz=\"0 1 0\"/><mimic joint=\"l2\" multiplier=\"-0.5\" offset=\"0.1\"/>";
    [
        "<robot name=\"r\"><link name=\"world\"/>\n".to_owned(),
        joint("lift", "prismatic", "world", "torso", "0 0 0.5", z),
        joint("turn", "revolute", "torso", "chest", "0.1 0 0.5", z),
        joint("l1", "revolute", "chest", "left1", "0.2 0 0", x),
        joint("l2", "revolute", "left1", "left2", "0 0.4 0", z),
        joint("l3", "prismatic", "left2", "left3", "0.1 0.2 0.3", y),
        joint("l4", "revolute", "left3", "left4", "0.1 0 0", follows),
        joint("lt", "fixed", "left4", "left_tool", "0.1 0.7 0", ""),
        joint("r1", "revolute", "chest", "right1", "0.2 0.3 0", y),
        joint("rf", "fixed", "right1", "right_fork", "0.2 0.3 0.1", ""),
        joint("r2", "revolute", "right_fork", "right2", "0 0.4 0", z),
        joint("rt", "fixed", "right2", "right_tool", "0.3 0.1 0", ""),
        joint("head", "revolute", "chest", "camera", "0.3 0.1 0", z),
        "</robot>".to_owned(),
    ]
    .concat()
}

// Fails if a path that goes up and down again is not the inverse of one way from the root times the other, in path or table;
// if a joint that is passed upwards moves the other way; or if the base of such a path is taken for that of a plain arm.
#[test]
fn a_path_goes_up_and_down_again() {
    let text = two_arms();
    let load = |ends: &str| super::super::urdf_in::load_path("r.urdf", &text, Some(ends), None).unwrap();
    let values: [(&str, f64); 8] = [
        ("lift", 0.2),
        ("turn", 0.3),
        ("l1", -0.4),
        ("l2", 0.7),
        ("l3", 0.15),
        ("r1", 0.5),
        ("r2", -0.8),
        ("head", 0.2),
    ];
    let tip = |path: &JointPath| {
        let value = |name: &String| values.iter().find(|(known, _)| known == name).unwrap().1;
        let columns: Vec<f64> = path.columns.iter().map(value).collect();
        path.frames(&path.positions(&columns)).tip
    };
    for (base, end) in [
        ("left_tool", "right_tool"),
        ("left4", "right_tool"),
        ("camera", "left3"),
        ("right_tool", "left_tool"),
        ("left_tool", "chest"),
        ("right2", "chest"),
    ] {
        let model = load(&format!("{base}:{end}"));
        assert_eq!(model.frame_names, (base.to_owned(), end.to_owned()));
        let path = model.joint_path().unwrap();
        let [from, to] = [base, end].map(|link| tip(&load(&format!("world:{link}")).joint_path().unwrap()));
        let expected = compose(&inverse(&from), &to);
        assert!(distance(&tip(&path), &expected) < 1e-12, "{base}:{end}");
        // The table, with the slides at zero.
        let mut q = path.positions(&vec![0.2; path.columns.len()]);
        for (q, joint) in q.iter_mut().zip(&path.joints) {
            *q *= f64::from(joint.kind == JointKind::Turns);
        }
        let of_table = model.flange_at(&path.table_angles(&q));
        assert!(distance(&path.frames(&q).tip, &of_table) < 1e-12, "{base}:{end}");
        assert!(model.chain_words().unwrap().contains("upwards"));
        assert!(model.other_joints().unwrap().1.is_empty());
        let refused = model.plain().unwrap_err().to_string();
        assert!(
            refused.contains("base link") && refused.contains("joints of the chain carry it"),
            "{refused}"
        );
    }
    let shared = load("left_tool:right_tool").joint_path().unwrap().columns;
    assert_eq!(shared, ["l2", "l3", "l1", "r1", "r2"]);
}

// Fails if the file of a corrected path that goes up and down again has not the kinematics of its table, or is another one
// in anything but the origins of the path's joints and the axes of its slides.
#[test]
fn a_path_that_goes_up_is_written_back() {
    let text = two_arms();
    for ends in [
        "left_tool:right_tool",
        "camera:right_tool",
        "right_tool:left_tool",
        "left_tool:chest",
    ] {
        let load = |text: &str| super::super::urdf_in::load_path("r.urdf", text, Some(ends), None).unwrap();
        let mut model = load(&text);
        let mut rows = model.rows();
        assert_eq!(super::super::write_urdf(&model, &rows, &[]), text, "{ends}");
        // The first row belongs to the base.
        for (k, row) in rows.iter_mut().enumerate().skip(1) {
            row.theta += 0.02 * k as f64;
            row.alpha -= 0.01;
            row.a += 0.003;
            row.d -= 0.002;
        }
        let slide = {
            let path = model.joint_path().unwrap();
            let k = path.joints.iter().position(|joint| joint.kind == JointKind::Slides);
            k.map(|k| {
                let frames = path.frames(&vec![0.0; path.joints.len()]);
                (frames.before[k].rotation * path.joints[k].axis + Vector3::new(0.01, 0.02, -0.01)).normalize()
            })
        };
        model.slides.extend(slide);
        let written = super::super::write_urdf_with_tcp(&model, &rows, &[], &[0.01, 0.02, 0.03]);
        let again = load(&written);
        for k in 0..5 {
            let q: Vec<f64> = (0..rows.len()).map(|n| f64::from(k) * 0.3 - 0.2 * n as f64).collect();
            let off = distance(&again.flange_at(&q), &model.flange_with(&rows, &q));
            assert!(off < 1e-12, "{ends}: {off}");
        }
        if let Some(direction) = slide {
            let path = again.joint_path().unwrap();
            let k = path
                .joints
                .iter()
                .position(|joint| joint.kind == JointKind::Slides)
                .unwrap();
            let mut q = vec![0.0; path.joints.len()];
            let zero = path.frames(&q).tip.position;
            q[k] = 0.5;
            assert!(
                (path.frames(&q).tip.position - zero - direction * 0.5).norm() < 1e-12,
                "{ends}"
            );
        }
        let path: Vec<String> = again
            .joint_path()
            .unwrap()
            .joints
            .iter()
            .map(|j| j.name.clone())
            .collect();
        let free = |line: &&str| {
            let of_path = path.iter().map(String::as_str).chain(["lt", "rt", "head"]);
            line.contains("<joint")
                && of_path
                    .into_iter()
                    .any(|name| line.contains(&format!("<joint name=\"{name}\"")))
        };
        let rest = |text: &str| -> Vec<String> {
            let text = text
                .split("  <!-- the tool centre point")
                .next()
                .unwrap_or_default()
                .to_owned();
            text.lines()
                .filter(|line| !free(line) && *line != "</robot>")
                .map(str::to_owned)
                .collect()
        };
        assert_eq!(rest(&written), rest(&text), "{ends}");
    }
}
