//! Chains that are no plain arm: on a torso, on a torso on a rail, of twenty hinges, from one hand to the other, and from the
//! camera in the head to a hand.

use std::path::Path;

use nalgebra::{DMatrix, DVector, Rotation3, Vector3};
use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use serde_json::json;
use spherecal::model::robots::frames::{compose, from_rpy};
use spherecal::model::robots::{JointKind, JointPath, load_path};
use spherecal::model::{Pose, fit_pose};

use crate::chain_urdfs::{hinges, humanoid};
use crate::field::{check, python};
use crate::support::{spherecal, text};

/// TCP in the flange frame, in m.
pub(crate) const TOOL_M: [f64; 3] = [0.02, 0.01, 0.08];
/// Noise of a measured point by axis, in m.
pub(crate) const NOISE_M: f64 = 1e-4;

/// The arm as it is, its joints' ranges, and what draws numbers.
pub(crate) struct Real {
    pub(crate) path: JointPath,
    base: Pose<f64>,
    ranges: Vec<(f64, f64)>,
    random: ChaCha8Rng,
}

impl Real {
    /// Errors of 1 mm and 3 mrad in every joint's place and direction.
    pub(crate) fn new(file: &str, seed: u64) -> Self {
        let model = load_path(file).expect("a chain");
        let mut real = Self {
            path: model.joint_path().expect("a path"),
            base: Pose {
                rotation: from_rpy([0.1, 0.2, 1.0]),
                position: [1.5, -0.3, 0.8].into(),
            },
            ranges: Vec::new(),
            random: ChaCha8Rng::seed_from_u64(seed),
        };
        real.ranges = model.column_ranges(&real.path);
        for k in 0..real.path.joints.len() {
            let own = Pose {
                rotation: from_rpy([3e-3 * real.normal(), 3e-3 * real.normal(), 3e-3 * real.normal()]),
                position: Vector3::new(real.normal(), real.normal(), real.normal()) * 1e-3,
            };
            real.path.joints[k].origin = compose(&real.path.joints[k].origin, &own);
        }
        real
    }

    fn normal(&mut self) -> f64 {
        (0..12).map(|_| self.random.random::<f64>()).sum::<f64>() - 6.0
    }

    pub(crate) fn rows(&mut self, count: usize) -> Rows {
        let ranges = self.ranges.clone();
        let mut row = |_| {
            let q: Vec<f64> = ranges.iter().map(|&(a, b)| self.random.random_range(a..b)).collect();
            let at = self.at(&q);
            (q, at)
        };
        (0..count).map(&mut row).collect()
    }

    /// Where the tool is, in m.
    pub(crate) fn at(&self, q: &[f64]) -> Vector3<f64> {
        self.base.point(&point(&self.path, q, &TOOL_M.into()))
    }

    /// The same as measured.
    pub(crate) fn measured(&mut self, count: usize) -> Rows {
        let mut rows = self.rows(count);
        for (_, at) in &mut rows {
            *at += Vector3::new(self.normal(), self.normal(), self.normal()) * NOISE_M;
        }
        rows
    }
}

/// Joint columns, each with a point, in m.
pub(crate) type Rows = Vec<(Vec<f64>, Vector3<f64>)>;

/// Where a point of the tip's frame is in the base frame, in m.
pub(crate) fn point(path: &JointPath, columns: &[f64], tool: &Vector3<f64>) -> Vector3<f64> {
    path.frames(&path.positions(columns)).tip.point(tool)
}

/// Mean distance (m) of an arm's points from those of rows, after a best rigid fit of the base.
pub(crate) fn error_m(rows: &[(Vec<f64>, Vector3<f64>)], at: impl Fn(&[f64]) -> Vector3<f64>) -> f64 {
    let own: Vec<_> = rows.iter().map(|(q, _)| at(q)).collect();
    let real: Vec<_> = rows.iter().map(|(_, at)| *at).collect();
    let base = fit_pose(&own, &real).expect("points");
    let far = own.iter().zip(&real).map(|(own, real)| (base.point(own) - real).norm());
    far.sum::<f64>() / rows.len() as f64
}

/// Plain least squares over base, tools and all origins: Gauss-Newton steps of least norm. All chains begin with the same
/// `trunk` joints. Returns each path with its tool.
pub(crate) fn plain_fit(nominal: &[JointPath], trunk: usize, rows: &[Rows]) -> Vec<(JointPath, Vector3<f64>)> {
    let mut limbs: Vec<_> = nominal
        .iter()
        .map(|path| (path.clone(), Vector3::from(TOOL_M)))
        .collect();
    let onto: Vec<_> = rows.iter().flatten().map(|(_, at)| *at).collect();
    let own: Vec<usize> = nominal.iter().map(|path| path.joints.len() - trunk).collect();
    // Where the origin of a joint of a chain begins among the unknowns.
    let place = |limb: usize, j: usize| {
        let before: usize = own[..limb].iter().sum();
        6 + 3 * own.len() + 6 * if j < trunk { j } else { before + j }
    };
    let size = place(own.len(), trunk);
    for _ in 0..6 {
        let at = |limb: usize| rows[limb].iter().map(move |row| (limb, row));
        let all: Vec<_> = (0..limbs.len()).flat_map(at).collect();
        let now: Vec<_> = all
            .iter()
            .map(|(l, (q, _))| point(&limbs[*l].0, q, &limbs[*l].1))
            .collect();
        let base = fit_pose(&now, &onto).expect("points");
        let mut columns = DMatrix::zeros(3 * all.len(), size);
        let mut left = DVector::zeros(3 * all.len());
        for (k, (limb, (q, at))) in all.into_iter().enumerate() {
            let path = &limbs[limb].0;
            let frames = path.frames(&path.positions(q));
            let p = now[k];
            let mut put = |c: usize, column: Vector3<f64>| {
                columns
                    .fixed_view_mut::<3, 1>(3 * k, c)
                    .copy_from(&(base.rotation * column));
            };
            for axis in 0..3 {
                put(axis, Vector3::ith(axis, 1.0));
                put(3 + axis, Vector3::ith(axis, 1.0).cross(&p));
                put(6 + 3 * limb + axis, frames.tip.rotation.column(axis).into_owned());
            }
            for j in 0..path.joints.len() {
                for (n, twist) in path.origin_columns(&frames, j, &p).into_iter().enumerate() {
                    put(place(limb, j) + n, twist.linear);
                }
            }
            left.fixed_rows_mut::<3>(3 * k).copy_from(&(at - base.point(&p)));
        }
        // What the noise leaves open by more than 0.1 m or rad, the data do not determine.
        let step = columns.svd(true, true).solve(&left, NOISE_M / 0.1).expect("a step");
        for (limb, (path, tool)) in limbs.iter_mut().enumerate() {
            *tool += step.fixed_rows::<3>(6 + 3 * limb);
            for (j, joint) in path.joints.iter_mut().enumerate() {
                let at = place(limb, j);
                let own = Pose {
                    position: step.fixed_rows::<3>(at).into_owned(),
                    rotation: Rotation3::new(step.fixed_rows::<3>(at + 3).into_owned()).into_inner(),
                };
                joint.origin = compose(&joint.origin, &own);
            }
        }
    }
    limbs
}

/// Identifies an arm of `urdf` between `ends` from 200 points in a table with the columns in another order, and with those
/// of joints that are not on the chain. Fails if yourdfpy finds the tool elsewhere in `calibrated.urdf`, or if
/// `calibrated.urdf` is further from the arm in new postures than 1.1 times what plain least squares finds, or is not the arm of `calibrated.toml`.
pub(crate) fn circle(folder: &Path, urdf: &str, ends: &str, others: &[&str], tcp: &str) -> String {
    std::fs::write(folder.join("arm.urdf"), urdf).expect("written");
    let file = format!("{}#{ends}", folder.join("arm.urdf").display());
    let mut real = Real::new(&file, 7);
    let nominal = load_path(&file).expect("a chain").joint_path().expect("a path");
    let rows = real.measured(200);
    let new = real.rows(200);
    let mut table = String::new();
    for (k, name) in nominal.columns.iter().enumerate().rev() {
        table += &format!(
            "{name},{}",
            others.get(k).map_or(String::new(), |other| format!("{other},"))
        );
    }
    table += "x_mm,y_mm,z_mm\n";
    for (q, at) in &rows {
        for (k, q) in q.iter().enumerate().rev() {
            table += &format!("{q},{}", if k < others.len() { "0.25," } else { "" });
        }
        table += &format!("{},{},{}\n", at.x * 1e3, at.y * 1e3, at.z * 1e3);
    }
    std::fs::write(folder.join("table.csv"), table).expect("written");
    let robot = format!("arm.urdf#{ends}");
    let given = [
        "identify",
        "--robot",
        &robot,
        "--data",
        "table.csv",
        "--tool-mm",
        "20,10,80",
        "--out",
        "out",
    ];
    let output = spherecal(folder, &given);
    let said = text(&output.stdout);
    assert_eq!(output.status.code(), Some(0), "{said}{}", text(&output.stderr));

    let root = ends.split_once(':').expect("both ends").0;
    let calibrated = load_path(&format!(
        "{}#{root}:{tcp}",
        folder.join("out/calibrated.urdf").display()
    ))
    .expect("read");
    let path = calibrated.joint_path().expect("a path");
    assert_eq!(path.columns, nominal.columns);
    let found = error_m(&new, |q| point(&path, q, &Vector3::zeros()));
    let (fitted, tool) = plain_fit(std::slice::from_ref(&nominal), 0, std::slice::from_ref(&rows)).remove(0);
    let plain = error_m(&new, |q| point(&fitted, q, &tool));
    println!(
        "{ends}, {} joints: {:.4} mm, plain least squares {:.4} mm, nominal {:.2} mm",
        path.joints.len(),
        found * 1e3,
        plain * 1e3,
        1e3 * error_m(&new, |q| point(&nominal, q, &TOOL_M.into()))
    );
    assert!(found < 1.1 * plain, "{found} m, plain least squares {plain} m");

    by_yourdfpy(folder, &path, (root, tcp), &new);

    // The table holds the hinges, and the file with its slides at zero.
    let other = load_path(&folder.join("out/calibrated.toml").display().to_string()).expect("read");
    for (q, _) in &new {
        let mut at_zero = q.clone();
        for joint in path.joints.iter().filter(|joint| joint.kind == JointKind::Slides) {
            at_zero[joint.terms[0].0] = 0.0;
        }
        let angles = path.table_angles(&path.positions(q));
        let of_table = other.flange_at(&angles).point(&other.tool.tcp());
        let apart = (of_table - point(&path, &at_zero, &Vector3::zeros())).norm();
        assert!(apart < 1e-9, "{apart} m");
    }
    said
}

/// Fails if yourdfpy finds the tool centre point of `calibrated.urdf` elsewhere than its path, by more than 1e-9 m.
pub(crate) fn by_yourdfpy(folder: &Path, path: &JointPath, ends: (&str, &str), rows: &[(Vec<f64>, Vector3<f64>)]) {
    let Some(python) = python() else { return };
    let file = folder.join("out/calibrated.urdf");
    let written = std::fs::read_to_string(&file).expect("a URDF");
    let document = roxmltree::Document::parse(&written).expect("XML");
    let moving = document
        .descendants()
        .filter(|n| n.has_tag_name("joint") && matches!(n.attribute("type"), Some("revolute" | "prismatic")))
        .filter(|n| !n.children().any(|n| n.has_tag_name("mimic")));
    let joints: Vec<&str> = moving.filter_map(|n| n.attribute("name")).collect();
    let one = |(q, _): &(Vec<f64>, Vector3<f64>)| {
        let value = |name: &&str| path.columns.iter().position(|c| c == name).map_or(0.0, |k| q[k]);
        let tip = path.frames(&path.positions(q)).tip;
        let row = |k: usize| {
            json!([
                tip.rotation[(k, 0)],
                tip.rotation[(k, 1)],
                tip.rotation[(k, 2)],
                tip.position[k]
            ])
        };
        let all: Vec<f64> = joints.iter().map(value).collect();
        json!({ "q": all, "pose": [row(0), row(1), row(2), [0, 0, 0, 1]] })
    };
    let cases: Vec<_> = rows.iter().take(50).map(one).collect();
    let wanted = json!({ "base": ends.0, "flange": ends.1, "joints": joints, "cases": cases });
    let given = folder.join("cases.json");
    std::fs::write(&given, wanted.to_string()).expect("written");
    let found = check(&python, "tests/python/check_urdf.py", &[&file, &given]);
    let largest = |name: &str| found[name].as_f64().expect("a number");
    assert!(largest("distance_m").max(largest("rotation")) < 1e-9, "{found}");
    println!("yourdfpy: {found}");
}

const OTHERS: [&str; 8] = [
    "arm_right_1_joint",
    "arm_right_2_joint",
    "arm_right_7_joint",
    "head_1_joint",
    "head_2_joint",
    "gripper_left_joint",
    "gripper_right_joint",
    "arm_right_3_joint",
];

// Fails as `circle` says for nine joints (a humanoid's arm with its torso), or if the other joints' columns are refused or
// left out without a word.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_arm_on_a_torso_is_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    let said = circle(
        folder.path(),
        &humanoid(false),
        "base_link:wrist_left_tool_link",
        &OTHERS,
        "talos_tcp",
    );
    assert!(
        said.contains("columns of joints that are not on the chain are not used"),
        "{said}"
    );
}

// The same for ten: on a rail. Fails if calibrated.urdf keeps the nominal direction of the rail, too.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_arm_on_a_torso_on_a_rail_is_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    circle(
        folder.path(),
        &humanoid(true),
        "world:wrist_left_tool_link",
        &OTHERS,
        "talos_tcp",
    );
}

// The same from one hand to the other, as a gauge that both hold measures it: seven joints up and seven down.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_an_arm_seen_from_the_other_is_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    let ends = "wrist_left_tool_link:wrist_right_tool_link";
    let said = circle(
        folder.path(),
        &humanoid(false),
        ends,
        &["torso_1_joint", "head_1_joint"],
        "talos_tcp",
    );
    assert!(!said.contains("carry the base"), "{said}");
}

// The same for a hand that the camera in the head sees.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_hand_seen_from_the_head_is_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    circle(
        folder.path(),
        &humanoid(true),
        "camera_link:wrist_left_tool_link",
        &["torso_1_joint", "torso_2_joint", "rail_joint"],
        "talos_tcp",
    );
}

// The same for the longest chain.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_twenty_joints_are_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    circle(folder.path(), &hinges(20), "link_0:tool0", &[], "talos_tcp");
}

// Fails if a chain of 21 is taken, one of nine is not shown with its joints and its tip, a wrong tip is refused without
// the one that is near, or an arm of nine reaches a controller's plan.
#[test]
fn a_chain_is_shown_and_one_too_long_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, text) in [("talos", humanoid(false)), ("long", hinges(21))] {
        std::fs::write(folder.path().join(format!("{name}.urdf")), text).expect("written");
    }
    let shown = spherecal(folder.path(), &["robot", "show", "talos.urdf#wrist_left_tool_link"]);
    let words = text(&shown.stdout);
    for word in [
        "9 joints",
        "base_link - torso_1_joint, torso_2_joint, arm_left_1_joint",
        "arm_right_7_joint (revolute",
    ] {
        assert!(words.contains(word), "{words}");
    }
    let refused = |arguments: &[&str], words: &[&str]| {
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        let line = said.trim().lines().last().expect("a line");
        assert!(words.iter().all(|word| line.contains(word)), "{said}");
    };
    let arm = "talos.urdf#base_link:wrist_left_tool_link";
    refused(
        &["robot", "show", "long.urdf"],
        &["has 21 turning joints", "between 1 and 20"],
    );
    refused(
        &["robot", "show", "talos.urdf#wrist_left_tol_link"],
        &["links: wrist_left_tool_link,"],
    );
    let nine = ["the robot has 9 joints and a controller drives at most 8", "BASE:TIP"];
    refused(&["run", "--robot", arm, "--out", "out"], &nine);
    refused(&["plan", "--robot", arm, "--out", "out"], &nine);
    assert!(!folder.path().join("out").exists());
}
