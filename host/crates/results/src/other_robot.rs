//! Results of another robot in the folder of a result are moved, not overwritten.

use std::path::{Path, PathBuf};

use serde_json::Value;
use spherecal_model::{read_text, read_toml};

use crate::WriteError;

/// Files of a result, by name.
const RESULTS: [&str; 8] = [
    "summary.json",
    "calibrated.toml",
    "calibrated.urdf",
    "kinematics.yaml",
    "offsets.yaml",
    "report.html",
    "certificate.html",
    "certificate-draft.html",
];
/// Largest file that is read to learn whose result it is, in bytes.
const MOST_BYTES: u64 = 64 << 20;
/// Most characters of a robot's or an arm's name in the name of a folder.
const MOST_CHARACTERS: usize = 60;

/// Which robot a result is of.
#[derive(Clone, Debug, PartialEq, Eq)]
struct Whose {
    robot: String,
    /// Name of the arm; empty where it has none.
    arm: String,
}

impl Whose {
    /// From the document of a result.
    fn of(summary: &Value) -> Option<Self> {
        Some(Self {
            robot: summary["robot"].as_str()?.to_owned(),
            arm: summary["arm"].as_str().unwrap_or_default().to_owned(),
        })
    }

    /// From the files in `folder`. `None` if they do not tell.
    fn in_folder(folder: &Path) -> Option<Self> {
        let text = |name: &str| read_text(&folder.join(name), MOST_BYTES, "a result has some megabytes").ok();
        let summary = text("summary.json").and_then(|text| serde_json::from_str::<Value>(&text).ok());
        summary.as_ref().and_then(Self::of).or_else(|| {
            let table: toml::Table = read_toml(&text("calibrated.toml")?).ok()?;
            Some(Self {
                robot: table.get("name")?.as_str()?.to_owned(),
                arm: String::new(),
            })
        })
    }

    /// Name of the folder for its results: every character that a file system may refuse is `_`.
    fn folder_name(&self) -> String {
        let safe = |text: &str| -> String {
            let keep = |c: char| {
                if c.is_ascii_alphanumeric() || "-_.".contains(c) {
                    c
                } else {
                    '_'
                }
            };
            text.chars().take(MOST_CHARACTERS).map(keep).collect()
        };
        let robot = safe(&self.robot);
        if self.arm.is_empty() {
            format!("of-{robot}")
        } else {
            format!("of-{robot}-{}", safe(&self.arm))
        }
    }

    fn words(&self) -> String {
        if self.arm.is_empty() {
            self.robot.clone()
        } else {
            format!("{}, arm {}", self.robot, self.arm)
        }
    }
}

/// Moves the results of another robot out of the way of the result that `summary` describes: from
/// `folder` into `of-ROBOT-ARM` in it, or into the next free `of-ROBOT-ARM-2`, ... Returns what to
/// tell the user; `None` where nothing was moved.
///
/// Results are of another robot if their robot or the name of their arm differs, or if they do not
/// say whose they are.
/// Errors: a file that cannot be moved.
pub(super) fn keep_other_robots(folder: &Path, summary: &Value) -> Result<Option<String>, WriteError> {
    // A link is moved as a link, also if it leads nowhere.
    let there: Vec<&str> = RESULTS
        .into_iter()
        .filter(|name| std::fs::symlink_metadata(folder.join(name)).is_ok_and(|m| !m.is_dir()))
        .collect();
    let before = Whose::in_folder(folder);
    if there.is_empty() || (before.is_some() && before == Whose::of(summary)) {
        return Ok(None);
    }
    let name = before
        .as_ref()
        .map_or_else(|| "of-unknown".to_owned(), Whose::folder_name);
    let to = free_folder(folder, &name)?;
    for file in there {
        let path = folder.join(file);
        std::fs::rename(&path, to.join(file)).map_err(WriteError::of(&path))?;
    }
    let whose = before.map_or_else(|| "a robot that they do not name".to_owned(), |w| w.words());
    Ok(Some(format!(
        "{} had the results of {whose}: they are in {} now",
        folder.display(),
        to.display()
    )))
}

/// Makes the first of `name`, `name-2`, ... that is not there.
fn free_folder(folder: &Path, name: &str) -> Result<PathBuf, WriteError> {
    let mut k = 1u32;
    loop {
        let path = match k {
            1 => folder.join(name),
            _ => folder.join(format!("{name}-{k}")),
        };
        match std::fs::create_dir(&path) {
            Ok(()) => return Ok(path),
            Err(error) if error.kind() == std::io::ErrorKind::AlreadyExists && k < 10_000 => k += 1,
            Err(error) => return Err(WriteError::of(&path)(error)),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use serde_json::json;

    fn names(folder: &Path) -> Vec<String> {
        let entries = std::fs::read_dir(folder).expect("a folder");
        let mut names: Vec<String> = entries
            .map(|e| e.expect("an entry").file_name().into_string().expect("text"))
            .collect();
        names.sort();
        names
    }

    fn write(folder: &Path, summary: &Value) {
        std::fs::write(folder.join("summary.json"), summary.to_string()).expect("written");
        std::fs::write(folder.join("calibrated.toml"), "name = \"ur5e\"\n").expect("written");
    }

    // Fails if the results of another robot or of another arm are overwritten, if an earlier copy
    // is, or if results of the same arm are moved.
    #[test]
    fn results_of_another_robot_are_moved() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let (a, b) = (
            json!({"robot": "ur5e", "arm": "A/../7"}),
            json!({"robot": "ur5e", "arm": "B"}),
        );
        assert_eq!(keep_other_robots(folder, &a).expect("nothing there"), None);
        write(folder, &a);
        assert_eq!(keep_other_robots(folder, &a).expect("the same arm"), None);
        for _ in 0..2 {
            write(folder, &a);
            let said = keep_other_robots(folder, &b).expect("moved").expect("told");
            assert!(
                said.contains("ur5e, arm A/../7") && said.contains("of-ur5e-A_.._7"),
                "{said}"
            );
        }
        assert_eq!(names(folder), ["of-ur5e-A_.._7", "of-ur5e-A_.._7-2"]);
        assert_eq!(
            names(&folder.join("of-ur5e-A_.._7-2")),
            ["calibrated.toml", "summary.json"]
        );
    }

    // Fails if results that do not say whose they are are overwritten.
    #[test]
    fn results_of_nobody_are_moved() {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        let new = json!({"robot": "iiwa7", "arm": ""});
        write(folder, &json!({"robot": "ur5e"}));
        std::fs::write(folder.join("summary.json"), "{ torn").expect("written");
        let said = keep_other_robots(folder, &new).expect("moved").expect("told");
        assert!(said.contains("results of ur5e:"), "{said}");
        std::fs::write(folder.join("report.html"), "mine").expect("written");
        let said = keep_other_robots(folder, &new).expect("moved").expect("told");
        assert!(said.contains("of-unknown"), "{said}");
        assert_eq!(names(folder), ["of-unknown", "of-ur5e"]);
    }
}
