//! Client libraries that others wrote, unchanged. Against `spherecal plant --fci` Franka's own: `panda-python` 1.1.1 speaks
//! version 5, `pylibfranka` 0.21.3 version 10. Against `spherecal plant --ur`: `ur-rtde` 1.6.5.
//!
//! `scripts/official-clients.sh install` installs them. The tests of `spherecal-fci` hold them against the bare robot side.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command;

use serde_json::Value;
use spherecal::job::{Config, loaded_model};

use crate::support::{Server, text};

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("..")
}

/// The Python that has the libraries; `None` if they are not installed and need not be.
fn python() -> Option<PathBuf> {
    let python = root().join("target/official-clients/bin/python");
    if python.exists() {
        return Some(python);
    }
    let words = "the official clients are not installed: run scripts/official-clients.sh install";
    assert!(std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(), "{words}");
    eprintln!("left out: {words}");
    None
}

/// Runs the client of this version of the interface against the plant.
fn control(version: &str, robot: &str) {
    let Some(python) = python() else { return };
    // The libraries connect to port 1337 only: one test of one process at a time.
    let turn = File::create(std::env::temp_dir().join("spherecal-fci-1337.lock")).expect("a lock file");
    turn.lock().expect("the lock");
    let config = Config {
        robot: robot.to_owned(),
        ..Config::default()
    };
    let tool = loaded_model(&config).expect("a robot").tool.body;
    let [x, y, z] = tool.com_m;
    let _plant = Server::start(&["plant", "--fci", "--version", version, "--tolerant"]);
    let output = Command::new("timeout")
        .args(["120".as_ref(), python.as_os_str()])
        .arg(root().join("tests/python/fci_conformance.py"))
        .args([version, "plant", &format!("{},{x},{y},{z}", tool.mass_kg)])
        .output()
        .expect("python runs");
    assert!(output.status.success(), "{}", text(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    eprintln!("{found}");
    let reflex = found["reflex"].as_str().unwrap_or_default();
    assert!(reflex.contains("controller_torque_discontinuity"), "{found}");
}

// Fails if libfranka 0.9.2 does not read states of the plant, hold its arm within 1 mrad for 5 s at 1 kHz, get the named
// reflex of a torque jump of 5,000 N m/s, recover, and hold it again.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_panda_python_controls_the_plant() {
    control("5", "panda");
}

// The same with libfranka 0.21.3.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_pylibfranka_controls_the_plant() {
    control("10", "fr3");
}

// Fails if ur-rtde 1.6.5 does not connect to the plant with its recipe of all outputs, or reads other joint angles, modes,
// poses of the flange or periods.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_ur_rtde_reads_the_plant() {
    let Some(python) = python() else { return };
    // It connects to port 30004 only.
    let turn = File::create(std::env::temp_dir().join("spherecal-ur-30004.lock")).expect("a lock file");
    turn.lock().expect("the lock");
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("hand.csv"), "0.1,-1.2,1.3,-1.4,-1.5,0.6\n").expect("a file");
    let _plant = Server::start_in(folder.path(), &["plant", "--ur", "30004", "--guide", "hand.csv"]);
    // The UR5e of its data sheet. The plant's encoders have a noise of 10 urad.
    let expected = r#"{"q": [0.1, -1.2, 1.3, -1.4, -1.5, 0.6], "within": 1e-4, "moment": null, "theta": [0, 0, 0, 0, 0, 0],
        "a": [0, -0.425, -0.3922, 0, 0, 0], "d": [0.1625, 0, 0, 0.1333, 0.0997, 0.0996],
        "alpha": [1.5707963267948966, 0, 0, 1.5707963267948966, -1.5707963267948966, 0]}"#;
    let output = Command::new("timeout")
        .args(["60".as_ref(), python.as_os_str()])
        .arg(root().join("tests/python/ur_conformance.py"))
        .arg(expected)
        .output()
        .expect("python runs");
    assert!(output.status.success(), "{}", text(&output.stderr));
}
