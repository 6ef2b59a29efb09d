//! Owners of an arm on the page of their own robot: its commands, with the tables that they bring.

use std::path::Path;
use std::process::{Command, Output};

use rand::{RngExt as _, SeedableRng as _};
use spherecal::model::robots::{self, RobotModel};

use crate::docs::{blocks, root};
use crate::field::table;
use crate::support::{PROGRAM, text};

/// The commands of a page's console blocks, in order, without the program's name.
fn commands(page: &str) -> Vec<Vec<String>> {
    blocks(&root().join(page), "console,yours")
        .iter()
        .flat_map(|(_, block)| block.lines().map(str::to_owned).collect::<Vec<_>>())
        .filter_map(|line| {
            let words = shlex::split(line.strip_prefix("$ ")?.split(" #").next()?)?;
            let (program, rest) = words.split_first()?;
            (program == "spherecal").then(|| rest.to_vec())
        })
        .collect()
}

fn spherecal(folder: &Path, arguments: &[String]) -> Output {
    Command::new(PROGRAM)
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

/// Mean distance (mm) of two models' TCPs at drawn configurations, both in the robot's base.
fn apart_mm(a: &RobotModel, b: &RobotModel) -> f64 {
    let mut random = rand_chacha::ChaCha8Rng::seed_from_u64(8);
    let tcp = |model: &RobotModel, q: &[f64]| {
        let flange = model.flange_at(q);
        flange.position + flange.rotation * nalgebra::Vector3::from(model.tool.tcp_m)
    };
    let sum: f64 = (0..100)
        .map(|_| {
            let joints = a.robot.joints.iter();
            let q: Vec<f64> = joints
                .map(|j| 0.5 * random.random_range(j.limits.min_rad..j.limits.max_rad).clamp(-3.0, 3.0))
                .collect();
            1e3 * (tcp(a, &q) - tcp(b, &q)).norm()
        })
        .sum();
    sum / 100.0
}

/// What a user brings, and what the page's commands make of it.
fn own_arm(urdf: &str, contacts: Option<&str>, wanted: usize) {
    let page = "docs/your-robot.md";
    let data = root().join("tests/data");
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::copy(data.join(urdf), folder.join("my_arm.urdf")).expect("copied");
    let nominal = robots::load(&folder.join("my_arm.urdf").display().to_string()).expect("a robot");
    std::fs::write(folder.join("poses.csv"), table(&nominal)).expect("written");
    if let Some(contacts) = contacts {
        std::fs::copy(data.join(contacts), folder.join("contacts.csv")).expect("copied");
    }
    for (kind, block) in blocks(&root().join(page), "toml") {
        if let Some(name) = kind.split_whitespace().nth(1) {
            std::fs::write(folder.join(name), block).expect("written");
        }
    }
    let mut done = 0;
    for arguments in commands(page) {
        let out = arguments.iter().skip_while(|word| *word != "--out").nth(1);
        let (Some(out), true) = (out, arguments.first().is_some_and(|word| word == "identify")) else {
            continue;
        };
        if arguments.iter().any(|word| word == "contacts.csv") && contacts.is_none() {
            continue;
        }
        // A bag needs a writer of bags: the tests of bags have one.
        if arguments.iter().any(|word| word == "my_bag") {
            continue;
        }
        let output = spherecal(folder, &arguments);
        assert_eq!(output.status.code(), Some(0), "{arguments:?}: {}", text(&output.stderr));
        let calibrated = folder.join(out).join("calibrated.urdf");
        let urdf = robots::load(&calibrated.display().to_string()).expect("a URDF");
        let table = robots::load(&folder.join(out).join("calibrated.toml").display().to_string()).expect("TOML");
        let mut exact = nominal.clone();
        exact.robot = table.robot;
        exact.tool = urdf.tool;
        assert!(apart_mm(&urdf, &exact) < 1e-6, "the URDF is not the calibrated table");
        exact.tool = nominal.tool;
        assert!(
            apart_mm(&nominal, &exact) > 0.05,
            "{arguments:?}: nothing was calibrated"
        );
        let report = std::fs::read_to_string(folder.join(out).join("report.html")).expect("a report");
        assert!(report.contains("May be used"), "{arguments:?}");
        done += 1;
    }
    assert_eq!(done, wanted, "commands of {page}");
}

// Fails if an owner of a seven-axis arm, with its URDF, points of a tracker and
// real contacts with two sockets, does not get a calibrated URDF and a report
// by the commands and the files that the page shows.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_seven_axis_arm_is_calibrated_from_its_owners_tables() {
    own_arm("iiwa14.urdf", Some("mukca_iiwa14.csv"), 2);
}

// Fails if an owner of a six-axis arm does not.
#[test]
fn a_six_axis_arm_is_calibrated_from_its_owners_table() {
    own_arm("irb120.urdf", None, 1);
}
