//! What goes wrong before a run: forty clumsy mistakes. Each ends before the poses are planned, with exit code 2 and
//! a message that names what is wrong and what to give; and nothing is written.

use std::net::UdpSocket;
use std::path::Path;

use crate::support::{spherecal, text};

/// Files with which mistakes are made: name and content.
const FILES: &[(&str, &str)] = &[
    ("a-file", "no database and no folder\n"),
    ("unknown.toml", "nonsense = 1\n"),
    ("nested.toml", "[cell.tool]\nmass = 1.0\n"),
    ("text.toml", "seed = \"x\"\n"),
    ("broken.toml", "[cell\n"),
    ("mass.toml", "[cell.tool]\nmass_kg = -1.0\n"),
    ("trigger.toml", "[procedure.approach]\ntrigger_n = -5\n"),
    ("nan.toml", "[cell.tool]\nmass_kg = nan\n"),
    ("robot.toml", "robot = \"ur5x\"\n"),
    ("robot.urdf", "<robot name=\"x\"><link name=\"a\"/></robot>\n"),
];

/// What the mistake is, arguments, and what the message says.
type Mistake = (&'static str, &'static [&'static str], &'static [&'static str]);

const MISTAKES: &[Mistake] = &[
    (
        "no such configuration",
        &["run", "--config", "none.toml"],
        &["none.toml: there is no such file"],
    ),
    (
        "a folder as a configuration",
        &["run", "--config", "folder"],
        &["folder: is a directory"],
    ),
    (
        "an unknown field",
        &["run", "--config", "unknown.toml"],
        &["line 1: `nonsense` is not known here", "config --print"],
    ),
    (
        "a field misspelt in a section",
        &["run", "--config", "nested.toml"],
        &["line 2: `mass` is not known here", "`mass_kg`"],
    ),
    (
        "text in place of a number",
        &["run", "--config", "text.toml"],
        &["line 1: found the text \"x\"", "whole number"],
    ),
    (
        "broken TOML",
        &["run", "--config", "broken.toml"],
        &["broken.toml: line 1"],
    ),
    (
        "a negative mass",
        &["run", "--config", "mass.toml"],
        &["cell.tool.mass_kg is -1", "from 0 to 1000"],
    ),
    (
        "a mass that is no number",
        &["run", "--config", "nan.toml"],
        &["cell.tool.mass_kg"],
    ),
    (
        "a negative force",
        &["run", "--config", "trigger.toml"],
        &["procedure.approach.trigger_n is -5", "0.5 to 100"],
    ),
    (
        "an unknown robot in the configuration",
        &["run", "--config", "robot.toml"],
        &["ur5x", "did you mean ur5e?"],
    ),
    (
        "an unknown robot",
        &["run", "--robot", "ur5x"],
        &["\"ur5x\" is neither built in nor a file", "did you mean ur5e?"],
    ),
    (
        "no such robot file",
        &["run", "--robot", "none.urdf"],
        &["none.urdf: there is no such file"],
    ),
    (
        "a robot without joints",
        &["run", "--robot", "robot.urdf"],
        &["robot.urdf", "joint"],
    ),
    (
        "a file that says not what it is",
        &["run", "--robot", "a-file"],
        &["a-file", ".urdf"],
    ),
    ("no poses", &["run", "--poses", "0"], &["--poses is 0", "at least 1"]),
    ("poses in words", &["run", "--poses", "many"], &["--poses", "many"]),
    (
        "poses twice",
        &["run", "--paper", "--poses", "5"],
        &["--paper", "--poses"],
    ),
    ("a seed in words", &["run", "--seed", "lucky"], &["--seed", "lucky"]),
    (
        "an accuracy of zero",
        &["run", "--accuracy-mm", "0"],
        &["accuracy_mm is 0", "positive"],
    ),
    (
        "a negative accuracy",
        &["plan", "--accuracy-mm", "-1"],
        &["accuracy_mm is -1", "positive"],
    ),
    (
        "an unknown link",
        &["run", "--link", "usb:1"],
        &["\"usb:1\" is not a link", "tcp:HOST:PORT"],
    ),
    (
        "a link without a port",
        &["run", "--link", "tcp:robot"],
        &["\"tcp:robot\" is not a link", "tcp:HOST:PORT"],
    ),
    (
        "a port that cannot be",
        &["run", "--link", "tcp:robot:99999"],
        &["\"tcp:robot:99999\" is not a link", "tcp:HOST:PORT"],
    ),
    (
        "port 0 of another machine",
        &["run", "--link", "controller:robot:0"],
        &["is not a link", "controller:HOST:PORT"],
    ),
    (
        "a robot without a host",
        &["run", "--link", "franka:"],
        &["\"franka:\" is not a link", "franka:HOST"],
    ),
    (
        "a device that is not there",
        &["run", "--link", "serial:/dev/no-board"],
        &["serial:/dev/no-board"],
    ),
    (
        "a rate in words",
        &["measure", "--link", "serial:/dev/null@fast"],
        &["bits per second", "921600"],
    ),
    (
        "an unknown kind of database",
        &["run", "--store", "mysql://robot:secret@db/fleet"],
        &["mysql://", "postgres://"],
    ),
    (
        "a file that is no database",
        &["run", "--store", "a-file"],
        &["a-file is not a calibration database", "nothing was changed"],
    ),
    (
        "a tracker without an address",
        &["run", "--tracker", "laser"],
        &["--tracker", "grpc:HOST:PORT"],
    ),
    (
        "a page elsewhere without an address",
        &["run", "--publish", "fleet"],
        &["--publish", "grpc:HOST:PORT"],
    ),
    (
        "a file as a folder",
        &["run", "--out", "a-file"],
        &["--out is a-file", "give a folder"],
    ),
    (
        "a folder where none can be made",
        &["run", "--out", "/proc/x"],
        &["nothing can be written into /proc", "give another folder"],
    ),
    (
        "such a folder for a table of poses",
        &[
            "identify", "--robot", "iiwa7", "--data", "a-file", "--plate", "paper", "--out", "/proc/x",
        ],
        &["nothing can be written into /proc"],
    ),
    (
        "such a folder for a plan",
        &["plan", "--out", "/proc/x"],
        &["nothing can be written into /proc"],
    ),
    (
        "such a folder for a commissioning",
        &["commission", "--link", "fri:30299", "--out", "/proc/x"],
        &["nothing can be written into /proc"],
    ),
    (
        "no such fault",
        &["run", "--inject", "earthquake"],
        &["\"earthquake\"", "human_push"],
    ),
    (
        "no such waypoints",
        &["run", "--waypoints", "none.toml"],
        &["none.toml: there is no such file", "spherecal teach"],
    ),
    (
        "a page at no port",
        &["run", "--serve", "page"],
        &["\"page\" is not an address", "HOST:PORT"],
    ),
    (
        "a page at a port that cannot be",
        &["run", "--serve", "99999"],
        &["99999", "HOST:PORT"],
    ),
    (
        "no such token",
        &["run", "--serve", "0", "--token-file", "none"],
        &["none"],
    ),
    (
        "no such certificate",
        &["run", "--serve", "0", "--tls-cert", "none.pem", "--tls-key", "none.key"],
        &["none.pem"],
    ),
    (
        "nothing to continue",
        &["run", "--resume"],
        &["there is no database", "spherecal run"],
    ),
    (
        "another robot for a run that goes on",
        &["run", "--resume", "--robot", "ur5e"],
        &["--resume", "--robot"],
    ),
    (
        "nothing to report",
        &["report", "--out", "none"],
        &["there is no database at none", "spherecal run"],
    ),
    (
        "nothing to validate",
        &["validate", "--out", "none"],
        &["there is no database at none", "spherecal run"],
    ),
    (
        "a limit of zero",
        &["trend", "--limit-mm", "0"],
        &["--limit-mm", "positive number of mm"],
    ),
    (
        "a study",
        &["reproduce", "--world", "W1"],
        &["`reproduce` is a study", "`spherecal-lab reproduce`"],
    ),
    (
        "help of a study",
        &["-v", "worlds", "--help"],
        &["`spherecal-lab worlds`"],
    ),
    (
        "a study of faults",
        &["faults", "--campaign", "9"],
        &["`spherecal-lab faults`"],
    ),
    ("a long run", &["soak", "--hours", "1"], &["`spherecal-lab soak`"]),
    (
        "half a plate",
        &[
            "init",
            "--robot",
            "ur5e",
            "--serial",
            "A",
            "--plate",
            "1,2",
            "--tool-mass-kg",
            "1",
        ],
        &["--plate is \"1,2\"", "1-2, 1-3 and 2-3"],
    ),
    (
        "a tool that the robot cannot carry",
        &[
            "init",
            "--robot",
            "ur5e",
            "--serial",
            "A",
            "--plate",
            "paper",
            "--tool-mass-kg",
            "99",
        ],
        &["--tool-mass-kg is 99", "payload of 5 kg"],
    ),
    ("a misspelt command", &["runn"], &["runn", "'run'"]),
];

/// Names of what is in a folder.
fn names(folder: &Path) -> Vec<String> {
    let entries = std::fs::read_dir(folder).expect("a folder");
    let mut names: Vec<String> = entries
        .map(|entry| entry.expect("an entry").file_name().to_string_lossy().into_owned())
        .collect();
    names.sort();
    names
}

// Fails if a mistake is not refused with exit code 2 before the poses are planned, if the message does not
// name it and what to give, if a secret is printed, or if a file is written or changed.
#[test]
fn forty_mistakes_end_before_planning() {
    assert!(MISTAKES.len() >= 40, "{}", MISTAKES.len());
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::create_dir(folder.join("folder")).expect("made");
    for (name, content) in FILES {
        std::fs::write(folder.join(name), content).expect("written");
    }
    let before = names(folder);
    let mut wrong = Vec::new();
    for (what, arguments, parts) in MISTAKES {
        let output = spherecal(folder, arguments);
        let said = text(&output.stderr);
        let missing: Vec<_> = parts.iter().filter(|part| !said.contains(**part)).collect();
        let code = output.status.code();
        let planned = said.contains("planning the poses") || said.contains("poses chosen");
        let after = names(folder);
        if code != Some(2) || !missing.is_empty() || planned || said.contains("secret") || after != before {
            wrong.push(format!(
                "{what}: {arguments:?}: exit {code:?}, lacks {missing:?}, planned: {planned}, files {after:?}: {said}"
            ));
        }
    }
    assert!(wrong.is_empty(), "{} mistakes:\n{}", wrong.len(), wrong.join("\n"));
    for (name, content) in FILES {
        assert_eq!(
            std::fs::read_to_string(folder.join(name)).expect("read"),
            *content,
            "{name}"
        );
    }
}

// Fails if a link or a tracker where nothing answers, or a port that another program has, is told only after the poses
// are planned, if the message does not name it, or if a file is written.
#[test]
fn what_does_not_answer_is_told_before_planning() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let taken = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let cabinet = taken.local_addr().expect("an address").to_string();
    for (option, value, part) in [
        ("--link", "tcp:127.0.0.1:1", "127.0.0.1:1"),
        ("--link", "controller:127.0.0.1:1", "127.0.0.1:1"),
        ("--link", "franka:127.0.0.1:1", "activate FCI in Desk"),
        ("--link", "grpc:127.0.0.1:1", "127.0.0.1:1"),
        ("--link", "serial:/dev/none", "/dev/none"),
        ("--link", &format!("fri:{cabinet}"), "is another client running"),
        ("--tracker", "grpc:127.0.0.1:1", "127.0.0.1:1"),
    ] {
        let robot = if value.starts_with("franka") { "fr3" } else { "iiwa7" };
        let output = spherecal(folder, &["run", "--robot", robot, option, value]);
        let said = text(&output.stderr);
        assert!(matches!(output.status.code(), Some(1 | 2)), "{value}: {said}");
        assert!(said.contains(part), "{value}: {said}");
        assert!(
            !said.contains("planning the poses") && !said.contains("poses chosen"),
            "{value}: {said}"
        );
        assert_eq!(names(folder), [""; 0], "{value}: {said}");
    }
}
