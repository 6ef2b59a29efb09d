//! What `identify` says of a table that is not what it should be, from the command line to the option that puts it right.

use std::path::Path;

use spherecal::model::Pose;
use spherecal::model::robots::frames::inverse;
use spherecal::model::robots::{self, RobotModel};

use crate::sources::{identify, mm, rows, table};
use crate::support::{spherecal, text};

const POINTS: &str = "q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm";
const POSES: &str = "q1,q2,q3,q4,q5,q6,x_mm,y_mm,z_mm,r11,r12,r13,r21,r22,r23,r31,r32,r33";

fn ur5e() -> RobotModel {
    robots::built_in("ur5e").expect("built in")
}

/// A pose as cells: position in mm, and the rotation row by row.
fn pose(at: &Pose<f64>) -> Vec<f64> {
    [mm(at), at.rotation.transpose().iter().copied().collect()].concat()
}

/// Fails if a table is taken, if its refusal does not name the option, or if the option does not put it right.
fn named(folder: &Path, data: &str, option: &[&str]) {
    let (code, said, error) = identify(folder, data, "ur5e", &[]);
    assert_eq!(code, Some(2), "{option:?}: {said}{error}");
    assert!(error.contains(&option.join(" ")), "{option:?}: {error}");
    let (code, said, error) = identify(folder, data, "ur5e", option);
    assert!(matches!(code, Some(0 | 3)), "{option:?}: {error}");
    assert!(said.contains("corrected as asked"), "{said}");
}

// Fails if a column in degrees, points of a left-handed frame, poses of the instrument as the tool sees it, or measurements that
// are one row late are not named with the option that corrects them.
#[test]
fn further_mistakes_are_named_with_the_option_that_corrects_them() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let sound = rows(&ur5e(), 40);
    let mut one = sound.clone();
    for (q, _) in &mut one {
        q[3] = q[3].to_degrees();
    }
    // Degrees are no angles in rad: the cell says so.
    let degrees = table(POINTS, &one, ",", 1.0, mm);
    let (code, _, error) = identify(folder, &degrees, "ur5e", &[]);
    assert!(
        code == Some(2) && error.contains("column q4") && error.contains("_deg if it is in degrees"),
        "{error}"
    );
    let (code, said, error) = identify(folder, &degrees, "ur5e", &["--joint-unit", "4=deg"]);
    assert!(code == Some(0) && said.contains("corrected as asked"), "{said}{error}");
    let named_so = degrees.replacen("q4", "q4_deg", 1);
    let (code, said, error) = identify(folder, &named_so, "ur5e", &[]);
    assert_eq!(code, Some(0), "{said}{error}");
    let mirrored = |at: &Pose<f64>| {
        let at = mm(at);
        vec![at[0], -at[1], at[2]]
    };
    named(folder, &table(POINTS, &sound, ",", 1.0, mirrored), &["--mirror-points"]);
    let inverted = table(POSES, &sound, ",", 1.0, |at| pose(&inverse(at)));
    named(folder, &inverted, &["--invert-poses"]);
    let late: Vec<_> = sound.windows(2).map(|pair| (pair[1].0.clone(), pair[0].1)).collect();
    named(folder, &table(POINTS, &late, ",", 1.0, mm), &["--shift-rows", "1"]);
}

// Fails if a tool in m or the other way round is not named by `--explain`.
#[test]
fn a_wrong_tool_is_named() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(
        folder.path().join("t.csv"),
        table(POINTS, &rows(&ur5e(), 60), ",", 1.0, mm),
    )
    .expect("written");
    for (given, words) in [("0.02,0.01,0.12", "in m"), ("-20,-10,-120", "--tool-mm ")] {
        let tool = format!("--tool-mm={given}");
        let output = spherecal(
            folder.path(),
            &["identify", "--robot", "ur5e", "--data", "t.csv", &tool, "--explain"],
        );
        let said = text(&output.stdout) + &text(&output.stderr);
        assert_eq!(output.status.code(), Some(0), "{said}");
        assert!(said.contains(words) && said.contains("--tool-mm "), "{given}: {said}");
    }
}

// Fails if points that the controller computed, or joints that hardly move, are not named before the fit, with the joints by
// their numbers.
#[test]
fn points_of_a_controller_and_still_joints_are_named_first() {
    let folder = tempfile::tempdir().expect("a folder");
    let model = ur5e();
    let path = model.joint_path().expect("a path");
    let mut own = rows(&model, 40);
    for (q, at) in &mut own {
        *at = path.frames(&path.positions(q)).tip;
        at.position = at.point(&nalgebra::Vector3::new(0.02, 0.01, 0.12));
    }
    let (_, said, error) = identify(folder.path(), &table(POINTS, &own, ",", 1.0, mm), "ur5e", &[]);
    assert!(
        error.contains("the controller computed them, nothing measured them"),
        "{said}{error}"
    );
    // Joints 1 to 3 move by less than half a degree.
    let mut still = rows(&model, 40);
    for (k, (q, at)) in still.iter_mut().enumerate() {
        for (joint, q) in q.iter_mut().take(3).enumerate() {
            *q = 0.3 * (joint as f64 - 1.0) - 1e-3 * (k % 4) as f64;
        }
        *at = path.frames(&path.positions(q)).tip;
        at.position =
            at.point(&nalgebra::Vector3::new(0.02, 0.01, 0.12)) + nalgebra::Vector3::repeat(1e-4 * (k % 3) as f64);
    }
    let (_, said, error) = identify(folder.path(), &table(POINTS, &still, ",", 1.0, mm), "ur5e", &[]);
    for joint in 1..=3 {
        assert!(
            error.contains(&format!("joint {joint} moves by 0.2 degrees alone")),
            "{said}{error}"
        );
    }
    assert!(!error.contains("joint 4 moves"), "{error}");
}
