//! ROS 2 bags in: written by the package `rosbags` and by the program's own export.

use std::path::Path;

use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};
use spherecal::model::chain::Chain;
use spherecal::model::robots::{self, RobotModel};

use crate::field::{check, python};
use crate::support;

/// Runs `identify`; its document.
fn identify(folder: &Path, arguments: &[&str]) -> Value {
    let output = support::spherecal(folder, &[&["identify", "--json"], arguments].concat());
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {said}");
    serde_json::from_slice(&output.stdout).expect("JSON")
}

fn refused(folder: &Path, arguments: &[&str]) -> String {
    let output = support::spherecal(folder, &[&["identify"], arguments].concat());
    assert_eq!(output.status.code(), Some(2), "{arguments:?}");
    String::from_utf8_lossy(&output.stderr).into_owned()
}

/// The robot as it is: every angle's zero a little off.
fn rows(model: &RobotModel, count: usize) -> Vec<(Vec<f64>, [f64; 3])> {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(3);
    let mut robot = model.robot.clone();
    for joint in &mut robot.joints {
        joint.mdh.theta += random.random_range(-2e-3..2e-3);
        joint.mdh.a += random.random_range(-3e-4..3e-4);
    }
    let chain = Chain::new(&robot, &model.tool_in_table()).expect("a chain");
    (0..count)
        .map(|_| {
            let q: Vec<f64> = robot.joints.iter().map(|_| random.random_range(-1.2..1.2)).collect();
            let at = chain.pose(&q).position;
            (q, [at.x + 2.0, at.y - 1.0, at.z + 0.5])
        })
        .collect()
}

/// The estimates of both are the same.
fn same_parameters(a: &Value, b: &Value, tolerance: f64) {
    let (a, b) = (
        a["parameters"].as_array().expect("a"),
        b["parameters"].as_array().expect("b"),
    );
    assert!(a.len() == b.len() && a.len() > 10, "{} and {}", a.len(), b.len());
    for (a, b) in a.iter().zip(b) {
        assert_eq!(a["name"], b["name"]);
        let difference = a["estimate"].as_f64().expect("a number") - b["estimate"].as_f64().expect("a number");
        assert!(difference.abs() < tolerance, "{} differs by {difference:e}", a["name"]);
    }
}

// Fails if a bag of the package `rosbags` gives another robot than the table of the same poses: a joint in the order of the
// message, a wrong byte of CDR, a point of the motion between, a compression that is not read.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_bag_of_rosbags_is_the_table_of_its_poses() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let model = robots::built_in("ur5e").expect("built in");
    let rows = rows(&model, 40);
    let mut csv = "q1,q2,q3,q4,q5,q6,x_m,y_m,z_m\n".to_owned();
    for (q, at) in &rows {
        let cells: Vec<String> = q.iter().chain(at).map(f64::to_string).collect();
        csv += &format!("{}\n", cells.join(","));
    }
    std::fs::write(folder.join("poses.csv"), csv).expect("written");
    let table = identify(folder, &["--robot", "ur5e", "--data", "poses.csv", "--out", "of-table"]);
    for (kind, compressed, topics) in [("point", true, ""), ("pose", false, "/joint_states,/measured")] {
        let specification = json!({
            "joints": model.joint_names, "kind": kind, "compressed": compressed,
            "rows": rows.iter().map(|(q, at)| json!({ "q": q, "point": at })).collect::<Vec<_>>(),
        });
        std::fs::write(folder.join("bag.json"), specification.to_string()).expect("written");
        let bag = folder.join(kind);
        check(&python, "tests/python/write_bag.py", &[&folder.join("bag.json"), &bag]);
        let mut arguments = vec!["--robot", "ur5e", "--data", kind, "--out", "of-bag"];
        if !topics.is_empty() {
            arguments.extend(["--topics", topics]);
        }
        let found = identify(folder, &arguments);
        same_parameters(&table, &found, 1e-9);
        let notes = found["notes"].to_string();
        assert!(
            notes.contains("40 poses were formed") && notes.contains("/measured"),
            "{notes}"
        );
        // The file itself is a bag too, and the poses that were formed can be read again.
        let file = folder.join(kind).join(format!("{kind}.mcap"));
        arguments[3] = file.to_str().expect("a path");
        same_parameters(&table, &identify(folder, &arguments), 1e-9);
        let again = identify(
            folder,
            &["--robot", "ur5e", "--data", "of-bag/poses-of-bag.csv", "--out", "again"],
        );
        same_parameters(&table, &again, 1e-9);
    }
    // Poses that the robot may have computed itself are not taken without being named.
    let said = refused(folder, &["--robot", "ur5e", "--data", "pose"]);
    assert!(
        said.contains("/measured (geometry_msgs/msg/PoseStamped)") && said.contains("--topics"),
        "{said}"
    );
    // Another robot's bag.
    let said = refused(folder, &["--robot", "panda", "--data", "point"]);
    assert!(
        said.contains("panda_joint1") && said.contains("shoulder_pan_joint"),
        "{said}"
    );
    assert!(said.contains("--joint-columns"), "{said}");
    // The same joints by the caller's names, as for a description with a prefix.
    let names = model.joint_names.join(",");
    let named = identify(
        folder,
        &[
            "--robot",
            "ur5e",
            "--data",
            "point",
            "--joint-columns",
            &names,
            "--out",
            "named",
        ],
    );
    same_parameters(&table, &named, 1e-9);
}

// Fails if the bag of a run does not lead to the run's calibration: a wrong contact, a pose that is lost, or angles of
// another time. The telemetry has single precision and fewer samples than the controller averages.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_bag_of_a_run_gives_the_robot_of_the_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let spherecal = |arguments: &[&str]| {
        let output = support::spherecal(folder, arguments);
        let said = String::from_utf8_lossy(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {said}");
    };
    spherecal(&["run", "--preset", "typical", "--poses", "24", "--json", "--out", "o"]);
    spherecal(&["export", "--format", "ros2", "--out", "o"]);
    spherecal(&["export", "--csv", "--out", "o"]);
    let common = ["--robot", "iiwa7", "--plate", "paper"];
    let of = |data: &str, out: &str, more: &[&str]| {
        let arguments = ["--data", data, "--out", out];
        identify(folder, &[&common[..], &arguments, more].concat())
    };
    let (table, bag) = (
        of("o/tables/poses.csv", "of-table", &[]),
        of("o/ros2", "of-bag", &["--effort-nm"]),
    );
    let rows = |name: &str| {
        let text = std::fs::read_to_string(folder.join(name)).expect("a table");
        text.lines().filter(|line| !line.starts_with('#')).count()
    };
    assert_eq!(rows("of-bag/poses-of-bag.csv"), rows("o/tables/poses.csv"));
    let error = |document: &Value| {
        document["verdict"]["expected_error_mm"]["mean"]
            .as_f64()
            .expect("an error")
    };
    assert!(
        (error(&table) - error(&bag)).abs() < 0.1 * error(&table),
        "{} and {}",
        error(&table),
        error(&bag)
    );
    let off = |document: &Value| document["residual"]["rms_mm"].as_f64().expect("residuals");
    assert!(
        (off(&table) - off(&bag)).abs() < 0.01,
        "{} and {}",
        off(&table),
        off(&bag)
    );
    // Telemetry itself is a bag of one file.
    let telemetry = of("o/telemetry-run-1.mcap", "of-telemetry", &["--effort-nm"]);
    same_parameters(&bag, &telemetry, 1e-12);
}
