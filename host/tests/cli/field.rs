//! What leaves the program, as independent readers of the field find it: MCAP,
//! Parquet, URDF, gRPC. `scripts/test` makes a Python with their packages and
//! names it in `SPHERECAL_FIELD_PYTHON`; without it these tests say so and are
//! left out.

use std::path::{Path, PathBuf};
use std::process::Command;

use rand::{RngExt as _, SeedableRng as _};
use serde_json::{Value, json};
use spherecal::model::robots::{self, RobotModel};

use crate::support::{self, Server};

pub(crate) fn python() -> Option<String> {
    let python = std::env::var("SPHERECAL_FIELD_PYTHON").ok();
    if python.is_none() {
        assert!(
            std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(),
            "SPHERECAL_FIELD_PYTHON is not set: scripts/test makes one"
        );
        eprintln!("left out: no Python is named in SPHERECAL_FIELD_PYTHON");
    }
    python
}

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// Runs one of the scripts; its last line is JSON.
pub(crate) fn check(python: &str, script: &str, arguments: &[&Path]) -> Value {
    let output = Command::new(python)
        .arg(root().join(script))
        .args(arguments)
        .output()
        .expect("Python");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{script}: {said}");
    let text = String::from_utf8_lossy(&output.stdout);
    serde_json::from_str(text.lines().last().unwrap_or_default()).unwrap_or_else(|e| panic!("{script}: {e}: {text}"))
}

fn spherecal(folder: &Path, arguments: &[&str]) -> String {
    let output = support::spherecal(folder, arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{arguments:?}: {said}");
    String::from_utf8_lossy(&output.stdout).into_owned()
}

// Fails if the telemetry has a wrong checksum, a message that the definition of its type does not describe, times that go
// back, an index that counts otherwise, other joints or other angles than the controller recorded, or more bytes than a
// second of a run may have; or if a table is another for Arrow than for a reader of CSV.
#[cfg(feature = "parquet")]
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_telemetry_and_tables_are_read_by_others() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let now_ns = || {
        let since = std::time::SystemTime::now().duration_since(std::time::UNIX_EPOCH);
        since.expect("after 1970").as_nanos() as f64
    };
    let begin_ns = now_ns();
    let summary: Value =
        serde_json::from_str(&spherecal(folder, &["run", "--poses", "6", "--json", "--out", "o"])).expect("JSON");
    let end_ns = now_ns();
    let mcap = check(
        &python,
        "tests/python/check_mcap.py",
        &[&folder.join("o/telemetry-run-1.mcap")],
    );
    let seconds = summary["simulated_s"].as_f64().expect("simulated_s");
    // The rate depends on what happens: 50 Hz at least, 1 kHz at most.
    let count = mcap["counts"]["/joint_states"].as_f64().expect("/joint_states");
    assert!(
        (50.0 * seconds..1e3 * seconds).contains(&(count + 8.0)),
        "{count} in {seconds} s"
    );
    for topic in ["/control", "/wrench"] {
        assert_eq!(mcap["counts"][topic].as_f64(), Some(count), "{topic}");
    }
    let bytes = std::fs::metadata(folder.join("o/telemetry-run-1.mcap"))
        .expect("a file")
        .len();
    // A main run of 400 s may have 10 MB. It has 5: a short run has more contacts a second, which are recorded at the full rate.
    let most = 10e6 / 400.0 * seconds;
    assert!((bytes as f64) < most, "{bytes} bytes of {seconds} s, {most} at most");
    // UTC: the first message was written during the run, and the arm's time passes from there.
    let first_ns = mcap["first_ns"].as_f64().expect("a time");
    assert!(
        (begin_ns - 1e9..end_ns + 1e9).contains(&first_ns),
        "{first_ns} not in {begin_ns} to {end_ns}"
    );
    let lasts_s = (mcap["last_ns"].as_f64().expect("a time") - first_ns) * 1e-9;
    assert!((lasts_s - seconds).abs() < 0.05 * seconds, "{lasts_s} s of {seconds} s");
    // The frames end where the controller computes the TCP.
    assert!(mcap["instants"].as_f64() > Some(100.0), "{mcap}");
    assert!(mcap["distance_m"].as_f64() < Some(5e-6), "{mcap}");
    assert_eq!(mcap["types"]["/tf"], "tf2_msgs/msg/TFMessage");
    assert_eq!(mcap["types"]["/joint_states"], "sensor_msgs/msg/JointState");
    let model = robots::built_in("iiwa7").expect("built in");
    let urdf = robots::write_urdf(&model, &model.rows(), &[]);
    assert_eq!(mcap["joints"], json!(joint_names(&urdf)));
    // The file has some of the samples that the controller averages.
    let recordings = mcap["recordings"].as_array().expect("recordings");
    assert_eq!(recordings.len(), 6, "{mcap}");
    for pair in recordings {
        let [seen, told] = [0, 1].map(|k| pair[k].as_f64().expect("an angle"));
        assert!((seen - told).abs() < 2e-5, "{seen} and {told} rad");
    }
    assert_eq!(mcap["counts"]["/robot_description"], 1);
    assert!(mcap["counts"]["/events"].as_f64() > Some(20.0), "{mcap}");
    spherecal(folder, &["export", "--parquet", "--out", "o"]);
    spherecal(folder, &["export", "--csv", "--out", "o"]);
    let rows = check(&python, "tests/python/check_tables.py", &[&folder.join("o/tables")]);
    assert_eq!(rows["recordings"], 6, "{rows}");
    assert_eq!(rows["telemetry"].as_f64(), Some(count), "{rows}");
    // The bag has the same signals for a reader of ROS 2.
    spherecal(folder, &["export", "--format", "ros2", "--out", "o"]);
    let bag = [folder.join("o/ros2"), folder.join("o/telemetry-run-1.mcap")];
    let bag = check(&python, "tests/python/check_ros2.py", &[&bag[0], &bag[1]]);
    for topic in ["/joint_states", "/wrench", "/tf"] {
        assert_eq!(bag["counts"][topic], mcap["counts"][topic], "{topic}");
    }
    assert_eq!(
        bag["counts"]["/contact"].as_u64(),
        summary["poses"]["recorded"].as_u64(),
        "{bag}"
    );
}

// Fails if a bag is made of a run that has no telemetry, or if the answer does not say what to do.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_bag_needs_telemetry() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    spherecal(folder, &["run", "--poses", "3", "--json", "--out", "o"]);
    for file in std::fs::read_dir(folder.join("o")).expect("a folder").flatten() {
        if file.file_name().to_string_lossy().starts_with("telemetry") {
            std::fs::remove_file(file.path()).expect("removed");
        }
    }
    let output = support::spherecal(folder, &["export", "--format", "ros2", "--out", "o"]);
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(
        said.contains("no telemetry of run 1") && said.contains("--format csv"),
        "{said}"
    );
}

/// Our forward kinematics of a model, in the file's frames, at 100 configurations.
fn cases(model: &RobotModel, file: &Path, joints: &[String]) {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(4);
    let cases: Vec<Value> = (0..100)
        .map(|_| {
            let q: Vec<f64> = model
                .robot
                .joints
                .iter()
                .map(|j| random.random_range(j.limits.min_rad..j.limits.max_rad))
                .collect();
            let flange = model.flange_at(&q);
            let row = |k: usize| {
                let r = &flange.rotation;
                json!([r[(k, 0)], r[(k, 1)], r[(k, 2)], flange.position[k]])
            };
            json!({ "q": q, "pose": [row(0), row(1), row(2), [0, 0, 0, 1]] })
        })
        .collect();
    let (base, flange) = &model.frame_names;
    let document = json!({ "base": base, "flange": flange, "joints": joints, "cases": cases });
    std::fs::write(file, document.to_string()).expect("written");
}

/// Names of the moving joints of a URDF, in order.
fn joint_names(urdf: &str) -> Vec<String> {
    let document = roxmltree::Document::parse(urdf).expect("XML");
    document
        .descendants()
        .filter(|n| n.has_tag_name("joint") && n.attribute("type") == Some("revolute"))
        .map(|n| n.attribute("name").expect("a name").to_owned())
        .collect()
}

// Fails if a URDF that was written, nominal or calibrated, built in or the
// user's, is another robot for an independent parser and its kinematics: by
// more than 1e-9 m or as much in rotation, at 100 configurations.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_urdfs_are_the_same_robot_for_another_parser() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let same = |urdf: &Path, model: &RobotModel| {
        let text = std::fs::read_to_string(urdf).expect("a URDF");
        let file = folder.join("cases.json");
        cases(model, &file, &joint_names(&text));
        let found = check(&python, "tests/python/check_urdf.py", &[urdf, &file]);
        let largest = found["distance_m"]
            .as_f64()
            .expect("m")
            .max(found["rotation"].as_f64().expect("rotation"));
        assert!(largest < 1e-9, "{}: {found}", urdf.display());
        assert_eq!(found["cases"], 100);
    };
    let data = root().join("tests/data");
    // The run's arm, and users' arms of 6 and 7 axes from tables of their own.
    spherecal(folder, &["run", "--poses", "9", "--out", "run"]);
    let mut robots = vec![("iiwa7".to_owned(), "run")];
    for (name, out) in [("ur5e", "six"), ("irb120", "other"), ("panda", "seven")] {
        let urdf = data.join(format!("{name}.urdf"));
        let nominal = robots::load(&urdf.display().to_string()).expect("a robot");
        let csv = folder.join(format!("{out}.csv"));
        std::fs::write(&csv, table(&nominal)).expect("written");
        let robot = urdf.display().to_string();
        spherecal(
            folder,
            &[
                "identify",
                "--robot",
                &robot,
                "--data",
                &csv.display().to_string(),
                "--out",
                out,
            ],
        );
        robots.push((robot, out));
    }
    for (robot, out) in robots {
        let nominal = robots::load(&robot).expect("a robot");
        let written = folder.join(format!("{out}-nominal.urdf"));
        spherecal(folder, &["robot", "convert", &robot, &written.display().to_string()]);
        same(&written, &nominal);
        let calibrated = robots::load(&folder.join(out).join("calibrated.toml").display().to_string()).expect("TOML");
        let mut model = nominal.clone();
        model.robot = calibrated.robot;
        assert_ne!(model.rows(), nominal.rows(), "{robot}: nothing was calibrated");
        same(&folder.join(out).join("calibrated.urdf"), &model);
    }
}

// Fails if the joint origins that were written with the vendors' keys, nominal or
// calibrated, are another robot for an independent reader of YAML and the vendors'
// own order of frames: by more than 1e-9 m or as much in rotation.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_joint_origins_are_the_same_robot_for_another_reader() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let data = root().join("tests/data");
    let same = |yaml: &Path, model: &RobotModel| {
        let file = folder.join("cases.json");
        cases(model, &file, &[]);
        let found = check(&python, "tests/python/check_kinematics.py", &[yaml, &file]);
        let largest = found["distance_m"]
            .as_f64()
            .expect("m")
            .max(found["rotation"].as_f64().expect("rotation"));
        assert!(largest < 1e-9, "{}: {found}", yaml.display());
        assert_eq!(found["cases"], 100);
    };
    let irb120 = data.join("irb120.urdf").display().to_string();
    let panda = data.join("panda.urdf").display().to_string();
    for (robot, out) in [("ur5e", "six"), (panda.as_str(), "seven"), (irb120.as_str(), "other")] {
        let nominal = robots::load(robot).expect("a robot");
        let csv = folder.join(format!("{out}.csv"));
        std::fs::write(&csv, table(&nominal)).expect("written");
        let arguments = [
            "identify",
            "--robot",
            robot,
            "--data",
            &csv.display().to_string(),
            "--out",
            out,
        ];
        spherecal(folder, &arguments);
        // The nominal origins, those of the calibration, and those of its TOML.
        let (convert, again) = (
            folder.join(format!("{out}-nominal.yaml")),
            folder.join(format!("{out}-again.yaml")),
        );
        let written = folder.join(out).join("calibrated.toml").display().to_string();
        spherecal(folder, &["robot", "convert", robot, &convert.display().to_string()]);
        spherecal(folder, &["robot", "convert", &written, &again.display().to_string()]);
        let mut model = nominal.clone();
        model.robot = robots::load(&written).expect("TOML").robot;
        assert_ne!(model.rows(), nominal.rows(), "{robot}: nothing was calibrated");
        let calibrated = folder.join(out).join("kinematics.yaml");
        if out == "other" {
            // The last frame of a plain file is that of the last joint.
            for yaml in [&convert, &calibrated] {
                same(yaml, &robots::load(&yaml.display().to_string()).expect("YAML"));
            }
            continue;
        }
        same(&convert, &nominal);
        same(&calibrated, &model);
        if out == "six" {
            same(&again, &model);
        }
    }
}

/// A user's table: what a tracker saw of an arm that is not built as drawn.
pub(crate) fn table(nominal: &RobotModel) -> String {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(5);
    let mut real = nominal.clone();
    for joint in real.robot.joints.iter_mut().skip(1) {
        joint.mdh.a += 3e-4 * random.random_range(-1.0..1.0);
        joint.mdh.alpha += 5e-4 * random.random_range(-1.0..1.0);
        joint.mdh.theta += 8e-4 * random.random_range(-1.0..1.0);
    }
    let names = (1..=nominal.robot.dof()).map(|k| format!("q{k}"));
    let mut out = names
        .chain(["x_mm", "y_mm", "z_mm"].map(str::to_owned))
        .collect::<Vec<_>>()
        .join(",");
    out.push('\n');
    for _ in 0..80 {
        let q: Vec<f64> = real
            .robot
            .joints
            .iter()
            .map(|j| 0.6 * random.random_range(j.limits.min_rad..j.limits.max_rad).clamp(-3.0, 3.0))
            .collect();
        let flange = real.flange_at(&q);
        let tcp = flange.rotation * nalgebra::Vector3::from(real.tool.tcp_m) + flange.position;
        let numbers = q.iter().map(|q| format!("{q:.9}"));
        let point = tcp.iter().map(|m| format!("{:.6}", 1e3 * m));
        out.push_str(&numbers.chain(point).collect::<Vec<_>>().join(","));
        out.push('\n');
    }
    out
}

// Fails if the example client in Python does not touch, record every pose of
// the first sphere and let go.
#[cfg(feature = "services")]
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_python_client_records_a_sphere() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    spherecal(folder, &["plan", "--poses", "6", "--seed", "5", "--out", "cell"]);
    let server = Server::start_in(folder, &["serve", "--grpc", "0", "--seed", "5", "--service", "robot"]);
    let output = Command::new(&python)
        .arg(root().join("examples/python/grpc_client.py"))
        .args([&server.address, "cell/plan.json"])
        .current_dir(folder)
        .output()
        .expect("Python");
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "{said}");
    assert!(
        said.contains("contact at ") && said.contains("iiwa7, 7 joints"),
        "{said}"
    );
    let plan: Value =
        serde_json::from_str(&std::fs::read_to_string(folder.join("cell/plan.json")).expect("plan")).expect("JSON");
    let poses = plan["spheres"][0]["poses"].as_array().expect("poses").iter();
    let wanted: Vec<u64> = poses
        .filter(|p| p["via"] == false)
        .filter_map(|p| p["id"].as_u64())
        .collect();
    let text = String::from_utf8_lossy(&output.stdout);
    let recordings: Vec<Value> = text.lines().map(|l| serde_json::from_str(l).expect("JSON")).collect();
    let recorded: Vec<u64> = recordings.iter().filter_map(|r| r["pose"].as_u64()).collect();
    assert!(!wanted.is_empty());
    assert_eq!(recorded, wanted);
    assert!(recordings.iter().all(|r| r["samples"] == 200), "{text}");
}

// Fails if the report asks the network for anything, has an error or a warning
// in the browser, a figure that is empty, a part that is wider than a page or a
// telephone, or text that is hard to read in the light or in the dark.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_report_renders_in_a_browser() {
    let Some(python) = python() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    spherecal(folder, &["run", "--poses", "9", "--out", "o"]);
    for width in ["1000", "380"] {
        let found = check(
            &python,
            "tests/python/check_report.py",
            &[&folder.join("o/report.html"), &folder.join("shots"), Path::new(width)],
        );
        assert_eq!(found["requests"], json!([]), "{found}");
        assert_eq!(found["errors"], json!([]), "{found}");
        assert_eq!(found["empty_figures"], 0, "{found}");
        assert_eq!(found["too_wide"], 0, "{width}: {found}");
        assert!(found["figures"].as_u64().is_some_and(|n| n >= 9), "{found}");
        for scheme in ["contrast_light", "contrast_dark"] {
            assert!(found[scheme].as_f64().is_some_and(|c| c > 7.0), "{found}");
        }
        let headings = found["headings"].to_string();
        for heading in [
            "Accuracy",
            "Remarks",
            "Parameters",
            "Correlations",
            "Contacts",
            "Provenance",
        ] {
            assert!(headings.contains(heading), "{headings}");
        }
    }
    let printed = folder.join("shots/print.png");
    assert!(printed.metadata().is_ok_and(|m| m.len() > 50_000));
}
