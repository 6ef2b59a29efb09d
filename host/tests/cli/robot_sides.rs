//! Runs over the robots' own interfaces, against the simulated robot sides: two processes in real
//! time. Time is the wall clock's, so these tests bound behaviour, not bits.

use std::net::UdpSocket;
use std::path::Path;

use serde_json::Value;

use crate::support::{Server, spherecal, text};

/// Poses of the short runs: as few as can be identified.
const POSES: &str = "3";

/// Runs over `link`; the robot must record every pose and never stop.
fn run(folder: &Path, link: &str, more: &[&str]) -> Value {
    let arguments = ["run", "--poses", POSES, "--json", "--link", link, "--out", "cell"];
    let output = spherecal(folder, &[&arguments, more].concat());
    let said = text(&output.stderr);
    // Three poses are too few for a result that may be used.
    assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
    let summary: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(summary["poses"]["recorded"], 3, "{said}");
    let drive = &summary["drive"];
    assert_eq!(drive["stops"], 0, "{said}");
    assert!(
        drive["cycles"].as_u64().is_some_and(|cycles| cycles > 20_000),
        "{drive}"
    );
    // Every cycle is in the histogram of the turnaround.
    let bins = drive["turnaround"]["bins"].as_array().expect("a histogram");
    let counted: u64 = bins.iter().filter_map(|bin| bin["count"].as_u64()).sum();
    assert_eq!(Some(counted), drive["cycles"].as_u64());
    let report = std::fs::read_to_string(folder.join("cell/report.html")).expect("a report");
    assert!(report.contains("Real time") && report.contains("turnarounds"));
    summary
}

// Fails if a run over the Franka Control Interface loses a pose, the robot stops it by a reflex, the robot that answers
// is not the one that is calibrated, or the report does not show how the real-time loop did.
#[test]
#[ignore = "timed: 40 s of real time"]
fn timed_a_run_over_the_franka_control_interface() {
    let folder = tempfile::tempdir().expect("a folder");
    let arguments = ["plant", "--fci", "--version", "5", "--listen", "0", "--tolerant"];
    let robot = Server::start(&arguments);
    let summary = run(folder.path(), &robot.peer, &[]);
    assert_eq!(summary["robot"], "panda");
}

// Fails if a run over a robot's own interface does not end where its poses cannot be planned, although the robot is
// connected by then.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_plan_that_cannot_be_made_ends_with_its_reason() {
    let folder = tempfile::tempdir().expect("a folder");
    let robot = Server::start(&["plant", "--fci", "--version", "5", "--listen", "0", "--tolerant"]);
    let far = "robot = \"panda\"\n[[cell.placements]]\norigin_m = [3.0, 0.0, 0.0]\nrpy_rad = [0.0, 0.0, 0.0]\n";
    std::fs::write(folder.path().join("far.toml"), far).expect("a configuration");
    let output = spherecal(folder.path(), &["run", "--config", "far.toml", "--link", &robot.peer]);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("out of"), "{said}");
}

// Fails if a run over KUKA's Fast Robot Interface loses a pose or the cabinet ends the motion.
#[test]
#[ignore = "timed: 40 s of real time"]
fn timed_a_run_over_kukas_fast_robot_interface() {
    let folder = tempfile::tempdir().expect("a folder");
    let probe = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let client = probe.local_addr().expect("an address");
    drop(probe);
    let robot = Server::start(&["plant", "--fri", &client.to_string(), "--tolerant"]);
    let summary = run(folder.path(), &robot.peer, &[]);
    assert_eq!(summary["robot"], "iiwa7");
}

/// A run on an arm that is as hard as real ones: its motors show, so the configuration declares them.
fn hard(robot: &str, link: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let motors = "[cell.drive]\nmotor_kg_m2 = [0.459, 1.1117, 0.8105, 0.4542, 0.348, 0.3505, 0.348]\n";
    let config = format!("robot = \"{robot}\"\n{motors}");
    std::fs::write(folder.path().join("cell.toml"), config).expect("a configuration");
    let summary = run(folder.path(), link, &["--config", "cell.toml"]);
    assert_eq!(summary["robot"], robot);
}

// Fails if the arm whose errors are as large as those of real ones cannot be measured over a robot's own interface, for
// which its motors are declared in the configuration.
#[test]
#[ignore = "long: 40 s of real time"]
fn long_an_arm_as_measured_behind_the_franka_control_interface() {
    let robot = Server::start(&[
        "plant",
        "--fci",
        "--preset",
        "as_measured",
        "--listen",
        "0",
        "--tolerant",
    ]);
    hard("fr3", &robot.peer);
}

#[test]
#[ignore = "long: 40 s of real time"]
fn long_an_arm_as_measured_behind_the_fast_robot_interface() {
    let probe = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let client = probe.local_addr().expect("an address");
    drop(probe);
    let robot = Server::start(&[
        "plant",
        "--fri",
        &client.to_string(),
        "--preset",
        "as_measured",
        "--tolerant",
    ]);
    hard("iiwa7", &robot.peer);
}

// Fails if a controller in a process of its own does not tell its host how punctual it is, or if a cycle is
// missing in what it tells.
#[test]
#[ignore = "long: 40 s of real time"]
fn long_a_controller_of_its_own_tells_its_times() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = "robot = \"panda\"\n[procedure.law]\ntorque_rate_nm_s = 990.0\n";
    std::fs::write(folder.path().join("panda.toml"), config).expect("a configuration");
    let robot = Server::start(&["plant", "--fci", "--version", "5", "--listen", "0", "--tolerant"]);
    let drive = ["controller", "--drive", &robot.peer, "--host-link", "tcp:0", "--once"];
    let controller = Server::start_in(folder.path(), &[&drive[..], &["--config", "panda.toml"]].concat());
    let link = format!("controller:{}", controller.address);
    let summary = run(folder.path(), &link, &["--config", "panda.toml"]);
    let turnaround = &summary["drive"]["turnaround"];
    assert!(
        turnaround["max_us"].as_u64().is_some_and(|us| us > 0 && us < 1_000_000),
        "{turnaround}"
    );
}

// Fails if a link or a plant that cannot be is accepted, or the refusal does not say what to give.
#[test]
fn impossible_robots_are_refused_with_the_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    for (name, content) in [
        ("iiwa.toml", "robot = \"iiwa7\"\n"),
        ("motors.toml", "[cell.drive]\nmotor_kg_m2 = [0, 0, 0, 0, 0, 0]\n"),
        ("slow.toml", "[cell.drive]\nlatency_us = 6000\n"),
    ] {
        std::fs::write(folder.path().join(name), content).expect("a file");
    }
    for (arguments, code, words) in [
        (&["run", "--link", "franka:"][..], 2, "franka:HOST"),
        (&["run", "--link", "fri:0"], 2, "fri:PORT"),
        (&["run", "--link", "franka:127.0.0.1:1"], 1, "activate FCI in Desk"),
        (
            &["run", "--config", "motors.toml"],
            2,
            "has 6 values, but the robot has 7 joints",
        ),
        (&["run", "--config", "slow.toml"], 2, "cell.drive.latency_us is 6000"),
        (&["plant", "--fci", "--version", "3"], 2, "give 4 to 10"),
        (&["plant", "--fci", "--config", "iiwa.toml"], 2, "robot = \"fr3\""),
        (&["plant", "--fci", "--preset", "easy"], 2, "as_measured"),
        (&["plant", "--tolerant"], 2, "give --fci or --fri"),
        (&["plant", "--fri", "127.0.0.1"], 2, "--fri"),
        (&["plant", "--framed"], 2, "--fri"),
        (&["controller", "--drive", "sim"], 2, "franka:HOST"),
        (&["doctor", "--realtime=0"], 2, "0.1 to 3600 seconds"),
    ] {
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
}

// Fails if the measurement needs rights, or does not say whether the machine can hold 1 kHz.
#[test]
fn doctor_measures_the_wake_ups() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = spherecal(folder.path(), &["doctor", "--realtime=0.3", "--json"]);
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    let found = &found["realtime"];
    assert!(found["holds_1_khz"].is_boolean(), "{found}");
    assert!(found["wake_ups"].as_u64().is_some_and(|count| count > 0), "{found}");
    assert!(found["p50_us"].as_u64() <= found["p999_us"].as_u64(), "{found}");
}
