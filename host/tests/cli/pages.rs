//! The tutorials of the documentation, as a reader carries them out: every command of a page in its
//! order, in an empty folder.

use std::path::Path;
use std::process::Command;

use crate::docs::{pieces, root};
use crate::support::{PROGRAM, text};

/// One script of all commands of a page, so that what runs in the background is there for the next one.
/// Exit code 3 of `spherecal` is no failure: few poses may be too few to be trusted.
fn script(page: &Path, folder: &Path) -> (String, Vec<String>) {
    let mut script = "set -eu\nspherecal() { command spherecal \"$@\" || [ $? = 3 ]; }\n".to_owned();
    let mut shown = Vec::new();
    let mut commands = 0;
    for (head, text) in pieces(page) {
        let mut words = head.split_whitespace();
        match (words.next(), words.next()) {
            (Some("console"), _) => {
                for line in text.lines().filter_map(|line| line.strip_prefix("$ ")) {
                    script.push_str(line);
                    script.push('\n');
                    commands += 1;
                }
            }
            (Some("text"), None) => shown.extend(text.lines().map(str::to_owned)),
            (Some(_), Some(name)) => std::fs::write(folder.join(name), text).expect("written"),
            _ => {}
        }
    }
    assert!(commands >= 4, "{}: {commands} commands", page.display());
    (script, shown)
}

/// Carries a page out. Every line that it shows must be a line of the output.
fn carry_out(name: &str) {
    let folder = tempfile::tempdir().expect("a folder");
    let page = root().join("docs/tutorials").join(name);
    let (script, shown) = script(&page, folder.path());
    let program = Path::new(PROGRAM).parent().expect("a folder");
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap_or_default());
    let output = Command::new("sh")
        .arg("-c")
        .arg(&script)
        .current_dir(folder.path())
        .env("PATH", path)
        .env("SPHERECAL", root().canonicalize().expect("the sources"))
        .output()
        .expect("a shell");
    let (said, told) = (text(&output.stdout), text(&output.stderr));
    assert!(output.status.success(), "{name}: {:?}\n{said}\n{told}", output.status);
    for line in shown {
        assert!(said.lines().any(|l| l == line), "{name} shows \"{line}\":\n{said}");
    }
    let report = |file: &str| folder.path().join(file).exists();
    let files: &[&str] = match name {
        "tracker.md" => &[
            "cell/tracker/report.html",
            "cell/tracker/calibrated.urdf",
            "cell/tracker/certificate-draft.html",
            "practice/report.html",
        ],
        "franka.md" => &["rehearsal/report.html", "rehearsal/tables/poses.csv"],
        "board.md" => &["three/summary.json"],
        "table.md" => &["result/report.html", "geometry/summary.json"],
        _ => &["cell/ros2/metadata.yaml", "cell/kinematics.yaml", "again/summary.json"],
    };
    for file in files {
        assert!(report(file), "{name}: {file} is missing\n{said}\n{told}");
    }
}

// Each fails if a command of its page fails, if a line that the page shows is not in the output, or if
// a file that the page names is not there.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_metrologist_with_a_tracker() {
    carry_out("tracker.md");
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_lab_with_a_franka() {
    carry_out("franka.md");
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_control_engineer_with_a_board() {
    carry_out("board.md");
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_researcher_with_a_table() {
    carry_out("table.md");
}

#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_user_of_ros() {
    carry_out("ros.md");
}

// Fails if a page of the tutorials is carried out by no test.
#[test]
fn every_tutorial_is_carried_out() {
    let own = std::fs::read_to_string(root().join("host/tests/cli/tutorials.rs")).expect("this file");
    for entry in std::fs::read_dir(root().join("docs/tutorials")).expect("a folder") {
        let name = entry.expect("an entry").file_name().into_string().expect("a name");
        assert!(
            name == "index.md" || own.contains(&format!("carry_out(\"{name}\");")),
            "{name}"
        );
    }
}
