//! What goes wrong with users' files: every mistake ends with exit code 2, before
//! anything is computed, and says which file, field and value, and what to do.

mod descriptions;
mod tables;

use std::path::Path;

use spherecal::model::robots;

use crate::field::table;
use crate::support::{spherecal, text};

/// One mistake: what it is, how the file is written, and what the message says.
struct Mistake {
    what: &'static str,
    /// Name and content of the file that is wrong.
    file: (&'static str, Vec<u8>),
    /// Arguments after `identify --out o`.
    arguments: &'static [&'static str],
    parts: &'static [&'static str],
}

const TABLE: &[&str] = &["--robot", "ur5e", "--data", "bad.csv"];
/// Files that are as they should be, beside those that are not.
fn prepare(folder: &Path) -> String {
    let good = table(&robots::load("ur5e").expect("built in"));
    std::fs::write(folder.join("good.csv"), &good).expect("written");
    let contacts = "q1,q2,q3,q4,q5,q6,sphere\n".to_owned() + &"0.1,-1,1,0,0,0,1\n".repeat(6);
    std::fs::write(folder.join("contacts.csv"), contacts).expect("written");
    #[cfg(unix)]
    std::os::unix::fs::symlink("/dev/zero", folder.join("link.toml")).expect("linked");
    good
}

// Fails if a mistake in a file is not refused with exit code 2, if the message
// does not name what is wrong and what to do, holds a control character or the
// words of a parser, or if anything is written to the output directory.
#[test]
fn every_mistake_in_a_file_is_named_with_its_remedy() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let mut wrong = Vec::new();
    for mistake in tables::mistakes(&good).into_iter().chain(descriptions::mistakes()) {
        std::fs::write(folder.join(mistake.file.0), &mistake.file.1).expect("written");
        let output = spherecal(folder, &[&["identify", "--out", "o"], mistake.arguments].concat());
        let said = text(&output.stderr);
        let code = output.status.code();
        let missing: Vec<_> = mistake.parts.iter().filter(|part| !said.contains(**part)).collect();
        let jargon = [
            "os error",
            "TOML parse error",
            "invalid type",
            "stream did not contain",
            "csv",
            "CSV error",
        ]
        .iter()
        .find(|words| said.replace(".csv", "").contains(**words) && **words != "csv");
        if code != Some(2)
            || !missing.is_empty()
            || jargon.is_some()
            || said.contains(|c: char| c.is_control() && c != '\n')
        {
            wrong.push(format!(
                "{}: exit {code:?}, lacks {missing:?}, jargon {jargon:?}: {said}",
                mistake.what
            ));
        }
        assert!(output.stdout.is_empty(), "{}: {}", mistake.what, text(&output.stdout));
        assert!(!folder.join("o").exists(), "{}", mistake.what);
    }
    assert!(wrong.is_empty(), "{} mistakes:\n{}", wrong.len(), wrong.join("\n"));
}

// Fails if a table that a spreadsheet would write gives another result than the
// plain one: the same numbers with decimal commas and semicolons in UTF-16, with
// the robot's own joint names in another order, with columns of the user's own.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_spreadsheet_s_table_gives_the_same_result() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let european = good.replace(',', ";").replace('.', ",");
    let utf16: Vec<u8> = std::iter::once(0xfeff)
        .chain(european.replace('\n', ";;\r\n").encode_utf16())
        .flat_map(u16::to_le_bytes)
        .collect();
    std::fs::write(folder.join("excel.csv"), utf16).expect("written");
    let named: String = good
        .lines()
        .enumerate()
        .map(|(n, line)| {
            let mut cells: Vec<&str> = line.split(',').collect();
            if n == 0 {
                let names = [
                    "shoulder_pan_joint",
                    "shoulder_lift_joint",
                    "Elbow_Joint",
                    "wrist_1_joint",
                    "wrist_2_joint",
                    "wrist_3_joint",
                ];
                cells[..6].copy_from_slice(&names);
            }
            cells.rotate_left(2);
            format!("{},{}\n", cells.join(","), if n == 0 { "operator" } else { "Kim" })
        })
        .collect();
    std::fs::write(folder.join("named.csv"), named).expect("written");
    let numbers = |arguments: &[&str]| {
        let common = ["identify", "--json", "--out", "o", "--robot", "ur5e", "--data"];
        let output = spherecal(folder, &[&common[..], arguments].concat());
        let summary: serde_json::Value =
            serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {}", text(&output.stderr)));
        (summary["recordings_sha256"].clone(), summary["parameters"].clone())
    };
    let plain = numbers(&["good.csv"]);
    assert_eq!(numbers(&["excel.csv"]), plain);
    assert_eq!(numbers(&["named.csv", "--ignore-columns", "operator"]), plain);
    let own = good.replacen("q1,q2,q3,q4,q5,q6", "a,b,c,d,e,f", 1);
    std::fs::write(folder.join("own.csv"), own).expect("written");
    assert_eq!(numbers(&["own.csv", "--joint-columns", "a,b,c,d,e,f"]), plain);
}

// Fails if an escape sequence in a name that a file holds reaches the terminal.
#[test]
fn names_of_files_reach_the_terminal_as_text() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let good = prepare(folder);
    let rows = good.lines().enumerate().map(|(n, line)| {
        let label = if n == 0 {
            "shift"
        } else if n % 2 == 0 {
            "day\u{1b}[31m"
        } else {
            "night\u{9b}2J"
        };
        format!("{line},{label}\n")
    });
    std::fs::write(folder.join("labels.csv"), rows.collect::<String>()).expect("written");
    for json in [&[][..], &["--json"]] {
        let arguments = [
            "identify",
            "--out",
            "o",
            "--robot",
            "ur5e",
            "--data",
            "labels.csv",
            "--holdout",
            "shift",
        ];
        let output = spherecal(folder, &[&arguments[..], json].concat());
        let said = text(&output.stdout) + &text(&output.stderr);
        assert!(matches!(output.status.code(), Some(0 | 3)), "{said}");
        assert!(!said.contains(|c: char| c.is_control() && c != '\n'), "{said:?}");
    }
}
