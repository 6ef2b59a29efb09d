//! `ur-rtde` 1.6.5 from the Python package index, unchanged, against our robot side.
//!
//! It is installed by `scripts/official-clients.sh install`. Where it is missing the test says so and passes, unless
//! `SPHERECAL_REQUIRE_FIELD` is set, as it is in the project's own test run. It connects to port 30004 only.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command as Process;
use std::sync::{Arc, Mutex};

use spherecal_ur::robot::{ArmState, RobotConfig, RobotSide};
use spherecal_ur::wire::Series;

use crate::common::{POSE, calibration};

/// Torques that the arm tells, N m.
const MOMENT: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

// Fails if the client does not connect with its own recipe of all outputs, reads another joint angle, mode or pose than the
// robot side has, or sees another period than 2 ms.
#[test]
fn ur_rtde_reads_the_robot_side() {
    let python = root().join("target/official-clients/bin/python");
    if !python.exists() {
        let words = "the official clients are not installed: run scripts/official-clients.sh install";
        assert!(std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(), "{words}");
        eprintln!("left out: {words}");
        return;
    }
    // Other tests need port 30004 too.
    let turn = File::create(std::env::temp_dir().join("spherecal-ur-30004.lock")).expect("a lock file");
    turn.lock().expect("the lock");
    let arm = Arc::new(Mutex::new(ArmState {
        q: POSE,
        moment: MOMENT,
        ..ArmState::default()
    }));
    let side =
        RobotSide::start(RobotConfig::new(Series::ESeries, calibration()), Box::new(arm)).expect("port 30004 is free");
    let dh = calibration();
    let expected = format!(
        r#"{{"q": {POSE:?}, "within": 0, "moment": {MOMENT:?}, "theta": {:?}, "a": {:?}, "d": {:?}, "alpha": {:?}}}"#,
        dh.theta, dh.a, dh.d, dh.alpha
    );
    // A client that hangs must not hang the tests.
    let output = Process::new("timeout")
        .arg("60")
        .arg(python)
        .arg(root().join("tests/python/ur_conformance.py"))
        .arg(expected)
        .output()
        .expect("python runs");
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{}\n{out}\n{err}", output.status);
    eprintln!("{out}");
    assert_eq!(side.shut_down().broken, 0);
}
