//! Plant, controller and host as three processes: the program as a lab with a
//! simulator of its own meets it.

use std::io::{BufRead, BufReader, Write};
use std::path::Path;
use std::process::{Command, Stdio};

use serde_json::Value;

use crate::support::{PROGRAM, Server, spherecal};

fn run(folder: &Path, link: &str) -> Value {
    let out = link.split(':').next().unwrap_or_default();
    let arguments = [
        "run", "--poses", "4", "--seed", "5", "--json", "--link", link, "--out", out,
    ];
    let output = spherecal(folder, &arguments);
    let said = String::from_utf8_lossy(&output.stderr);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
    serde_json::from_slice(&output.stdout).expect("one JSON document")
}

// Fails if a run whose plant, or whose plant and controller, are other
// processes records one other bit than a run in one process, loses or damages
// a frame, if its results are not marked as simulated, or if the servers do not
// end when told to serve once.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_three_processes_record_the_bits_of_one() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = run(folder.path(), "sim");
    assert_eq!(here["poses"]["recorded"], 4);

    let plant = Server::start(&["plant", "--listen", "0", "--seed", "5", "--once"]);
    let there = run(folder.path(), &format!("tcp:{}", plant.address));
    assert_eq!(there["recordings_sha256"], here["recordings_sha256"]);
    assert_eq!(there["simulated"], true);
    plant.ended_well();

    let plant = Server::start(&["plant", "--listen", "0", "--seed", "5", "--once"]);
    let drive = format!("tcp:{}", plant.address);
    let controller = Server::start(&["controller", "--drive", &drive, "--host-link", "tcp:0", "--once"]);
    assert!(controller.address.starts_with("127.0.0.1:"), "{}", controller.address);
    let apart = run(folder.path(), &format!("controller:{}", controller.address));
    assert_eq!(apart["recordings_sha256"], here["recordings_sha256"]);
    assert_eq!(
        (&apart["link"]["crc_errors"], &apart["link"]["lost"]),
        (&0.into(), &0.into())
    );
    assert_eq!(apart["faults"], Value::Array(Vec::new()));
    assert_eq!(apart["simulated"], true);
    controller.ended_well();
    plant.ended_well();
}

// Fails if a plant of another seed gives the same recordings: then they would
// not come over the link.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_another_plant_gives_other_recordings() {
    let folder = tempfile::tempdir().expect("a folder");
    let here = run(folder.path(), "sim");
    let plant = Server::start(&["plant", "--listen", "0", "--seed", "6"]);
    let there = run(folder.path(), &format!("tcp:{}", plant.address));
    assert_ne!(there["recordings_sha256"], here["recordings_sha256"]);
}

// Fails if a link to nowhere, or a malformed one, is not refused with its remedy.
#[test]
fn a_link_to_nowhere_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let refused = |arguments: &[&str], code: i32, words: &[&str]| {
        let output = spherecal(folder.path(), arguments);
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        for word in words {
            assert!(said.contains(word), "{arguments:?} does not say \"{word}\": {said}");
        }
    };
    let nowhere = [
        "tcp:127.0.0.1:1 cannot be reached",
        "start the program that listens there first",
    ];
    refused(&["measure", "--poses", "3", "--link", "tcp:127.0.0.1:1"], 1, &nowhere);
    refused(
        &["measure", "--poses", "3", "--link", "controller:127.0.0.1:1"],
        1,
        &nowhere,
    );
    refused(&["controller", "--drive", "tcp:127.0.0.1:1"], 1, &nowhere);
    refused(&["controller", "--drive", "127.0.0.1:1"], 2, &["give tcp:HOST:PORT"]);
    refused(
        &["plant", "--listen", "not.a.host.invalid:7"],
        1,
        &["cannot listen at", "HOST:PORT"],
    );
}

/// A configuration with the paper's grid, on which three poses lie on three
/// spheres: a designed plan of so few need not touch all of them.
fn grid_plan(folder: &std::path::Path) -> String {
    let file = folder.join("grid.toml");
    std::fs::write(&file, "[plan]\nchoice = \"grid\"\n").expect("a file");
    file.display().to_string()
}

// Fails if the arm is not led by the simulated hand where it is simulated here,
// or if a run does not begin where it was led to.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_taught_waypoints_are_measured_from() {
    let folder = tempfile::tempdir().expect("a folder");
    let grid = grid_plan(folder.path());
    let output = spherecal(
        folder.path(),
        &["teach", "--poses", "3", "--json", "--out", "cell", "--config", &grid],
    );
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
    let taught: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(taught["waypoints"]["waypoint"].as_array().map(Vec::len), Some(3));
    let waypoints = ["--waypoints", "cell/waypoints.toml", "--config", &grid];
    let output = spherecal(
        folder.path(),
        &[&["plan", "--poses", "3", "--json"], &waypoints[..]].concat(),
    );
    let plan: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(
        plan["spheres"][0]["approach"]["joints"],
        taught["waypoints"]["waypoint"][0]["joints_rad"]
    );
    let output = spherecal(
        folder.path(),
        &[&["measure", "--poses", "3", "--out", "cell"], &waypoints[..]].concat(),
    );
    assert_eq!(
        output.status.code(),
        Some(0),
        "{}",
        String::from_utf8_lossy(&output.stderr)
    );
}

// Fails if over a link a person is not asked sphere by sphere, if the arm does
// not stay where it is left, or if waypoints that were taught nowhere near the
// spheres are measured from.
#[test]
fn over_a_link_a_person_leads_the_arm() {
    let folder = tempfile::tempdir().expect("a folder");
    let grid = grid_plan(folder.path());
    let plant = Server::start(&["plant", "--listen", "0", "--once"]);
    let mut child = Command::new(PROGRAM)
        .args(["teach", "--poses", "3", "--config", &grid, "--out", "cell", "--link"])
        .arg(format!("tcp:{}", plant.address))
        .current_dir(folder.path())
        .stdin(Stdio::piped())
        .stderr(Stdio::piped())
        .stdout(Stdio::null())
        .spawn()
        .expect("the program starts");
    // A person who leads the arm nowhere and presses Enter, whenever asked.
    let mut keyboard = child.stdin.take().expect("piped");
    let mut asked = Vec::new();
    for line in BufReader::new(child.stderr.take().expect("piped")).lines() {
        let line = line.expect("text");
        if line.contains("press Enter") {
            asked.push(line);
            // Not before the program listens: what was typed ahead is passed over.
            std::thread::sleep(std::time::Duration::from_millis(300));
            keyboard.write_all(b"\n").expect("it reads");
        }
    }
    assert!(child.wait().expect("it ends").success(), "{asked:?}");
    assert_eq!(asked.len(), 3);
    assert!(asked[1].contains("above sphere 2"), "{asked:?}");
    plant.ended_well();
    let output = spherecal(
        folder.path(),
        &[
            "measure",
            "--config",
            &grid,
            "--poses",
            "3",
            "--waypoints",
            "cell/waypoints.toml",
            "--out",
            "cell",
        ],
    );
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{said}");
    assert!(said.contains("from its planned position"), "{said}");
}
