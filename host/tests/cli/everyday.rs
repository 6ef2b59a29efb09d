//! What shells, manuals and troubled users get from the program.

use std::process::{Command, Stdio};

use serde_json::Value;

use crate::support::{PROGRAM, spherecal, text};

// Fails if a shell has no completions, if bash cannot read its own, or if they
// do not lead from `sphere` to a command and an option.
#[test]
fn shells_complete() {
    let folder = tempfile::tempdir().expect("a folder");
    for shell in ["bash", "zsh", "fish", "elvish", "powershell"] {
        let script = text(&spherecal(folder.path(), &["completions", shell]).stdout);
        assert!(script.contains("identify") && script.contains("resume"), "{shell}");
    }
    let script = spherecal(folder.path(), &["completions", "bash"]).stdout;
    std::fs::write(folder.path().join("c"), script).expect("written");
    let complete = |words: &str, at: usize| {
        let program = format!(
            ". ./c; COMP_WORDS=({words}); COMP_CWORD={at}; _spherecal spherecal '' ''; printf '%s\\n' \"${{COMPREPLY[@]}}\""
        );
        let output = Command::new("bash")
            .args(["-c", &program])
            .current_dir(folder.path())
            .output()
            .expect("bash");
        text(&output.stdout)
    };
    assert!(complete("spherecal ide", 1).contains("identify"));
    assert!(complete("spherecal run --res", 2).contains("--resume"));
}

// Fails if a command has no manual page, or the main page lacks the examples.
#[test]
fn every_command_has_a_manual_page() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = spherecal(folder.path(), &["man", "--out", "man"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let page = |name: &str| std::fs::read_to_string(folder.path().join("man").join(name)).expect(name);
    assert!(page("spherecal.1").contains("Exit codes"));
    for command in ["run", "identify", "robot-convert", "doctor", "config"] {
        assert!(
            page(&format!("spherecal-{command}.1")).contains(".SH SYNOPSIS"),
            "{command}"
        );
    }
    let printed = text(&spherecal(folder.path(), &["man"]).stdout);
    assert_eq!(printed, page("spherecal.1"));
}

// Fails if a run with all defaults written out differs in one recorded bit or
// in its plan from a run without a configuration.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_printed_defaults_are_the_defaults() {
    let folder = tempfile::tempdir().expect("a folder");
    let printed = spherecal(folder.path(), &["config", "--print"]);
    std::fs::write(folder.path().join("cell.toml"), &printed.stdout).expect("written");
    let run = |more: &[&str], out: &str| -> Value {
        let arguments = [&["run", "--poses", "6", "--json", "--out", out][..], more].concat();
        let output = spherecal(folder.path(), &arguments);
        serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&output.stderr)))
    };
    let (without, with) = (run(&[], "a"), run(&["--config", "cell.toml"], "b"));
    assert_eq!(without["recordings_sha256"], with["recordings_sha256"]);
    assert_eq!(without["validation"], with["validation"]);
}

// Fails if a table of a run is missing, a recorded pose or a sample of the
// telemetry is lost on its way into it, or `identify` cannot read its own poses.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_run_is_exported_as_tables() {
    let folder = tempfile::tempdir().expect("a folder");
    let run = spherecal(folder.path(), &["run", "--poses", "9", "--json", "--out", "a"]);
    let summary: Value = serde_json::from_slice(&run.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&run.stderr)));
    let output = spherecal(folder.path(), &["export", "--csv", "--out", "a"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let rows = |name: &str| -> Vec<String> {
        let path = folder.path().join("a/tables").join(name);
        let text = std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{name}: {e}"));
        text.lines().map(str::to_owned).collect()
    };
    assert_eq!(rows("recordings.csv").len(), 1 + 9);
    assert_eq!(
        Some(rows("contacts.csv").len() - 1),
        summary["contacts"].as_array().map(Vec::len)
    );
    assert_eq!(
        Some(rows("parameters.csv").len() - 1),
        summary["parameters"].as_array().map(Vec::len)
    );
    let telemetry = rows("telemetry.csv");
    assert!(
        telemetry[0].starts_with("time_ns,q1_rad,") && telemetry[0].contains("force_x_n"),
        "{}",
        telemetry[0]
    );
    let seconds = summary["simulated_s"].as_f64().expect("simulated_s");
    let times: Vec<f64> = telemetry[1..]
        .iter()
        .map(|row| row.split(',').next().unwrap_or_default().parse().expect("a time"))
        .collect();
    // The telemetry's rate depends on the phase: 20 ms apart at most.
    let wrong: Vec<_> = times
        .windows(2)
        .filter(|t| !(t[0] < t[1] && t[1] - t[0] <= 21e6))
        .collect();
    assert!(wrong.is_empty(), "{wrong:?}");
    let last = times.last().expect("rows") * 1e-9;
    // What is left of the last batch of eight is not sent.
    assert!((last - seconds).abs() <= 0.18, "{last} s of {seconds} s");
    assert!(rows("phases.csv").iter().any(|row| row.ends_with("recording,turning")));

    let again = spherecal(
        folder.path(),
        &[
            "identify",
            "--robot",
            "iiwa7",
            "--data",
            "a/tables/poses.csv",
            "--plate",
            "paper",
            "--json",
            "--out",
            "b",
        ],
    );
    let again: Value = serde_json::from_slice(&again.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&again.stderr)));
    assert!(
        again["residual"]["rms_mm"].as_f64().is_some_and(|rms| rms < 1.0),
        "{again}"
    );

    if cfg!(feature = "parquet") {
        let output = spherecal(folder.path(), &["export", "--parquet", "--out", "a"]);
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert!(
            text(&output.stdout).contains("telemetry.parquet"),
            "{}",
            text(&output.stdout)
        );
    }
    let output = spherecal(folder.path(), &["export", "--csv", "--run", "7", "--out", "a"]);
    assert_eq!(output.status.code(), Some(2));
    assert!(
        text(&output.stderr).contains("give a number from 1 to 1"),
        "{}",
        text(&output.stderr)
    );
}

// Fails if the doctor finds fault with a machine that runs the tests, is silent
// about a check, gives no remedy, or passes a folder that cannot be written.
#[test]
fn the_doctor_says_what_to_do() {
    let folder = tempfile::tempdir().expect("a folder");
    let output = spherecal(folder.path(), &["doctor", "--json"]);
    assert!(output.status.success(), "{}", text(&output.stderr));
    let answer: Value = serde_json::from_slice(&output.stdout).expect("JSON");
    let checks = answer["checks"].as_array().expect("checks");
    for name in [
        "toolchain",
        "cross target",
        "QEMU",
        "serial ports",
        "real-time scheduling",
        "disk space",
    ] {
        let check = checks.iter().find(|c| c["name"] == name).expect(name);
        let (state, remedy) = (&check["state"], check["remedy"].as_str().expect("a remedy"));
        assert_eq!(state == "ok", remedy.is_empty(), "{check}");
    }
    let words = text(&spherecal(folder.path(), &["doctor"]).stdout);
    assert!(words.contains("ok  output folder:"), "{words}");

    std::fs::write(folder.path().join("file"), "").expect("written");
    // /proc lets root write, by its permissions, and takes nothing.
    for out in ["file/below", "/proc/below"] {
        let output = spherecal(folder.path(), &["doctor", "--out", out]);
        assert_eq!(output.status.code(), Some(1));
        assert!(text(&output.stdout).contains("FAULT"), "{}", text(&output.stdout));
    }
    // Without programs in PATH they are missing, and that is no failure.
    let output = Command::new(PROGRAM)
        .args(["doctor"])
        .env("PATH", "/nowhere")
        .current_dir(folder.path())
        .output()
        .expect("starts");
    let words = text(&output.stdout);
    assert!(
        output.status.success() && words.contains("no `cargo` in PATH"),
        "{words}"
    );
}

// Fails if a robot for programs is not what the table for people shows.
#[test]
fn robots_are_told_to_programs() {
    let folder = tempfile::tempdir().expect("a folder");
    let json = |arguments: &[&str]| -> Value {
        serde_json::from_slice(&spherecal(folder.path(), arguments).stdout).expect("JSON")
    };
    let list = json(&["robot", "list", "--json"]);
    assert!(list["robots"].as_array().is_some_and(|r| r.len() >= 7), "{list}");
    let robot = json(&["robot", "show", "iiwa7", "--json"]);
    assert_eq!(robot["joints"][0]["mdh"]["d"], 0.34);
    assert_eq!(robot["tool"]["tcp_m"], serde_json::json!([0.05, 0.0, 0.1]));
}

// Fails if logs, help or results are coloured for a reader that is no terminal.
#[test]
fn nothing_is_coloured_without_a_terminal() {
    let folder = tempfile::tempdir().expect("a folder");
    for arguments in [
        &["--help"][..],
        &["run", "--nonsense"],
        &["-vv", "run", "--poses", "3", "--out", "o"],
    ] {
        let output = spherecal(folder.path(), arguments);
        for stream in [output.stdout, output.stderr] {
            assert!(!text(&stream).contains('\u{1b}'), "{arguments:?}: {}", text(&stream));
        }
    }
}

// Fails if a command panics, complains or changes its exit code because the
// reader of its output has seen enough (`| head -1`), or of its messages.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_readers_may_leave() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let without = |arguments: &[&str], stdout: bool, stderr: bool| {
        let mut child = Command::new(PROGRAM)
            .args(arguments)
            .current_dir(folder)
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        // Closed before anything is written, as a reader may be at worst.
        if stdout {
            drop(child.stdout.take());
        }
        if stderr {
            drop(child.stderr.take());
        }
        let output = child.wait_with_output().expect("it ends");
        (output.status.code(), text(&output.stderr))
    };
    let run = ["run", "--poses", "4", "--seed", "5", "--out", "o"];
    let code = spherecal(folder, &run).status.code();
    assert!(matches!(code, Some(0 | 3)), "{code:?}");
    assert_eq!(without(&[&run[..], &["--json"]].concat(), true, false).0, code);
    assert_eq!(without(&run, true, true).0, code);
    for arguments in [
        &["history", "--out", "o"][..],
        &["history", "--out", "o", "--json"],
        &["trend", "--out", "o"],
        &["validate", "--out", "o"],
        &["report", "--out", "o", "--json"],
        &["export", "--csv", "--out", "o"],
        &["store", "check", "o/calibration.db"],
        &["plan", "--poses", "6", "--out", "p"],
        &["config", "--print"],
        &["doctor"],
        &["robot", "list"],
        &["robot", "show", "iiwa7", "--json"],
        &["completions", "bash"],
        &["man"],
        &["--help"],
    ] {
        let code = spherecal(folder, arguments).status.code();
        let (left, said) = without(arguments, true, false);
        assert_eq!(left, code, "{arguments:?}: {said}");
        assert!(
            !said.contains("panicked") && !said.contains("pipe"),
            "{arguments:?}: {said}"
        );
        assert_eq!(
            without(arguments, true, true).0,
            code,
            "{arguments:?}, also without stderr"
        );
    }
    // What cannot be written for another reason is not passed over.
    if let Ok(full) = std::fs::File::options().write(true).open("/dev/full") {
        let output = Command::new(PROGRAM)
            .args(["robot", "list"])
            .stdout(full)
            .output()
            .expect("the program starts");
        assert_eq!(output.status.code(), Some(1));
        assert!(text(&output.stderr).contains("stdout"), "{}", text(&output.stderr));
    }
}

// Fails if a pose at which the nest is pushed off twice is tried again or costs another one, or if a run that has given up a third
// of its poses goes on.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_pose_that_fails_twice_is_given_up() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("cell.toml"), "[plan]\nchoice = \"grid\"\nposes = 6\n").expect("written");
    let pushed = |name: &str, entries: &[u32]| {
        let mut faults = "seed = 0\n".to_owned();
        for entry in entries {
            faults += &format!(
                "[[fault]]\nfor_s = 0.3\n[fault.what.human_push]\nforce_n = [35.0, 35.0, 0.0]\n[fault.when.phase]\n\
                 name = \"recording\"\nentry = {entry}\nafter_s = 0.1\n"
            );
        }
        std::fs::write(folder.join(name), faults).expect("written");
        let run = [
            "run",
            "--config",
            "cell.toml",
            "--seed",
            "5",
            "--json",
            "--inject",
            name,
            "--out",
        ];
        spherecal(folder, &[&run[..], &[&format!("{name}-out")]].concat())
    };
    let once = pushed("one.toml", &[2, 3]);
    let summary: Value = serde_json::from_slice(&once.stdout).expect("a summary");
    assert_eq!(
        (&summary["poses"]["recorded"], &summary["poses"]["rejected"]),
        (&5.into(), &1.into())
    );
    let twice = pushed("two.toml", &[2, 3, 4, 5]);
    assert_eq!(twice.status.code(), Some(1));
    let said = text(&twice.stderr);
    assert!(said.contains("2 of 6 poses were given up"), "{said}");
}
