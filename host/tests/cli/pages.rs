//! The pages of the documentation, as a reader carries them out: every command of their blocks
//! `console` in the order of the page, in an empty folder, with the exit code that the page states.
//!
//! A command ends with 0, or with the number of its remark `# exit code N`, or `# exit code N: why`. Servers (`plant`,
//! `controller`, `serve`) run on, as in another terminal. Blocks `console,wires` are the same in real time, over the
//! robots' own interfaces. Other blocks are parsed alone (`docs::every_command_is_one_that_the_program_takes`):
//! `console,hardware` needs a robot, a board or its images, `console,yours` files or machines of the reader,
//! `console,sources` builds and tests.
//! Blocks `text` are output, of which every line must be there; `text,layout` is none.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::path::Path;
use std::process::Command;

use spherecal::model::robots;

use crate::docs::{pages, pieces, root};
use crate::real_data::SOCKETS;
use crate::support::{PROGRAM, text};

/// What a page does, as a script for a shell, and the lines of output that it shows.
#[derive(Default)]
struct Page {
    commands: usize,
    script: String,
    shown: Vec<String>,
}

/// Ends the script where a command does not end as the page says; stops the servers at the end.
const BEGIN: &str = "set -u\nservers=\ntrap 'kill $servers 2>/dev/null' EXIT\n\
    ended() { [ $1 = $2 ] || { echo \"command $3 ended with exit code $1, the page says $2\" >&2; exit 99; }; }\n";

impl Page {
    /// Adds a line that a reader types.
    fn command(&mut self, line: &str) {
        self.commands += 1;
        let (number, script) = (self.commands, &mut self.script);
        let words: Vec<&str> = line.split_whitespace().take(2).collect();
        let serves = matches!(words[..], ["spherecal", "plant" | "controller" | "serve"]);
        let (command, remark) = line.split_once(" #").unwrap_or((line, ""));
        let written = if line.ends_with('&') {
            writeln!(script, "{line}")
        } else if serves {
            writeln!(
                script,
                "{command} > server-{number}.txt & servers=\"$servers $!\"\n\
                 until [ -s server-{number}.txt ] || ! kill -0 $!; do sleep 0.1; done"
            )
        } else {
            let code = remark.trim().strip_prefix("exit code ").unwrap_or("0");
            let code = code.split(':').next().unwrap_or_default();
            writeln!(script, "{line}\nended $? {code} {number}")
        };
        written.expect("text");
    }

    /// Reads the commands of the page's blocks `console`, which may be of a kind; files that it shows are written into
    /// `folder`.
    fn read(page: &Path, folder: &Path, console: &str) -> Self {
        let mut found = Self {
            script: BEGIN.to_owned(),
            ..Self::default()
        };
        for (head, text) in pieces(page) {
            let mut words = head.split_whitespace();
            match (words.next(), words.next()) {
                (Some(head), _) if head == console => {
                    for line in text.lines().filter_map(|line| line.strip_prefix("$ ")) {
                        found.command(line);
                    }
                }
                (Some("text"), None) => found.shown.extend(text.lines().map(str::to_owned)),
                (Some(_), Some(name)) => std::fs::write(folder.join(name), text).expect("written"),
                _ => {}
            }
        }
        found
    }
}

/// Carries a page out in `folder`. Every line of output that it shows must be there, and every file that is named.
fn carry_out_in(folder: &Path, name: &str, files: &[&str]) -> String {
    carry_out_blocks(folder, name, "console", files)
}

fn carry_out_blocks(folder: &Path, name: &str, console: &str, files: &[&str]) -> String {
    let page = Page::read(&root().join(name), folder, console);
    assert!(page.commands > 0, "{name} has no command");
    let program = Path::new(PROGRAM).parent().expect("a folder");
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap_or_default());
    // A server that never answers must not hold up all tests. The longest page takes 7 minutes.
    let output = Command::new("timeout")
        .args(["--kill-after=10", "1800", "sh", "-c", &page.script])
        .current_dir(folder)
        .env("PATH", path)
        .env("SPHERECAL", root().canonicalize().expect("the sources"))
        .output()
        .expect("a shell");
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert!(
        output.status.success(),
        "{name}: {:?}\n{}\n{said}\n{told}",
        output.status,
        page.script
    );
    for line in page.shown {
        assert!(said.lines().any(|l| l == line), "{name} shows \"{line}\":\n{said}");
    }
    for file in files {
        let there = folder.join(file).metadata().is_ok_and(|m| m.len() > 100);
        assert!(there, "{name}: {file} is missing\n{said}\n{told}");
    }
    said
}

fn carry_out(name: &str, files: &[&str]) -> String {
    let folder = tempfile::tempdir().expect("a folder");
    carry_out_in(folder.path(), name, files)
}

// Each of these fails if a command of its page does not end with the page's exit code, if a line that the page
// shows is not in the output, or if a file that the page names is not there.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_metrologist_with_a_tracker() {
    let files = [
        "cell/tracker/report.html",
        "cell/tracker/calibrated.urdf",
        "cell/tracker/certificate-draft.html",
        "practice/report.html",
    ];
    carry_out("docs/tutorials/tracker.md", &files);
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_lab_with_a_franka() {
    carry_out(
        "docs/tutorials/franka.md",
        &["rehearsal/report.html", "rehearsal/tables/poses.csv"],
    );
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_control_engineer_with_a_board() {
    carry_out("docs/tutorials/board.md", &["three/summary.json"]);
}

// Fails also if the README shows another answer than this page's program gives.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_researcher_with_a_table() {
    let said = carry_out(
        "docs/tutorials/table.md",
        &["result/report.html", "geometry/summary.json"],
    );
    let readme = std::fs::read_to_string(root().join("README.md")).expect("the page");
    let answer = readme.lines().find(|line| line.starts_with("iiwa14: ")).expect("one");
    assert!(said.lines().any(|line| line == answer), "{answer}:\n{said}");
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_user_of_ros() {
    carry_out(
        "docs/tutorials/ros.md",
        &["cell/ros2/metadata.yaml", "cell/kinematics.yaml", "again/summary.json"],
    );
}

// Fails also if the folder lacks a file of the page's table, if the report does not say in words whether the robot
// is better, or if the calibrated robot cannot be loaded.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_quick_start_leads_from_nothing_to_a_report() {
    let folder = tempfile::tempdir().expect("a folder");
    let name = "docs/quick-start.md";
    carry_out_in(folder.path(), name, &["third/report.html"]);
    let page = std::fs::read_to_string(root().join(name)).expect("a page");
    let promised: BTreeSet<&str> = page
        .lines()
        .filter_map(|line| line.strip_prefix("| `")?.split('|').next())
        .flat_map(|cell| cell.split('`'))
        .filter(|word| word.contains('.') && !word.contains(' '))
        .collect();
    assert!(promised.len() >= 7, "{promised:?}");
    let out = folder.path().join("spherecal-out");
    for file in promised {
        assert!(out.join(file).metadata().is_ok_and(|m| m.len() > 100), "{file}");
    }
    let report = std::fs::read_to_string(out.join("report.html")).expect("a report");
    assert!(report.contains("May be used"), "the default run is good");
    let urdf = robots::load(&out.join("calibrated.urdf").display().to_string()).expect("a robot");
    assert_eq!(urdf.robot.dof(), 7);
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_data_of_a_real_iiwa() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let sources = root().canonicalize().expect("the sources");
    std::os::unix::fs::symlink(sources.join("tests"), folder.join("tests")).expect("linked");
    std::fs::write(folder.join("sockets.toml"), SOCKETS).expect("written");
    carry_out_in(folder, "docs/real-data.md", &["spherecal-out/report.html"]);
}

#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_first_cell() {
    let files = ["cell/report.html", "cell/identified/report.html", "cell/plate.toml"];
    carry_out("docs/first-cell.md", &files);
}

#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_simulated_run_with_your_robot() {
    carry_out("docs/your-robot.md", &["try/report.html"]);
}

// One after the other: each page has its robot at the interface's own port.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_simulated_robots_at_their_own_interfaces() {
    for (name, files) in [
        ("docs/robots/franka.md", &["spherecal-out/report.html"][..]),
        ("docs/robots/kuka.md", &["spherecal-out/report.html"]),
        ("docs/robots/ur.md", &["spherecal-out/report.html"]),
        ("docs/tutorials/franka.md", &["wire/report.html"]),
        ("docs/commands.md", &[]),
    ] {
        let folder = tempfile::tempdir().expect("a folder");
        carry_out_blocks(folder.path(), name, "console,wires", files);
    }
}

#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_signals_of_a_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    // The page begins with a folder of the main job.
    let run = crate::support::spherecal(folder, &["run"]);
    assert_eq!(run.status.code(), Some(0), "{}", text(&run.stderr));
    let files = ["spherecal-out/ros2/metadata.yaml", "from-bag/summary.json"];
    carry_out_in(folder, "docs/telemetry.md", &files);
}

// One after the other: the pages name the same ports.
#[cfg(feature = "services")]
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_pages_with_servers() {
    carry_out(
        "docs/commands.md",
        &[
            "spherecal-out/tables/poses.csv",
            "cell/report.html",
            "new/calibration.db",
        ],
    );
    carry_out("docs/drive-link.md", &["spherecal-out/report.html"]);
    carry_out("docs/your-simulator.md", &["spherecal-out/report.html"]);
    carry_out("docs/services.md", &["spherecal-out/report.html"]);
    carry_out("docs/live.md", &["a17/report.html", "b2/report.html"]);
}

// Fails if a page has commands that no test carries out, or a block that is neither carried out nor says why.
#[test]
fn every_page_is_carried_out() {
    let own = std::fs::read_to_string(root().join("host/tests/cli/pages.rs")).expect("this file");
    let mut checked = 0;
    for page in pages() {
        let heads: BTreeSet<String> = pieces(&page).into_iter().map(|(head, _)| head).collect();
        for head in heads.iter().filter(|head| head.starts_with("console")) {
            let why = head.strip_prefix("console").unwrap_or_default();
            let known = ["", ",wires", ",hardware", ",yours", ",sources"].contains(&why);
            assert!(known, "{}: {head}", page.display());
        }
        if heads.contains("console") || heads.contains("console,wires") {
            checked += 1;
            let name = page.strip_prefix(root()).expect("a page of the sources");
            assert!(own.contains(&format!("\"{}\"", name.display())), "{}", name.display());
        }
    }
    assert!(checked >= 14, "{checked} pages");
}
