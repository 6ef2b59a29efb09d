//! The official client libraries of the Franka Control Interface, unchanged, against `spherecal plant --fci`:
//! `panda-python` 1.1.1 speaks version 5, `pylibfranka` 0.21.3 version 10.
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

/// Runs the client of this version of the interface against the plant. Left out where it is not installed and need not be.
fn control(version: &str, robot: &str) {
    let python = root().join("target/official-clients/bin/python");
    if !python.exists() {
        let words = "the official clients are not installed: run scripts/official-clients.sh install";
        assert!(std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(), "{words}");
        eprintln!("left out: {words}");
        return;
    }
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
