//! `ur-rtde` 1.6.5 from the Python package index, unchanged, against our robot side.
//!
//! It is installed by `scripts/official-clients.sh install`. Where it is missing the test says so and passes, unless
//! `SPHERECAL_REQUIRE_FIELD` is set, as it is in the project's own test run. It connects to port 30004 only.

use std::fs::File;
use std::path::{Path, PathBuf};
use std::process::Command as Process;
use std::sync::{Arc, Mutex};

use spherecal_ur::robot::{ArmCommand, ArmHardware, ArmState, RobotConfig, start_robot};
use spherecal_ur::wire::Series;

use crate::common::{POSE, calibration};

/// Torques that the arm tells, N m.
const MOMENT: [f64; 6] = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0];

fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// The client's Python. `None`, with words, where it is not installed.
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

/// Port 30004 and those below it, which other tests need too.
fn ports() -> File {
    let turn = File::create(std::env::temp_dir().join("spherecal-ur-30004.lock")).expect("a lock file");
    turn.lock().expect("the lock");
    turn
}

/// Runs a script of `tests/python`, which must end well.
fn run(python: &Path, script: &str, argument: Option<String>) {
    // A client that hangs must not hang the tests.
    let output = Process::new("timeout")
        .arg("60")
        .arg(python)
        .arg(root().join("tests/python").join(script))
        .args(argument)
        .output()
        .expect("python runs");
    let (out, err) = (
        String::from_utf8_lossy(&output.stdout),
        String::from_utf8_lossy(&output.stderr),
    );
    assert!(output.status.success(), "{}\n{out}\n{err}", output.status);
    eprintln!("{out}");
}

// Fails if the client does not connect with its own recipe of all outputs, reads another joint angle, mode or pose than the
// robot side has, or sees another period than 2 ms.
#[test]
fn ur_rtde_reads_the_robot_side() {
    let Some(python) = python() else { return };
    let _turn = ports();
    let arm = Arc::new(Mutex::new(ArmState {
        q: POSE,
        moment: MOMENT,
        ..ArmState::default()
    }));
    let side =
        start_robot(RobotConfig::new(Series::ESeries, calibration()), Box::new(arm)).expect("port 30004 is free");
    let dh = calibration();
    let expected = format!(
        r#"{{"q": {POSE:?}, "within": 0, "moment": {MOMENT:?}, "theta": {:?}, "a": {:?}, "d": {:?}, "alpha": {:?}}}"#,
        dh.theta, dh.a, dh.d, dh.alpha
    );
    run(&python, "ur_conformance.py", Some(expected));
    assert_eq!(side.shut_down().broken, 0);
}

/// Six joints of 0.2 kg m² with friction: 0.1 N m s/rad, and 0.05 N m that holds them at rest.
struct Joints {
    q: [f64; 6],
    qd: [f64; 6],
}

impl ArmHardware for Joints {
    fn state(&self) -> ArmState {
        ArmState {
            q: self.q,
            qd: self.qd,
            ..ArmState::default()
        }
    }

    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState {
        for j in 0..6 {
            let torque = match command {
                ArmCommand::Torque(torque) => torque[j],
                ArmCommand::Follow(q, qd) => 40.0 * (q[j] - self.q[j]) + 8.0 * (qd[j] - self.qd[j]),
                ArmCommand::Hold => {
                    self.qd[j] = 0.0;
                    0.0
                }
            };
            let moving = torque - 0.1 * self.qd[j];
            let held = moving.abs() < 0.05 && self.qd[j].abs() < 1e-3;
            if !held {
                self.qd[j] += moving / 0.2 * step_s;
            }
            self.q[j] += self.qd[j] * step_s;
        }
        self.state()
    }
}

// Fails if the client cannot upload its own program, or its torques do not hold the arm for 5 s and turn a joint then.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_ur_rtde_commands_the_torques_of_the_robot_side() {
    let Some(python) = python() else { return };
    let _turn = ports();
    let mut config = RobotConfig::new(Series::ESeries, calibration());
    // The first software that this client commands torques with.
    config.version.minor = 26;
    let arm = Joints { q: POSE, qd: [0.0; 6] };
    let side = start_robot(config, Box::new(arm)).expect("port 30004 is free");
    run(&python, "ur_torque.py", None);
    let statistics = side.shut_down();
    assert_eq!((statistics.broken, statistics.limits), (0, 0));
    assert!(statistics.followed > 2000, "{statistics:?}");
}

// Fails if `servoJ` of the client leaves its path, `speedJ` is not stopped, or `moveJ` does not end at its target.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_ur_rtde_moves_the_robot_side() {
    let Some(python) = python() else { return };
    let _turn = ports();
    let arm = Joints { q: POSE, qd: [0.0; 6] };
    let side =
        start_robot(RobotConfig::new(Series::ESeries, calibration()), Box::new(arm)).expect("port 30004 is free");
    run(&python, "ur_moves.py", None);
    let statistics = side.shut_down();
    assert_eq!((statistics.broken, statistics.limits), (0, 0));
}
