//! Several runs, and several robots, in one folder: nothing is mixed, and nothing is overwritten in
//! silence.

use std::collections::BTreeMap;
use std::path::Path;
use std::process::Output;

use crate::support::{spherecal, text};

/// Measures a short run of a seed into `out`. The paper's grid needs no design of its own.
fn measure(folder: &Path, seed: u64, laser: bool, out: &str) {
    let cell = format!(
        "seed = {seed}\n[plan]\nposes = 4\nchoice = \"grid\"\n[procedure.couple]\nhold_s = 1.0\n[laser]\nenabled = {laser}\n"
    );
    std::fs::write(folder.join("short.toml"), cell).expect("written");
    good(&spherecal(folder, &["measure", "--config", "short.toml", "--out", out]));
}

fn good(output: &Output) {
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", text(&output.stderr));
}

/// Exports a run as CSV: what the program said on stderr.
fn export(folder: &Path, out: &str, run: &str) -> String {
    let output = spherecal(folder, &["export", "--csv", "--out", out, "--run", run]);
    good(&output);
    text(&output.stderr)
}

/// Every table of `out`, by the name of its file.
fn tables(folder: &Path, out: &str) -> BTreeMap<String, String> {
    let entries = std::fs::read_dir(folder.join(out).join("tables")).expect("tables");
    entries
        .map(|entry| entry.expect("an entry").path())
        .filter(|path| path.extension().is_some_and(|e| e == "csv"))
        .map(|path| {
            let name = path.file_name().expect("a name").to_string_lossy().into_owned();
            (name, std::fs::read_to_string(&path).expect("read"))
        })
        .collect()
}

/// The cells of a table without its times: the time of day differs from run to run.
fn without_times(table: &str) -> Vec<Vec<&str>> {
    let names: Vec<&str> = table.lines().next().unwrap_or_default().split(',').collect();
    let columns: Vec<usize> = (0..names.len())
        .filter(|k| !names[*k].contains("time") && names[*k] != "utc_ns")
        .collect();
    let cells = table.lines().map(|line| {
        let all: Vec<&str> = line.split(',').collect();
        columns.iter().map(|k| all[*k]).collect()
    });
    cells.collect()
}

/// Asserts that two exports are the same, without printing megabytes.
fn same(a: &BTreeMap<String, String>, b: &BTreeMap<String, String>) {
    assert!(a.keys().eq(b.keys()), "{:?} against {:?}", a.keys(), b.keys());
    for (name, text) in a {
        let equal = if name == "telemetry.csv" {
            without_times(text) == without_times(&b[name])
        } else {
            *text == b[name]
        };
        assert!(equal, "{name} differs");
    }
    assert!(a["telemetry.csv"].lines().count() > 1000);
}

// Fails if a table of one run is exported for another, if a table that only the earlier run has
// stays beside those of the later one, or if the file list of a run names the telemetry of another.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_every_table_is_of_the_run_that_was_asked_for() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    for (seed, laser, alone) in [(1, true, "one"), (2, false, "two")] {
        measure(folder, seed, laser, alone);
        measure(folder, seed, laser, "both");
        export(folder, alone, "1");
    }
    for (run, alone, laser) in [("1", "one", true), ("2", "two", false), ("1", "one", true)] {
        let said = export(folder, "both", run);
        let exported = tables(folder, "both");
        same(&exported, &tables(folder, alone));
        assert_eq!(exported.contains_key("laser.csv"), laser);
        assert_eq!(said.contains("laser.csv was of another run"), !laser, "{said}");
    }
    export(folder, "both", "2");
    let report = spherecal(folder, &["report", "--out", "both"]);
    good(&report);
    let listed = text(&report.stdout);
    assert!(
        listed.contains("both/telemetry-run-2.mcap") && !listed.contains("telemetry-run-1"),
        "{listed}"
    );

    // A database that was begun again has a run 1, too; the older telemetry is not its own.
    for name in [
        "both/calibration.db",
        "both/calibration.db-wal",
        "both/calibration.db-shm",
    ] {
        let _ = std::fs::remove_file(folder.join(name));
    }
    measure(folder, 2, false, "both");
    assert!(folder.join("both/telemetry-run-1-2.mcap").exists());
    export(folder, "both", "1");
    same(&tables(folder, "both"), &tables(folder, "two"));
}

// Fails if the results of another arm are overwritten, or if nobody is told where they went.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_results_of_another_arm_are_kept() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let report = |arm: &str| {
        measure(folder, 1, false, "o");
        let arguments = ["run", "--config", "short.toml", "--arm", arm, "--json", "--out", "o"];
        let output = spherecal(folder, &arguments);
        good(&output);
        (output.stdout, text(&output.stderr))
    };
    let (first, said) = report("A-17");
    assert!(!said.contains("of-iiwa7"), "{said}");
    let (_, said) = report("B/2");
    assert!(
        said.contains("o had the results of iiwa7, arm A-17: they are in o/of-iiwa7-A-17 now"),
        "{said}"
    );
    let kept = std::fs::read(folder.join("o/of-iiwa7-A-17/summary.json")).expect("kept");
    let json = |bytes: &[u8]| serde_json::from_slice::<serde_json::Value>(bytes).expect("JSON");
    assert!(json(&kept) == json(&first), "another document was kept");
    for name in [
        "calibrated.toml",
        "calibrated.urdf",
        "kinematics.yaml",
        "offsets.yaml",
        "report.html",
    ] {
        assert!(folder.join("o/of-iiwa7-A-17").join(name).exists(), "{name}");
        assert!(folder.join("o").join(name).exists(), "{name}");
    }
    let (_, said) = report("B/2");
    assert!(!said.contains("of-iiwa7"), "the same arm: {said}");
}

#[cfg(unix)]
mod stopped {
    use std::io::Read as _;
    use std::time::{Duration, Instant};

    use super::*;
    use crate::support::start;

    /// Starts the run of `short.toml` into `out` and sends it a signal when its telemetry is there.
    fn stop(folder: &Path, out: &str, signal: rustix::process::Signal) -> String {
        let arguments = ["measure", "--config", "short.toml", "--out", out];
        let mut child = start(folder, &arguments);
        let begun = Instant::now();
        while !folder.join(out).join("telemetry-run-1.mcap").exists() {
            assert!(begun.elapsed() < Duration::from_mins(5), "it never began");
            assert!(
                child.try_wait().expect("known").is_none(),
                "it ended before it was stopped"
            );
            std::thread::sleep(Duration::from_millis(2));
        }
        let pid = rustix::process::Pid::from_child(&child);
        rustix::process::kill_process(pid, signal).expect("sent");
        let mut said = String::new();
        let mut stderr = child.stderr.take().expect("piped");
        stderr.read_to_string(&mut said).expect("text");
        child.wait().expect("it ends");
        said
    }

    // Fails if a run that was killed and resumed has other tables than one that was left alone: a
    // part of its telemetry twice or not at all.
    #[test]
    #[ignore = "long: scripts/test --long runs it"]
    fn long_a_killed_run_has_its_own_tables() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        measure(folder, 3, false, "alone");
        export(folder, "alone", "1");
        stop(folder, "killed", rustix::process::Signal::KILL);
        good(&spherecal(folder, &["measure", "--resume", "--out", "killed"]));
        assert!(folder.join("killed/telemetry-run-1-2.mcap").exists());
        // Another run in between takes nothing from it.
        measure(folder, 4, false, "killed");
        assert_eq!(export(folder, "killed", "1"), "");
        same(&tables(folder, "killed"), &tables(folder, "alone"));
    }

    // Fails if the hint after Ctrl-C, typed as it stands, does not continue the run.
    #[test]
    #[ignore = "slow: the gate runs it"]
    fn slow_the_hint_after_ctrl_c_continues_the_run() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        measure(folder, 3, false, "alone");
        let said = stop(folder, "it's mine", rustix::process::Signal::INT);
        let hint = said
            .lines()
            .find_map(|line| line.strip_prefix("Next: "))
            .unwrap_or_default();
        let words = shlex::split(hint).expect("as a shell reads it");
        assert_eq!(words, ["spherecal", "run", "--resume", "--out", "it's mine"], "{said}");
        let words: Vec<&str> = words.iter().skip(1).map(String::as_str).collect();
        good(&spherecal(folder, &words));
    }
}
