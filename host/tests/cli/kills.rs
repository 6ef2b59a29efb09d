//! The host killed at any instant, again and again: the real program, the real
//! signal, and the database that is left.
//!
//! `SPHERECAL_KILLS=200 cargo test -p spherecal --test cli kills -- --ignored` kills as often as
//! is asked; a few times is what the suite has time for.

#![cfg(unix)]

use std::io::{BufRead, BufReader};
use std::os::unix::process::ExitStatusExt as _;
use std::path::{Path, PathBuf};
use std::process::{Child, Command, Stdio};
use std::time::{Duration, Instant};

use rand::{RngExt as _, SeedableRng as _};
use rand_chacha::ChaCha8Rng;
use spherecal::store::{CalibrationStore as _, SqlStore};

use crate::support::{PROGRAM, Server, spherecal, text};

fn kills() -> usize {
    let asked = std::env::var("SPHERECAL_KILLS").ok().and_then(|text| text.parse().ok());
    asked.unwrap_or(12)
}

/// A short run: the paper's grid needs no design of its own.
fn cell(folder: &Path) -> PathBuf {
    let file = folder.join("cell.toml");
    let text = "seed = 4\n[plan]\nposes = 5\nchoice = \"grid\"\n[couple]\n";
    let text = text.replace("[couple]\n", "[procedure.couple]\nhold_s = 1.0\n");
    std::fs::write(&file, text).expect("written");
    file
}

pub(crate) fn measure(folder: &Path, out: &Path, link: &str, resume: bool) -> Child {
    let mut command = Command::new(PROGRAM);
    command.args(["measure", "--json", "--link", link, "--out"]).arg(out);
    if resume {
        command.arg("--resume");
    } else {
        command.arg("--config").arg(cell(folder));
    }
    command
        .stdout(Stdio::null())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts")
}

/// Everything that a database holds of its one run but for the times on the
/// wall, the numbers that tell hosts apart, and the force traces of contacts.
fn contents(database: &Path) -> String {
    compared(database, true)
}

/// The same; the sessions only where they are asked for.
pub(crate) fn compared(database: &Path, sessions: bool) -> String {
    let mut store = SqlStore::open(database).expect("the database is whole");
    let info = store.require_last_run().expect("a run");
    assert_eq!(info.run, 1);
    let mut run = store.read_run(1).expect("read");
    for session in &mut run.sessions {
        session.wall_s = 0.0;
    }
    if !sessions {
        run.sessions.clear();
    }
    run.handshakes.clear();
    format!("{run:?}\n{}\n{:?}", info.about.config_toml, info.state)
}

/// The recordings that are stored, in words; none where there is no run yet.
pub(crate) fn recorded(database: &Path) -> Vec<String> {
    if !database.exists() {
        return Vec::new();
    }
    let mut store = SqlStore::open(database).expect("the database is whole");
    match store.last_run().expect("read") {
        Some(info) => store
            .read_run(info.run)
            .expect("read")
            .recordings
            .iter()
            .map(|r| format!("{r:?}"))
            .collect(),
        None => Vec::new(),
    }
}

pub(crate) fn has_run(database: &Path) -> bool {
    database.exists() && SqlStore::open(database).is_ok_and(|mut s| s.last_run().expect("read").is_some())
}

pub(crate) fn finished(mut child: Child) {
    let mut said = String::new();
    if let Some(stderr) = child.stderr.take() {
        for line in BufReader::new(stderr).lines() {
            said += &line.expect("text");
            said.push('\n');
        }
    }
    assert!(child.wait().expect("it ends").success(), "{said}");
}

/// Kills the host at a random instant of its first `within`; `true` if it still ran.
fn kill(mut child: Child, rng: &mut ChaCha8Rng, within: Duration) -> bool {
    std::thread::sleep(within.mul_f64(rng.random()));
    let ran = child.try_wait().expect("known").is_none();
    let _ = child.kill();
    let _ = child.wait();
    ran
}

// Fails if after any number of kills the database differs from that of a run
// that was left alone, if one kill leaves a file that cannot be opened or a run
// that cannot be exported, or if a recording that was stored is lost or changed.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_kills_at_any_instant_leave_the_database_of_a_run_left_alone() {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone");
    let begun = Instant::now();
    finished(measure(folder.path(), &alone, "sim", false));
    let took = begun.elapsed();
    let expected = contents(&alone.join("calibration.db"));
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let (mut killed, mut runs) = (0, 0);
    while killed < kills() {
        let out = folder.path().join(format!("run-{runs}"));
        let database = out.join("calibration.db");
        let mut stored: Vec<String> = Vec::new();
        // Several kills to a run, then it may end.
        for _ in 0..8 {
            let child = measure(folder.path(), &out, "sim", has_run(&database));
            if !kill(child, &mut rng, took.mul_f64(1.05)) {
                break;
            }
            killed += 1;
            let now = recorded(&database);
            assert!(now.starts_with(&stored), "a stored recording is lost or changed");
            stored = now;
            if has_run(&database) {
                let run = out.display().to_string();
                let export = spherecal(folder.path(), &["export", "--csv", "--out", &run]);
                assert!(export.status.success(), "{}", text(&export.stderr));
            }
        }
        finished(measure(folder.path(), &out, "sim", has_run(&database)));
        assert!(contents(&database) == expected, "after {killed} kills");
        runs += 1;
        std::fs::remove_dir_all(&out).expect("removed");
    }
    println!("{killed} kills in {runs} runs: each database is that of a run left alone");
}

// Fails if `--inject host_killed` closes anything before it dies, kills the run
// that goes on again, or leaves it another database than a run left alone; or if
// a database that is locked for a second does.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_host_killed_by_injection_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone");
    finished(measure(folder.path(), &alone, "sim", false));
    let expected = contents(&alone.join("calibration.db"));
    let inject = |what: &str, out: &Path, how: &[&str]| {
        let out = out.display().to_string();
        spherecal(
            folder.path(),
            &[&["measure", "--json", "--inject", what, "--out", &out], how].concat(),
        )
    };
    let out = folder.path().join("killed");
    let output = inject("host_killed", &out, &["--config", "cell.toml"]);
    assert_eq!(output.status.signal(), Some(9), "{}", text(&output.stderr));
    let stored = recorded(&out.join("calibration.db")).len();
    assert!((1..5).contains(&stored), "{stored} recordings");
    let output = inject("host_killed", &out, &["--resume"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(contents(&out.join("calibration.db")) == expected);
    let out = folder.path().join("locked");
    let output = inject("database_locked", &out, &["--config", "cell.toml"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    assert!(contents(&out.join("calibration.db")) == expected);
}

// Fails if a disk on which nothing can be written any more ends the program
// without its first reason and its remedy, loses a recording that was stored, or
// leaves a run that cannot go on when there is room again.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_full_disk_stops_with_its_reason_and_the_run_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let alone = folder.path().join("alone");
    finished(measure(folder.path(), &alone, "sim", false));
    let out = folder.path().join("full");
    let database = out.join("calibration.db");
    // No file may grow beyond so many blocks of 512 bytes; the signal is ignored,
    // so that writes fail as they do on a full disk.
    let mut refused = false;
    for blocks in [150, 250, 340, 400] {
        let mut command = Command::new("sh");
        command
            .args(["-c", "trap '' XFSZ; ulimit -f $1; shift; exec \"$@\"", "sh"])
            .args([&blocks.to_string(), PROGRAM, "measure", "--json", "--out"])
            .arg(&out);
        if has_run(&database) {
            command.arg("--resume");
        } else {
            command.arg("--config").arg(cell(folder.path()));
        }
        let output = command.output().expect("a shell");
        let said = String::from_utf8_lossy(&output.stderr).into_owned();
        if output.status.success() {
            break;
        }
        assert_eq!(output.status.code(), Some(1), "{said}");
        refused |= said.contains("free space") && said.contains("--resume");
        assert!(!said.contains("transaction"), "not the first cause: {said}");
        println!("{blocks} blocks: {}", said.lines().last().unwrap_or_default());
    }
    assert!(refused, "no limit was met, or none was told");
    finished(measure(folder.path(), &out, "sim", has_run(&database)));
    assert!(contents(&database) == contents(&alone.join("calibration.db")));
}

// Fails if a host that is killed and started again on a controller that lives
// on loses what was stored, stores a pose twice, or cannot go on.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_host_that_is_killed_goes_on_with_the_controller_that_lives() {
    let folder = tempfile::tempdir().expect("a folder");
    let config = cell(folder.path());
    let config = config.display().to_string();
    let plant = Server::start(&["plant", "--listen", "0", "--config", &config]);
    let drive = format!("tcp:{}", plant.address);
    let controller = Server::start(&["controller", "--drive", &drive, "--host-link", "tcp:0"]);
    let link = format!("controller:{}", controller.address);
    let out = folder.path().join("cell");
    let database = out.join("calibration.db");
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let mut stored: Vec<String> = Vec::new();
    let mut killed = 0;
    for _ in 0..kills().div_ceil(2) {
        let child = measure(folder.path(), &out, &link, has_run(&database));
        killed += usize::from(kill(child, &mut rng, Duration::from_millis(2500)));
        let now = recorded(&database);
        assert!(now.starts_with(&stored), "a stored recording is lost or changed");
        stored = now;
    }
    finished(measure(folder.path(), &out, &link, has_run(&database)));
    let mut store = SqlStore::open(&database).expect("whole");
    let info = store.require_last_run().expect("a run");
    assert_eq!(info.state, "measured");
    let run = store.read_run(info.run).expect("read");
    let recordings = run.recordings;
    let poses: std::collections::BTreeSet<_> = recordings.iter().map(|r| (r.sphere, r.pose)).collect();
    assert_eq!((recordings.len(), poses.len()), (5, 5));
    // Contacts and phases of every session once: an event has one number.
    let phases = run.phases;
    let mut unique = phases.clone();
    unique.dedup();
    assert_eq!(unique, phases);
    println!(
        "{killed} kills, {} phases, {} contacts",
        phases.len(),
        run.contacts.len()
    );
}
