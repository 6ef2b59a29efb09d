//! Wrong arguments of commands: each ends with exit code 2 before anything is planned or written, and
//! the message names the argument, its value and what to give.

use crate::support::{spherecal, text};

/// Arguments, and what the message says.
const WRONG: &[(&[&str], &[&str])] = &[
    (&["run", "--seed", "-1"], &["--seed", "'-1'"]),
    (&["run", "--poses", "-5"], &["--poses", "'-5'"]),
    (&["run", "--poses", "0"], &["--poses is 0", "at least 1"]),
    (&["run", "--accuracy-mm", "-0.5"], &["accuracy_mm", "-0.5"]),
    (&["run", "--robot", "ur6e"], &["ur6e", "ur5e"]),
    (&["run", "--robot", "nowhere.urdf"], &["nowhere.urdf"]),
    (&["run", "--resume", "--robot", "ur5e"], &["--resume", "--robot"]),
    (&["run", "--link", "tcp:nohost"], &["tcp:nohost", "tcp:HOST:PORT"]),
    (&["run", "--config", "nowhere.toml"], &["nowhere.toml", "no such file"]),
    (&["run", "--inject", "nothing"], &["nothing", "human_push"]),
    (
        &["history", "--store", "mysql://robot:secret@db/fleet"],
        &["mysql://", "postgres://", "grpc:HOST:PORT"],
    ),
    (
        &["trend", "--store", "mongodb+srv://db"],
        &["mongodb+srv://", "postgres://"],
    ),
    (&["export", "--format", "excel"], &["excel", "parquet", "csv", "ros2"]),
    (&["export", "--csv", "--format", "ros2"], &["--csv", "--format"]),
    (&["report", "--out", "nowhere"], &["nowhere", "spherecal run"]),
];

// Fails if a wrong argument is taken for another, if the message does not name it, if a secret is
// printed, or if a file is written.
#[test]
fn wrong_arguments_are_named() {
    for (arguments, parts) in WRONG {
        let folder = tempfile::tempdir().expect("a folder");
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        for part in *parts {
            assert!(said.contains(part), "{arguments:?} does not say {part:?}: {said}");
        }
        assert!(!said.contains("secret"), "{arguments:?}: {said}");
        let left = std::fs::read_dir(folder.path()).expect("a folder").count();
        assert_eq!(left, 0, "{arguments:?} left {left} files");
    }
}

// Fails if `--robot` does not choose the robot of a plan, or if the configuration wins over it.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_robot_can_be_an_argument() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("cell.toml"), "robot = \"ur5e\"\n").expect("written");
    for arguments in [
        &["plan", "--robot", "fr3", "--poses", "3"][..],
        &["plan", "--config", "cell.toml", "--robot", "fr3", "--poses", "3"],
    ] {
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(
            output.status.success() && said.contains("fr3: 3 poses"),
            "{arguments:?}: {said}"
        );
    }
}
