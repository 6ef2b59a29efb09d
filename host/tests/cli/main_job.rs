//! The program as its users meet it: the main job end to end, its refusals, its
//! exit codes, and what survives when it is stopped.

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use serde_json::Value;
use spherecal::store::CalibrationStore as _;

use crate::support::{PROGRAM, spherecal, text};

fn summary(folder: &Path, out: &str) -> Value {
    let text = std::fs::read_to_string(folder.join(out).join("summary.json")).expect("summary.json");
    serde_json::from_str(&text).expect("JSON")
}

/// A summary without what may differ between runs of one seed.
fn without_wall_time(mut summary: Value) -> Value {
    // When it was measured.
    if let Some(certificate) = summary["certificate"].as_object_mut() {
        assert!(certificate.remove("measured").is_some_and(|m| m.is_string()));
    }
    for field in ["wall_s", "real_time_factor"] {
        summary.as_object_mut().expect("an object").remove(field).expect(field);
    }
    summary
}

fn refused(folder: &Path, arguments: &[&str], words: &[&str]) {
    let output = spherecal(folder, arguments);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{arguments:?}: {said}");
    for word in words {
        assert!(said.contains(word), "{arguments:?} does not say \"{word}\": {said}");
    }
}

// Fails if two runs of one seed differ in anything but wall times, if another
// seed gives the same, if stdout is not exactly summary.json, if a pose is lost
// or a fault occurs, if the robot takes 5 % more or less time than planned, or if a file is missing.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_one_seed_gives_one_summary() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let run = |out, seed| {
        spherecal(
            folder,
            &["run", "--poses", "12", "--json", "--seed", seed, "--out", out],
        )
    };
    let first = run("a", "7");
    assert!(matches!(first.status.code(), Some(0 | 3)), "{}", text(&first.stderr));
    let printed: Value = serde_json::from_slice(&first.stdout).expect("stdout is one JSON document");
    let a = summary(folder, "a");
    assert_eq!(printed, a);
    assert_eq!(a["poses"]["recorded"], a["poses"]["chosen"]);
    assert_eq!(a["faults"], Value::Array(Vec::new()));
    let plan = spherecal(folder, &["plan", "--poses", "12", "--json", "--seed", "7"]);
    let plan: Value = serde_json::from_slice(&plan.stdout).expect("stdout is one JSON document");
    let planned_s = plan["robot_s"].as_f64().expect("a number");
    let took_s = a["simulated_s"].as_f64().expect("a number");
    assert!(
        (took_s / planned_s - 1.0).abs() < 0.05,
        "{took_s} s, planned {planned_s} s"
    );
    // One of each sphere, or up to five where another branch is worth it, and a second visit to each, of which some
    // are repeated: nests of this arm seat badly now and then.
    let contacts = a["contacts"].as_array().map_or(0, Vec::len);
    assert!((6..=14).contains(&contacts), "{contacts} contacts");
    assert_eq!(a["validation"]["n"], 125);
    for name in ["nominal", "sphere", "laser"] {
        let mean = a["validation"]["models"][name]["mean_mm"].as_f64();
        assert!(mean.is_some_and(|m| m > 0.0 && m < 10.0), "{name}: {mean:?}");
    }
    for file in ["calibration.db", "summary.json", "calibrated.toml", "calibrated.urdf"] {
        assert!(folder.join("a").join(file).is_file(), "{file} is missing");
    }
    run("b", "7");
    assert_eq!(without_wall_time(a.clone()), without_wall_time(summary(folder, "b")));
    run("c", "8");
    assert_ne!(a["recordings_sha256"], summary(folder, "c")["recordings_sha256"]);

    // The stages on the stored run say the same.
    let again = spherecal(folder, &["identify", "--json", "--out", "a"]);
    let again: Value = serde_json::from_slice(&again.stdout).expect("JSON");
    assert_eq!(without_wall_time(again), without_wall_time(a));
    let table = text(&spherecal(folder, &["validate", "--out", "a"]).stdout);
    assert!(table.contains("nominal") && table.contains("laser tracker"), "{table}");
}

// Fails if a recording can come from anything but contact.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_without_contact_the_run_fails() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("air.toml"), "[plant]\ncontact = false\n").expect("written");
    let output = spherecal(folder.path(), &["run", "--config", "air.toml", "--poses", "6"]);
    assert_eq!(output.status.code(), Some(1));
    let said = text(&output.stderr);
    assert!(
        said.contains("no contact with sphere ") && said.contains(" in 3 attempts"),
        "{said}"
    );
    assert!(!folder.path().join("spherecal-out/summary.json").exists());
}

// Fails if bad input is taken, or refused without its field, value and remedy.
#[test]
fn bad_input_is_refused_by_name() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let config = |text: &str, words: &[&str]| {
        std::fs::write(folder.join("bad.toml"), text).expect("written");
        refused(folder, &["run", "--config", "bad.toml"], words);
    };
    config("robot = \"iiwa99\"\n", &["iiwa99", "built in", "give one of"]);
    config(
        "[procedure.approach]\nstiffness_n_m = [50, -50, 100]\n",
        &["approach.stiffness_n_m[1] is -50", "from 0 to 5000"],
    );
    config(
        "[procedure.couple]\nhold_s = nan\n",
        &["couple.hold_s is NaN", "from 0 to 60"],
    );
    config(
        "[procedure.couple]\nhold = 4\n",
        &["line 2", "`hold` is not known here", "config --print"],
    );
    config("[cell.plate]\nspheres_m = []\n", &["cell.plate.spheres_m is 0"]);
    config(
        "[[cell.placements]]\norigin_m = [2.5, 0.0, 0.3]\nrpy_rad = [0.0, 0.0, 0.0]\n",
        &["sphere", "out of reach", "move the plate"],
    );
    config(
        "[plant.plate]\norigin_m = [0.5, 0.0, 0.3]\n",
        &["plant", "origin_m", "placement_error"],
    );
    config("[plant]\npreset = \"gentle\"\n", &["gentle", "typical"]);
    refused(folder, &["robot", "show", "iiwa99"], &["iiwa99", "give one of"]);
    refused(folder, &["run", "--poses", "0"], &["--poses is 0", "at least 1"]);
    refused(
        folder,
        &["run", "--link", "carrier-pigeon"],
        &["carrier-pigeon", "tcp:HOST:PORT"],
    );
    refused(
        folder,
        &["run", "--config", "none.toml"],
        &["none.toml", "check the path"],
    );
    refused(folder, &["run", "--resume"], &["there is no database"]);
    refused(folder, &["validate"], &["there is no database"]);
    refused(folder, &["dance"], &["dance"]);

    // A database of another version is refused and stays as it is.
    let database = folder.join("old/calibration.db");
    drop(spherecal::store::SqlStore::create_or_open(&database).expect("made"));
    let mut bytes = std::fs::read(&database).expect("read");
    bytes[60..64].copy_from_slice(&77u32.to_be_bytes());
    std::fs::write(&database, &bytes).expect("written");
    refused(
        folder,
        &["run", "--poses", "6", "--out", "old"],
        &["schema version 77", "--out"],
    );
    assert_eq!(std::fs::read(&database).expect("read"), bytes, "not one byte changed");
}

// Fails if a run that was killed or interrupted loses a recording, records one
// twice, or cannot go on.
#[test]
#[cfg(unix)]
#[ignore = "slow: the gate runs it"]
fn slow_what_was_stopped_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let database = folder.join("spherecal-out/calibration.db");
    let begin = |arguments: &[&str]| {
        Command::new(PROGRAM)
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts")
    };
    let recorded = |path: &Path| {
        let mut store = spherecal::store::SqlStore::open(path).ok()?;
        let run = store.last_run().ok()??.run;
        store.read_run(run).ok().map(|r| r.recordings.len())
    };

    // Killed as soon as anything was recorded.
    let config = "[plant]\npreset = \"typical\"\n[plant.plate]\nplacement_sigma_m = 0.0015\n";
    std::fs::write(folder.join("cell.toml"), config).expect("written");
    let mut child = begin(&["run", "--poses", "30", "--config", "cell.toml"]);
    let mut before = 0;
    for _ in 0..1200 {
        std::thread::sleep(Duration::from_millis(50));
        before = recorded(&database).unwrap_or(0);
        if before > 0 {
            break;
        }
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    let at_kill = recorded(&database).expect("the database is whole");
    assert!(
        before >= 1 && at_kill >= before,
        "{at_kill} recordings after {before} were seen"
    );

    // Interrupted: stops by itself, with a word on how to go on.
    let resumed = begin(&["run", "--resume"]);
    std::thread::sleep(Duration::from_millis(300));
    let id = resumed.id().to_string();
    Command::new("kill")
        .args(["-INT", &id])
        .status()
        .expect("kill is there");
    let output = resumed.wait_with_output().expect("ended");
    if !matches!(output.status.code(), Some(0 | 3)) {
        assert_eq!(output.status.code(), Some(1), "{}", text(&output.stderr));
        assert!(text(&output.stderr).contains("--resume"), "{}", text(&output.stderr));
        assert!(recorded(&database).expect("whole") >= at_kill);
    }
    let last = spherecal(folder, &["run", "--resume", "--json"]);
    assert!(matches!(last.status.code(), Some(0 | 3)), "{}", text(&last.stderr));
    let summary = summary(folder, "spherecal-out");
    assert_eq!(summary["poses"]["recorded"], summary["poses"]["chosen"]);
    assert_eq!(summary["poses"]["rejected"], 0);
}

// Fails if help has no example, or if the printed configuration is not one that
// the program takes back.
#[test]
fn help_and_configuration_are_usable() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let help = text(&spherecal(folder, &["--help"]).stdout);
    assert!(help.contains("Examples:") && help.contains("Exit codes"), "{help}");
    for command in ["run", "plan", "measure", "identify", "validate", "report", "config"] {
        let help = text(&spherecal(folder, &[command, "--help"]).stdout);
        assert!(
            help.contains("Example") && help.contains("spherecal "),
            "{command}: {help}"
        );
    }
    let printed = spherecal(folder, &["config", "--print"]);
    std::fs::write(folder.join("all.toml"), &printed.stdout).expect("written");
    let again = spherecal(folder, &["config", "--print", "--config", "all.toml"]);
    assert_eq!(text(&again.stderr), "");
    assert_eq!(text(&printed.stdout), text(&again.stdout));
    let shown = text(&spherecal(folder, &["robot", "show", "iiwa7"]).stdout);
    assert!(
        shown.contains("340.000") && shown.contains("(50.000, 0.000, 100.000) mm"),
        "{shown}"
    );
}

// Fails if for one of the seeds 1 to 5 of the default arm the calibrated arm's mean or largest
// error on the 125 validation points is not under half of the nominal one's (measured: 0.03 to
// 0.42; the base of the arcs counts), or, with the base fitted, under 0.3 of it (measured: 0.02 to
// 0.22), if the default plan loses a pose or runs into a fault, has more than
// 14 contacts (five, three second visits, and those that a bad seat repeats), or takes the robot over 15.5 minutes.
#[test]
#[cfg_attr(debug_assertions, ignore = "long: run in release")]
fn long_five_arms_are_better_than_half_of_nominal() {
    let folder = tempfile::tempdir().expect("a folder");
    for seed in ["1", "2", "3", "4", "5"] {
        let output = spherecal(folder.path(), &["run", "--seed", seed, "--json", "--out", seed]);
        // A seat that stays bad for dozens of rows looks like a plate that slipped: seed 5.
        let code = output.status.code();
        assert!(matches!(code, Some(0 | 3)), "seed {seed}: {}", text(&output.stderr));
        let s = summary(folder.path(), seed);
        assert_eq!(s["faults"], Value::Array(Vec::new()), "seed {seed}");
        assert_eq!(s["poses"]["recorded"], s["poses"]["chosen"], "seed {seed}");
        let models = &s["validation"]["models"];
        for field in ["mean_mm", "max_mm"] {
            let of = |model: &Value| model[field].as_f64().expect("a number");
            let share = of(&models["sphere"]) / of(&models["nominal"]);
            let fitted = of(&models["sphere"]["best_fit"]) / of(&models["nominal"]["best_fit"]);
            println!("seed {seed}: {field} {share:.3} of nominal, {fitted:.3} with the base fitted");
            assert!(share < 0.5, "seed {seed}: {field} is {share} of nominal");
            assert!(
                fitted < 0.3,
                "seed {seed}: {field} is {fitted} of nominal with the base fitted"
            );
        }
        let contacts = s["contacts"].as_array().expect("contacts");
        assert!(contacts.len() <= 14, "seed {seed}: {} contacts", contacts.len());
        let robot_s = s["simulated_s"].as_f64().expect("a number");
        assert!(robot_s < 930.0, "seed {seed}: {robot_s} s");
    }
}

// Fails if long holds are not made at the places asked for, if a second's mean
// of the TCP is not the hold's within the noise on the typical arm, if its noise
// is more than a few µm, or if table, plot and JSON are missing.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_second_tells_what_a_long_hold_does() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let arguments = [
        "stability",
        "--preset",
        "typical",
        "--poses",
        "12",
        "--places",
        "2",
        "--hold-s",
        "10",
        "--json",
        "--out",
        "still",
    ];
    let output = spherecal(folder, &arguments);
    let document: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(output.status.code(), Some(0), "{document:#}\n{}", text(&output.stderr));
    let holds = document["holds"].as_array().expect("holds");
    assert_eq!((holds.len(), &document["model"]), (2, &Value::from("nominal")));
    for hold in holds {
        assert_eq!(hold["windows"], 10);
        assert_eq!(hold["samples"][0], 10_000);
        assert_eq!(hold["joints_urad"].as_array().expect("joints").len(), 7);
        let (noise, first) = (&hold["tcp_um"]["noise"], &hold["tcp_um"]["first"]);
        let (noise, first) = (noise.as_f64().expect("noise"), first.as_f64().expect("first"));
        assert!(noise > 0.0 && noise < 5.0 && first <= 4.0 * noise, "{hold:#}");
    }
    let page = std::fs::read_to_string(folder.join("still/stability.html")).expect("a report");
    assert!(page.contains("<svg") && page.contains("How still it holds"));
    let written = std::fs::read_to_string(folder.join("still/stability.json")).expect("stability.json");
    assert_eq!(serde_json::from_str::<Value>(&written).expect("JSON"), document);
    refused(folder, &["stability", "--resume"], &["--resume"]);
    refused(folder, &["stability", "--hold-s", "1"], &["--hold-s"]);
}

// Fails if the paper's whole grid does not end in a calibration that its own
// validation trusts: with fewer than 99 % of the poses within reach recorded, or
// with residuals that do not look like joint noise and seating. Poses
// near the stretched arm and the joints' limits fault on some arms and have to be
// recovered from; the iiwa 7 is left standing in the margin of joint 6 once, from
// which every way off the sphere leads a hair farther into it. The rows of the FR3 correlate: compared by other shares, a
// certificate that is wrong by 1.8 parts per thousand has more evidence, and the arm 0.58 mm in place of 0.24.
#[test]
#[ignore = "long: 3,300 poses"]
fn long_the_papers_grid_is_recorded() {
    for (robot, preset, seed, within_reach) in [("iiwa7", "typical", "3", 1_800), ("fr3", "harsh", "1", 1_500)] {
        the_papers_grid(robot, preset, seed, within_reach);
    }
}

/// Records the paper's grid with a robot, of which more poses than this are within reach.
fn the_papers_grid(robot: &str, preset: &str, seed: &str, within_reach: u64) {
    let folder = tempfile::tempdir().expect("a folder");
    let output = spherecal(
        folder.path(),
        &[
            "run", "--robot", robot, "--preset", preset, "--paper", "--seed", seed, "--json",
        ],
    );
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let summary: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    let count = |what: &str| summary["poses"][what].as_u64().expect("a count");
    assert!(count("chosen") > within_reach, "{}", count("chosen"));
    assert!(100 * count("recorded") >= 99 * count("chosen"), "{}", summary["poses"]);
    let rms_mm = summary["residual"]["rms_mm"].as_f64().expect("rms_mm");
    assert!((0.015..0.1).contains(&rms_mm), "{rms_mm} mm");
    println!(
        "{} of {} poses, {} faults, {} contacts, {:.0} s of robot time",
        count("recorded"),
        count("chosen"),
        summary["faults"].as_array().map_or(0, Vec::len),
        summary["contacts"].as_array().map_or(0, Vec::len),
        summary["simulated_s"].as_f64().unwrap_or_default()
    );
}
