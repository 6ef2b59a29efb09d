//! Slides of arms of several kinds.

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal_model::robots::frames::{compose, from_rpy};
use spherecal_model::robots::{RobotModel, load_path};
use spherecal_model::{Pose, Set};

use super::*;

/// Joints `name type axis` in a row, as a file.
fn arm(folder: &std::path::Path, joints: &[(&str, &str, &str)]) -> RobotModel {
    let mut out = "<robot name=\"small\"><link name=\"l0\"/>".to_owned();
    for (k, (name, kind, axis)) in joints.iter().enumerate() {
        let mimic = name.split_once('=').map_or(String::new(), |(_, leader)| {
            format!("<mimic joint=\"{leader}\" multiplier=\"-1\"/>")
        });
        let name = name.split('=').next().unwrap();
        out += &format!(
            "<link name=\"l{}\"/><joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0.05 0.02 0.3\"/><parent \
             link=\"l{k}\"/><child link=\"l{}\"/><axis xyz=\"{axis}\"/>{mimic}<limit lower=\"-2\" upper=\"2\"/></joint>",
            k + 1,
            k + 1
        );
    }
    let n = joints.len();
    out += &format!(
        "<link name=\"tool0\"/><joint name=\"t\" type=\"fixed\"><parent link=\"l{n}\"/><child link=\"tool0\"/></joint></robot>"
    );
    let file = folder.join("arm.urdf");
    std::fs::write(&file, out).unwrap();
    load_path(&file.display().to_string()).unwrap()
}

const TORSO: [(&str, &str, &str); 8] = [
    ("lift", "prismatic", "0 0 1"),
    ("j1", "revolute", "0 0 1"),
    ("j2", "revolute", "0 1 0"),
    ("j3", "revolute", "0 0 1"),
    ("j4", "revolute", "0 1 0"),
    ("j5", "revolute", "0 0 1"),
    ("j6", "revolute", "0 1 0"),
    ("j7", "revolute", "0 0 1"),
];
const SCARA: [(&str, &str, &str); 4] = [
    ("j1", "revolute", "0 0 1"),
    ("j2", "revolute", "0 0 1"),
    ("j3", "prismatic", "0 0 -1"),
    ("j4", "revolute", "0 0 1"),
];
const RAIL: [(&str, &str, &str); 7] = [
    ("rail", "prismatic", "1 0 0"),
    ("j1", "revolute", "0 0 1"),
    ("j2", "revolute", "0 1 0"),
    ("j3", "revolute", "0 1 0"),
    ("j4", "revolute", "1 0 0"),
    ("j5", "revolute", "0 1 0"),
    ("j6", "revolute", "1 0 0"),
];
const PARALLELOGRAM: [(&str, &str, &str); 6] = [
    ("j1", "revolute", "0 0 1"),
    ("j2", "revolute", "0 1 0"),
    ("rod=j2", "revolute", "0 1 0"),
    ("j3", "revolute", "0 1 0"),
    ("slide", "prismatic", "1 0 0"),
    ("j4", "revolute", "0 0 1"),
];

// Fails if the arm of hinges alone, fitted to the points without the slides, is further from them than 1.1 times the
// noise that a least-squares fit of the whole path leaves; for a torso, a SCARA, a rail, and a parallelogram.
#[test]
fn an_arm_of_hinges_is_left() {
    let folder = tempfile::tempdir().unwrap();
    for (name, joints) in [
        ("torso", &TORSO[..]),
        ("SCARA", &SCARA),
        ("rail", &RAIL),
        ("parallelogram", &PARALLELOGRAM),
    ] {
        let model = arm(folder.path(), joints);
        assert!(model.clone().plain().is_err());
        let path = model.joint_path().unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut normal = move || (0..12).map(|_| rng.random::<f64>()).sum::<f64>() - 6.0;
        let mut truth = path.clone();
        for joint in &mut truth.joints {
            let own = Pose {
                rotation: from_rpy([normal() * 2e-3, normal() * 2e-3, normal() * 2e-3]),
                position: Vector3::new(normal(), normal(), normal()) * 1e-3,
            };
            joint.origin = compose(&joint.origin, &own);
        }
        let base = Pose {
            rotation: from_rpy([0.4, -0.3, 2.0]),
            position: Vector3::new(2.0, 1.0, 0.3),
        };
        let tool = Vector3::new(0.05, 0.02, 0.1);
        let rows: Vec<Observation> = (0..200)
            .map(|_| {
                let q: Vec<f64> = path.columns.iter().map(|_| normal().clamp(-2.0, 2.0) * 0.6).collect();
                let tip = compose(&base, &truth.frames(&truth.positions(&q)).tip);
                let noise = Vector3::new(normal(), normal(), normal()) * 1e-4;
                Observation {
                    q,
                    tau: None,
                    target: Target::Point((tip.point(&tool) + noise).into()),
                    set: Set::Calibrate,
                    seat: None,
                }
            })
            .collect();
        let chain = |path: &JointPath, observations: &[Observation]| ChainRows {
            path: path.clone(),
            tool,
            observations: observations.to_vec(),
        };
        let slides = Slides::fit(&[chain(&path, &rows)], 0).unwrap();
        let hinges = model.table_path();
        let moved: Vec<Observation> = rows
            .iter()
            .map(|row| {
                let Target::Point(at) = row.target else { panic!() };
                Observation {
                    q: path.table_angles(&path.positions(&row.q)),
                    target: Target::Point(slides.rest(0, &row.q).point(&at.into()).into()),
                    ..row.clone()
                }
            })
            .collect();
        let left = Slides::fit(&[chain(&hinges, &moved)], 0).unwrap().left_m;
        println!("{name}: {:.4} mm, whole path {:.4} mm", left * 1e3, slides.left_m * 1e3);
        let mut far = Vec::new();
        assert!(slides.left_m < 2e-4, "{name}: {}", slides.left_m);
        assert!(left < 1.1 * slides.left_m, "{name}: {left} after {}", slides.left_m);
        // The arm of the file stands there with its slides at zero.
        for (row, moved) in rows.iter().zip(&moved) {
            let Target::Point(at) = moved.target else { panic!() };
            let mut columns = row.q.clone();
            for joint in path.joints.iter().filter(|joint| joint.kind == JointKind::Slides) {
                columns[joint.terms[0].0] = 0.0;
            }
            let still = compose(&base, &truth.frames(&truth.positions(&columns)).tip).point(&tool);
            far.push((Vector3::from(at) - still).norm());
        }
        let far = spherecal_model::statistics::median(far);
        println!("{name}: {:.4} mm from the arm with its slides at zero", far * 1e3);
        assert!(far < 2.5e-4, "{name}: {far}");
    }
}
