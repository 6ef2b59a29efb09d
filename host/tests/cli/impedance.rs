//! `spherecal impedance`: an arm that is held by a spring, and what its input may say.

use std::io::{BufRead as _, BufReader, Read as _, Write as _};
use std::path::Path;
use std::process::{Child, Command, Stdio};

use serde_json::Value;

use crate::support::{PROGRAM, Server, text};

fn start(folder: &Path, arguments: &[&str]) -> Child {
    let quick = "[plan]\nposes = 3\nchoice = \"grid\"\n";
    std::fs::write(folder.join("cell.toml"), quick).expect("written");
    Command::new(PROGRAM)
        .args(["impedance", "--config", "cell.toml", "--json"])
        .args(arguments)
        .current_dir(folder)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

/// Three numbers of a line.
fn vector(line: &Value, field: &str) -> [f64; 3] {
    std::array::from_fn(|i| line[field][i].as_f64().unwrap_or(f64::NAN))
}

// Fails if a spring does not hold the arm where it is, a step is not reached to within a newton of friction over the
// stiffness, a line that cannot be used is not told or ends the hold, or the end of the input is no calm end.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_lines_hold_an_arm() {
    let folder = tempfile::tempdir().expect("a folder");
    let mut child = start(folder.path(), &["--stiffness", "1000"]);
    let mut input = child.stdin.take().expect("piped");
    let lines = "{\"wait_s\": 1}\n{\"stiffness\": 9000}\nup\n{\"move_mm\": [0, 0, 10], \"wait_s\": 2}\n\
                 {\"stiffness\": [800, 800, 400], \"wait_s\": 1}\n";
    input.write_all(lines.as_bytes()).expect("read");
    drop(input);
    let output = child.wait_with_output().expect("it ends");
    let (out, err) = (text(&output.stdout), text(&output.stderr));
    assert_eq!(output.status.code(), Some(0), "{out}{err}");
    let lines: Vec<Value> = out
        .lines()
        .map(|line| serde_json::from_str(line).expect("JSON"))
        .collect();
    let refused: Vec<&str> = lines.iter().filter_map(|line| line["refused"].as_str()).collect();
    assert_eq!(refused.len(), 2, "{out}");
    assert_eq!(refused[0], "stiffness is 9000: give a value from 0 to 5000");
    assert!(refused[1].contains("line 1"), "{refused:?}");
    let told: Vec<&Value> = lines.iter().filter(|line| line["time_s"].is_f64()).collect();
    assert!(
        (35..=45).contains(&told.len()),
        "ten in each of four seconds: {}",
        told.len()
    );
    let at = |time_s: f64| {
        let line = told
            .iter()
            .rfind(|line| line["time_s"].as_f64() <= Some(time_s))
            .expect("a line");
        (vector(line, "tcp_m"), line)
    };
    let (start, held, stepped) = (vector(told[0], "tcp_m"), at(0.9).0, at(2.9).0);
    for axis in 0..3 {
        assert!((held[axis] - start[axis]).abs() < 1e-3, "{held:?} from {start:?}");
        let wanted = held[axis] + if axis == 2 { 0.010 } else { 0.0 };
        assert!((stepped[axis] - wanted).abs() < 1e-3, "{stepped:?} from {held:?}");
    }
    let last = at(f64::INFINITY).1;
    assert_eq!(vector(last, "stiffness_n_m"), [800.0, 800.0, 400.0]);
}

// Fails if the hold over a drive link does not hold, or if Ctrl-C is no calm end.
#[cfg(unix)]
#[test]
#[ignore = "timed: 40 s of real time"]
fn timed_an_arm_behind_a_drive_link_is_held_until_ctrl_c() {
    let folder = tempfile::tempdir().expect("a folder");
    let plant = Server::start(&["plant", "--listen", "0", "--once"]);
    let mut child = start(folder.path(), &["--link", &format!("tcp:{}", plant.address)]);
    let input = child.stdin.take().expect("piped");
    let mut out = BufReader::new(child.stdout.take().expect("piped")).lines();
    let first: Value = serde_json::from_str(&out.next().expect("a line").expect("text")).expect("JSON");
    let ninth: Value = serde_json::from_str(&out.nth(7).expect("a line").expect("text")).expect("JSON");
    let (first, ninth) = (vector(&first, "tcp_m"), vector(&ninth, "tcp_m"));
    assert!(
        (0..3).all(|i| (first[i] - ninth[i]).abs() < 2e-3),
        "{first:?} {ninth:?}"
    );
    let pid = rustix::process::Pid::from_child(&child);
    rustix::process::kill_process(pid, rustix::process::Signal::INT).expect("sent");
    assert!(out.all(|line| line.is_ok()));
    let mut said = String::new();
    let mut err = child.stderr.take().expect("piped");
    err.read_to_string(&mut said).expect("text");
    assert_eq!(child.wait().expect("it ends").code(), Some(0), "{said}");
    drop(input);
    plant.ended_well();
}
