//! `collect`, `robot read` and the refusals of `--link ur:`, against `plant --ur`.

use std::path::Path;

use serde_json::Value;
use spherecal::model::robots::{self, UrParameters};

use crate::support::{Server, spherecal, text};

/// The parameters of a UR5e in use: nominal ones and corrections that put the frames of the parallel joints metres apart. The
/// corrections are the first ones of the test `calibration` of Universal_Robots_ROS2_Driver,
/// `ur_calibration/test/calibration_test.cpp` (BSD-3-Clause).
const DH: [[f64; 4]; 6] = [
    [-7.29e-5, 4.631e-5, 0.163_156_092, 1.571_008_315],
    [-0.017_138_973, -0.425_125_683, 1.444_216_238, -0.007_255_363],
    [-0.037_071_594, -0.390_337_834, 0.854_147_724, -0.013_483_227],
    [0.054_279_462, 9.9186e-5, -2.165_642_588, 1.572_145_909],
    [1.489e-7, 4.215e-6, 0.099_684_265, -1.572_059_463],
    [1.5515e-5, 0.0, 0.099_619_072, 0.0],
];

fn write_csv(path: &Path, rows: impl IntoIterator<Item = Vec<f64>>) {
    let lines = rows
        .into_iter()
        .map(|row| row.iter().map(|x| format!("{x:?}")).collect::<Vec<_>>().join(","));
    std::fs::write(path, lines.collect::<Vec<_>>().join("\n")).expect("a file");
}

/// The robot that computes with [`DH`].
fn own() -> robots::RobotModel {
    let column = |k: usize| DH.map(|row| row[k]);
    let dh = UrParameters {
        theta: column(0),
        a: column(1),
        d: column(2),
        alpha: column(3),
    };
    dh.robot().expect("a robot")
}

// Fails if contacts from a robot of Universal Robots have other angles than the hand gave, the robot is not recognised, or the
// file beside the table is not the robot as its controller computes it; or if a table that is complete is changed.
#[test]
#[ignore = "timed: 12 s of real time"]
fn timed_contacts_are_collected_with_the_robots_own_calibration() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let poses = [
        [0.1, -1.2, 1.3, -1.4, -1.5, 0.6],
        [0.3, -1.0, 1.1, -1.2, -1.4, 1.0],
        [-0.2, -1.4, 1.5, -1.6, -1.3, 0.2],
    ];
    write_csv(&folder.join("hand.csv"), poses.iter().map(|pose| pose.to_vec()));
    write_csv(&folder.join("dh.csv"), DH.iter().map(|row| row.to_vec()));
    let robot = Server::start_in(folder, &["plant", "--ur", "0", "--guide", "hand.csv", "--dh", "dh.csv"]);
    let arguments = [
        "collect",
        "--link",
        &robot.peer,
        "--tool-mm",
        "0,0,120",
        "--auto",
        "--json",
        "--wait-s",
        "30",
        "--poses",
        "3",
        "--places",
        "1",
    ];
    let output = spherecal(folder, &arguments);
    let said = text(&output.stderr);
    assert_eq!(output.status.code(), Some(0), "{said}");
    assert!(said.contains("The robot is a ur5e"), "{said}");
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(
        (found["poses"].as_u64(), found["robot"].as_str()),
        (Some(3), Some("contacts.robot.toml"))
    );
    let table = std::fs::read_to_string(folder.join("contacts.csv")).expect("a table");
    assert!(
        table.lines().next().is_some_and(|head| head.ends_with("q6")),
        "no torques: {table}"
    );
    for (line, pose) in table.lines().skip(1).zip(poses) {
        let cells: Vec<f64> = line.split(',').filter_map(|cell| cell.parse().ok()).collect();
        let read = &cells[cells.len() - 6..];
        assert!(
            read.iter().zip(pose).all(|(a, b)| (a - b).abs() < 1e-5),
            "{line}: {pose:?}"
        );
    }
    let read = robots::load(&folder.join("contacts.robot.toml").display().to_string()).expect("a robot");
    let difference = robots::compare(&own(), &read).expect("six joints");
    assert!(difference.max_m < 1e-9, "{difference:?}");
    assert_eq!(spherecal(folder, &arguments).status.code(), Some(0));
    assert_eq!(
        std::fs::read_to_string(folder.join("contacts.csv")).expect("a table"),
        table
    );
}

// Fails if the calibration of a robot is not shown against the nominal one or not written in each format; if a robot that
// can only be read is run; or if what cannot be is accepted, or the refusal does not say what to give.
#[test]
fn the_own_calibration_is_read_and_what_cannot_be_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    write_csv(&folder.join("dh.csv"), DH.iter().map(|row| row.to_vec()));
    write_csv(&folder.join("short.csv"), DH[..5].iter().map(|row| row.to_vec()));
    for robot in ["panda", "ur5e", "ur10"] {
        std::fs::write(folder.join(format!("{robot}.toml")), format!("robot = \"{robot}\"\n")).expect("a file");
    }
    let robot = Server::start_in(folder, &["plant", "--ur", "0", "--cb3", "--dh", "dh.csv"]);
    let link = robot.peer.as_str();
    for file in ["own.toml", "own.yaml", "own.urdf"] {
        let output = spherecal(folder, &["robot", "read", "--link", link, file]);
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        let said = text(&output.stdout);
        assert!(
            said.contains("ur5e (software 3.15") && said.contains("elbow_joint"),
            "{said}"
        );
        let read = robots::load(&folder.join(file).display().to_string()).expect("a robot");
        let difference = robots::compare(&own(), &read).expect("six joints");
        assert!(difference.max_m < 1e-9, "{file}: {difference:?}");
    }
    let polyscope_x = Server::start_in(folder, &["plant", "--ur", "0", "--polyscope-x", "--dh", "dh.csv"]);
    let output = spherecal(folder, &["robot", "read", "--link", &polyscope_x.peer]);
    assert!(
        text(&output.stdout).contains("ur5e (software 10.12.1"),
        "{}",
        text(&output.stdout)
    );
    let output = spherecal(folder, &["robot", "read", "--link", link, "--json"]);
    let found: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    let nominal = robots::compare(&robots::load("ur5e").expect("built in"), &own()).expect("six joints");
    let mean = found["from_nominal"]["flange_mean_m"].as_f64().expect("a distance");
    assert!((mean - nominal.mean_m).abs() < 1e-9 && mean > 1e-4, "{found}");
    let output = spherecal(folder, &["robot", "compare", "ur5e", "own.toml", "--json"]);
    let compared: Value = serde_json::from_slice(&output.stdout).expect("one JSON document");
    assert_eq!(compared["links"][2]["link"], "elbow_joint", "{compared}");
    for (arguments, code, words) in [
        (&["run", "--robot", "ur5e", "--link", link][..], 1, "takes no torques"),
        (&["commission", "--link", link], 2, "needs a person at the robot"),
        (&["collect", "--link", "ur:"], 2, "ur:HOST"),
        (&["collect", "--link", "ur:127.0.0.1:4"], 1, "enable RTDE"),
        (&["robot", "read", "--link", "sim"], 2, "give ur:HOST"),
        (
            &["robot", "compare", "ur5e", "panda"],
            2,
            "has 6 joints, but panda has 7",
        ),
        (&["plant", "--ur", "0", "--config", "panda.toml"], 2, "robot = \"ur5e\""),
        (&["plant", "--ur", "0", "--dh", "short.csv"], 2, "5 lines"),
        (&["plant", "--ur", "somewhere"], 2, "give PORT or IP:PORT"),
        (&["plant", "--ur", "0", "--fci"], 2, "--fci"),
        (&["plant", "--cb3"], 2, "--ur"),
        (&["plant", "--ur", "0", "--cb3", "--polyscope-x"], 2, "--cb3"),
        (
            &["plant", "--ur", "0", "--config", "ur5e.toml", "--cb3"],
            2,
            "which is no CB3",
        ),
        (
            &["plant", "--ur", "0", "--config", "ur10.toml", "--polyscope-x"],
            2,
            "leave --polyscope-x out",
        ),
    ] {
        let output = spherecal(folder, arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(code), "{arguments:?}: {said}");
        assert!(said.contains(words), "{arguments:?}: {said}");
    }
}
