//! `spherecal commission` at a pseudo-terminal, with the simulated arm; and without a person.

use std::io::{Read as _, Write as _};
use std::net::UdpSocket;
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::support::{PROGRAM, Server, spherecal, terminal, text};

/// Three poses: the plan is made quickly.
const QUICK: &str = "[plan]\nposes = 3\nchoice = \"grid\"\n";

/// Exit code, stdout and stderr of a commissioning whose person types `answers`, one after each question.
fn at_terminal(folder: &Path, arguments: &[&str], answers: &[&str]) -> (Option<i32>, String, String) {
    let (mut keyboard, slave) = terminal();
    let mut child = Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::from(slave))
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let mut shown = child.stderr.take().expect("piped");
    let mut answers = answers.iter();
    let (mut said, mut asked, mut buffer) = (String::new(), 0, [0; 4096]);
    loop {
        let count = shown.read(&mut buffer).expect("readable");
        if count == 0 {
            break;
        }
        said.push_str(&text(&buffer[..count]));
        let questions = said.matches("and press Enter:").count();
        for _ in asked..questions {
            let answer = answers.next().expect("no more questions than answers");
            keyboard.write_all(answer.as_bytes()).expect("typed");
        }
        asked = questions;
    }
    let output = child.wait_with_output().expect("it ends");
    (output.status.code(), text(&output.stdout), said)
}

fn cell() -> tempfile::TempDir {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("cell.toml"), QUICK).expect("written");
    folder
}

const COMMISSION: [&str; 6] = ["commission", "--config", "cell.toml", "--out", "cell", "--json"];

// Fails if a sound arm does not pass, if `--show` tells something else than what was found, or if a commissioning counts
// as a calibration.
#[test]
fn a_person_commissions_a_robot() {
    let folder = cell();
    let (code, out, said) = at_terminal(folder.path(), &COMMISSION, &["yes\n"; 10]);
    assert_eq!(code, Some(0), "{said}");
    let found: Value = serde_json::from_str(&out).expect("one document");
    assert_eq!(found["passed"], true);
    assert_eq!(found["commissioning"]["steps"].as_array().map(Vec::len), Some(5));
    assert!(said.contains("Step 5 of 5, one contact: passed"), "{said}");
    let shown = spherecal(folder.path(), &["commission", "--show", "--json", "--out", "cell"]);
    let shown: Value = serde_json::from_slice(&shown.stdout).expect("one document");
    assert_eq!(shown["commissionings"][0], found["commissioning"]);
    let words = spherecal(folder.path(), &["commission", "--show", "--out", "cell"]);
    let words = text(&words.stdout);
    assert!(
        words.contains("SIMULATED") && words.contains("Every step passed"),
        "{words}"
    );
    let history = spherecal(folder.path(), &["history", "--json", "--out", "cell"]);
    let history: Value = serde_json::from_slice(&history.stdout).expect("one document");
    assert_eq!(history["runs"].as_array().map(Vec::len), Some(0));
    let report = spherecal(folder.path(), &["report", "--out", "cell"]);
    assert_eq!(report.status.code(), Some(2), "there is nothing to report");
}

// Fails if anything but "yes" begins a step, or if a no is not the end.
#[test]
fn only_a_yes_goes_on() {
    let folder = cell();
    let (code, out, said) = at_terminal(
        folder.path(),
        &COMMISSION,
        &["yes\n", "yes\n", "\n", "y\n", "maybe\n", "no\n"],
    );
    assert_eq!(code, Some(1), "{said}");
    let found: Value = serde_json::from_str(&out).expect("one document");
    let steps = found["commissioning"]["steps"].as_array().expect("steps");
    assert_eq!(steps.len(), 2);
    assert_eq!(steps[1]["verdict"], "declined");
    // End of input (Ctrl-D) agrees to nothing.
    let (code, _, said) = at_terminal(folder.path(), &COMMISSION, &["yes\n", "\u{4}"]);
    assert_eq!(code, Some(1), "{said}");
}

// Fails if it runs without a person, over a link that leads to no robot, or where another option makes no sense.
#[test]
fn nobody_at_the_terminal_is_refused() {
    let folder = cell();
    for (arguments, words) in [
        (&["commission"][..], "standard input is not a terminal"),
        (&["commission", "--link", "controller:127.0.0.1:1"], "franka:HOST"),
        (&["commission", "--resume"], "--resume"),
    ] {
        let output = spherecal(folder.path(), arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
    assert!(!folder.path().join("spherecal-out").exists(), "nothing is written");
}

// Fails if a drive behind a wire cannot be commissioned: it is read over one connection and moved over the next.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_drive_behind_a_wire_is_commissioned() {
    let folder = cell();
    let plant = Server::start_in(
        folder.path(),
        &["plant", "--listen", "127.0.0.1:0", "--config", "cell.toml"],
    );
    let link = format!("tcp:{}", plant.address);
    let arguments = [&COMMISSION[..], &["--link", &link]].concat();
    let (code, out, said) = at_terminal(folder.path(), &arguments, &["yes\n"; 10]);
    assert_eq!(code, Some(0), "{said}");
    let found: Value = serde_json::from_str(&out).expect("one document");
    assert_eq!(found["commissioning"]["link"], link);
}

/// Commissions over a robot's own interface; every step must pass.
fn commissioned_over(link: &str) -> Value {
    let folder = tempfile::tempdir().expect("a folder");
    // The robot is the one that answers, or the usual one: the configuration names none.
    let arguments = ["commission", "--poses", "3", "--link", link, "--out", "cell", "--json"];
    let (code, out, said) = at_terminal(folder.path(), &arguments, &["yes\n"; 10]);
    assert_eq!(code, Some(0), "{said}");
    let found: Value = serde_json::from_str(&out).expect("one document");
    assert_eq!(found["passed"], true, "{said}");
    found["commissioning"].clone()
}

// Fails if a robot behind the Franka Control Interface is not commissioned: it is read over one connection and moved over
// the next, in real time.
#[test]
#[ignore = "long: a minute of real time"]
fn long_a_panda_is_commissioned() {
    let robot = Server::start(&["plant", "--fci", "--version", "5", "--listen", "0", "--tolerant"]);
    let found = commissioned_over(&robot.peer);
    assert_eq!(found["robot"], "panda");
}

// Fails if an LBR behind a cabinet is not commissioned, or if the sign of its torques is not told. Its application starts
// the motion only later, as a person does who answers the smartPAD after the yes.
#[test]
#[ignore = "long: a minute of real time"]
fn long_an_lbr_is_commissioned() {
    let probe = UdpSocket::bind("127.0.0.1:0").expect("a free port");
    let client = probe.local_addr().expect("an address");
    drop(probe);
    let robot = Server::start(&[
        "plant",
        "--fri",
        &client.to_string(),
        "--tolerant",
        "--start-after",
        "12",
    ]);
    let found = commissioned_over(&robot.peer);
    let remarks = found["steps"][0]["remarks"].as_array().expect("remarks");
    assert!(
        remarks
            .iter()
            .any(|r| r.as_str().is_some_and(|r| r.contains("by the gravity of the arm")))
    );
}
