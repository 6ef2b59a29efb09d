//! The simulated procedure on arms and drives that are hard to control.

use crate::support::{spherecal, text};

/// Name, seed and `[plant]` of each case.
const CASES: [(&str, &str, &str); 14] = [
    ("as measured", "1", "[plant]\npreset = \"as_measured\"\n"),
    ("a printed socket", "1", "[plant]\npreset = \"as_measured_socket\"\n"),
    ("harsh", "1", "[plant]\npreset = \"harsh\"\n"),
    (
        "elastic, 16,000 N m/rad",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.elasticity]\nenabled = true\n",
    ),
    (
        "elastic, 7,000 N m/rad",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.elasticity]\nenabled = true\nstiffness_nm_rad = 7000.0\n",
    ),
    (
        "rotors",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.inertia]\nrotors = true\n",
    ),
    (
        "dry friction to 2 N m",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.friction]\ncoulomb_nm = [1.0, 2.0]\n",
    ),
    (
        "torque noise of 0.25 N m",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.sensors]\ntorque_white_nm = 0.25\n",
    ),
    (
        "4 ms of delay",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.drive]\nstate_delay_s = 0.002\ncommand_delay_s = 0.002\n",
    ),
    (
        "1.5 ms of delay with 2 ms of jitter",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.drive]\nstate_delay_s = 0.001\ncommand_delay_s = 0.0005\njitter_s = 0.002\n",
    ),
    (
        "rotors, 4 ms of delay",
        "1",
        "[plant]\npreset = \"typical\"\n[plant.inertia]\nrotors = true\n[plant.drive]\nstate_delay_s = 0.002\ncommand_delay_s = 0.002\n",
    ),
    (
        "FR3 with rotors, 4 ms of delay, 1,000 N m/s",
        "1",
        "robot = \"fr3\"\n[plant]\npreset = \"typical\"\n[plant.inertia]\nrotors = true\n[plant.drive]\nstate_delay_s = 0.002\ncommand_delay_s = 0.002\n[procedure.law]\ntorque_rate_nm_s = 1000.0\n",
    ),
    // With this seed the joint spring of free motions was unstable.
    (
        "4 ms of delay, seed 3",
        "3",
        "[plant]\npreset = \"typical\"\n[plant.drive]\nstate_delay_s = 0.002\ncommand_delay_s = 0.002\n",
    ),
    (
        "1.5 ms of delay with 2 ms of jitter, seed 3",
        "3",
        "[plant]\npreset = \"typical\"\n[plant.drive]\nstate_delay_s = 0.001\ncommand_delay_s = 0.0005\njitter_s = 0.002\n",
    ),
];

/// Fails if a run of so many poses on one of these arms does not finish, loses a pose, or has more than two faults.
fn all_finish(cases: &[(&str, &str, &str)], poses: u32) {
    for ((name, ..), faults) in cases.iter().zip(faults(cases, poses)) {
        assert!(faults <= 2, "{name}: {faults} faults");
    }
}

/// Faults of each run of so many poses. Fails if one does not finish, or loses a pose.
fn faults(cases: &[(&str, &str, &str)], poses: u32) -> Vec<usize> {
    let mut counts = Vec::new();
    let folder = tempfile::tempdir().expect("a folder");
    for (case, (name, seed, plant)) in cases.iter().enumerate() {
        std::fs::write(folder.path().join("cell.toml"), plant).expect("written");
        let out = case.to_string();
        let arguments = [
            "run",
            "--config",
            "cell.toml",
            "--seed",
            seed,
            "--poses",
            &poses.to_string(),
            "--json",
            "--out",
            &out,
        ];
        let run = spherecal(folder.path(), &arguments);
        let summary: serde_json::Value =
            serde_json::from_slice(&run.stdout).unwrap_or_else(|_| panic!("{name}: {}", text(&run.stderr)));
        let faults = summary["faults"].as_array().map_or(99, Vec::len);
        println!("{name}: {} poses, {faults} faults", summary["poses"]["recorded"]);
        assert_eq!(summary["poses"]["recorded"], poses, "{name}: {}", text(&run.stderr));
        counts.push(faults);
    }
    counts
}

/// One of each kind: everything at once, elasticity, friction, and delay.
const KINDS: [&str; 4] = [
    "harsh",
    "elastic, 7,000 N m/rad",
    "dry friction to 2 N m",
    "1.5 ms of delay with 2 ms of jitter, seed 3",
];

// Fails if a run on one arm of each kind does not finish, loses a pose, or has more than two faults.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_hard_arms_finish() {
    let cases: Vec<_> = CASES.into_iter().filter(|(name, ..)| KINDS.contains(name)).collect();
    assert_eq!(cases.len(), KINDS.len());
    all_finish(&cases, 30);
}

// Fails if whole runs on the arms of Franka do not finish. Their light wrists stick in dry friction, and seven joints keep
// the rank of the Jacobian where the axes 1 and 3 align: with these seeds poses were lost, or the run ended.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_arms_of_franka_finish() {
    let harsh = |robot: &str| format!("robot = \"{robot}\"\n[plant]\npreset = \"harsh\"\n");
    let (panda, fr3) = (harsh("panda"), harsh("fr3"));
    all_finish(&[("Panda, harsh", "5", &panda), ("FR3, harsh", "4", &fr3)], 150);
}

/// A nest with such a magnet (N), declared; the limit of the force is raised where it must be.
fn magnet(newton: f64) -> String {
    let limit_n = (newton + 10.0).max(100.0);
    format!(
        "[plant.nest]\nmagnet_n = {newton}\n[procedure.decouple]\nmagnet_n = {newton}\n[procedure.limits]\nforce_n = {limit_n}\n"
    )
}

// Fails if a magnet that holds with three times as much as the usual one cannot be left: `pressing` with fixed limits.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_strong_magnet_is_left() {
    all_finish(&[("79 N", "1", &magnet(79.0))], 9);
}

// Fails if a magnet that no joint of the arm pulls off, or whose limits no arm leaves it with, is not refused before anything moves
// with its name.
#[test]
fn a_magnet_that_cannot_be_left_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let long = magnet(265.0).replace("[procedure.limits]", "retreat_m = 0.11\n[procedure.limits]");
    for (cell, told) in [
        (long, "joint 2 to leave sphere 1, and the joint gives 176 N m"),
        (
            magnet(265.0),
            "decouple.retreat_m (with this decouple.magnet_n) is 0.05: give a value from 0.106",
        ),
    ] {
        let quick = format!("[plan]\nposes = 3\nchoice = \"grid\"\n{cell}");
        std::fs::write(folder.path().join("cell.toml"), quick).expect("written");
        let run = spherecal(folder.path(), &["measure", "--config", "cell.toml", "--out", "cell"]);
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(2), "{said}");
        assert!(said.contains(told) && said.contains("decouple.magnet_n"), "{said}");
    }
}

// Fails if a run with a weak or a strong magnet does not finish, loses a pose, or has more than two faults.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_magnets_are_left() {
    for newton in [13.0, 79.0, 120.0] {
        let (name, cell) = (format!("{newton} N"), magnet(newton));
        all_finish(&["1", "2", "3"].map(|seed| (name.as_str(), seed, cell.as_str())), 30);
    }
}

/// Errors that no model of the arm has, with the robots' names: cables that pull both joints of the wrist with 1.5 N m, 8 N m
/// of bias at a torque sensor of the shoulder, and play of all sensors of so many per cent of their range to each side.
fn disturbed(robot: &str) -> [(String, String); 5] {
    let before = if robot == "ur5e" { 4 } else { 5 };
    let cable = format!("cable_nm = [{}1.5, 1.5]", "0.0, ".repeat(before));
    [
        ("cables", cable.as_str()),
        ("bias", "torque_bias_nm = [0.0, 8.0]"),
        ("play of 0.25 %", "torque_play_share = 0.0025"),
        ("play of 0.5 %", "torque_play_share = 0.005"),
        ("play of 1 %", "torque_play_share = 0.01"),
    ]
    .map(|(name, field)| {
        let plant = format!("robot = \"{robot}\"\n[plant]\npreset = \"typical\"\n[plant.disturbance]\n{field}\n");
        (format!("{robot}, {name}"), plant)
    })
}

// Fails if a free motion of an arm does not reach its target against a cable, a bias of 8 N m or play of its torque
// sensors, or an approach misses its sphere.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_disturbed_arms_finish() {
    let cases = disturbed("iiwa7");
    let cases: Vec<_> = cases
        .iter()
        .map(|(name, plant)| (name.as_str(), "1", plant.as_str()))
        .collect();
    all_finish(&[cases[0], cases[1], cases[3]], 6);
}

/// Runs with a third fault, where two are asked for: `docs/design/control.md` has the matrix.
const THIRD_FAULT: [(&str, &str); 2] = [("fr3, cables", "3"), ("ur5e, play of 1 %", "1")];

// Fails if one of three arms does not finish a run with one of these errors, loses a pose, or has more than two faults; more than three
// where that is known.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_disturbed_arms_finish() {
    for robot in ["iiwa7", "fr3", "ur5e"] {
        let cases = disturbed(robot);
        for seed in ["1", "2", "3"] {
            let cases: Vec<_> = cases
                .iter()
                .map(|(name, plant)| (name.as_str(), seed, plant.as_str()))
                .collect();
            for ((name, ..), faults) in cases.iter().zip(faults(&cases, 30)) {
                let most = if THIRD_FAULT.contains(&(*name, seed)) { 3 } else { 2 };
                assert!(faults <= most, "{name}, seed {seed}: {faults} faults");
            }
        }
    }
}

// Fails if one of three arms that hide their motors does not finish a run on a drive that answers later than it declares, by 3 or 4 ms
// at all times or in every second second, or if one that answers 6 ms later is not refused with that figure.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_delays_that_are_not_declared_are_found() {
    let plant = |robot: &str, fields: &str| {
        format!("robot = \"{robot}\"\n[plant]\npreset = \"typical\"\n[plant.drive]\n{fields}\n")
    };
    let always = |each_s: f64| format!("state_delay_s = {each_s}\ncommand_delay_s = {each_s}\ndeclared_s = 0.0");
    let folder = tempfile::tempdir().expect("a folder");
    for robot in ["iiwa7", "fr3", "ur5e"] {
        for each_s in [0.0015, 0.002] {
            let steps = format!("step_s = {each_s}\nstep_every_s = 1.0");
            let cells = [plant(robot, &steps), plant(robot, &always(each_s))];
            for seed in ["1", "2", "3"] {
                all_finish(&[(robot, seed, &cells[0]), (robot, seed, &cells[1])], 30);
            }
        }
        std::fs::write(folder.path().join("cell.toml"), plant(robot, &always(0.003))).expect("written");
        let run = spherecal(folder.path(), &["run", "--config", "cell.toml", "--poses", "6"]);
        let said = text(&run.stderr);
        assert_eq!(run.status.code(), Some(1), "{said}");
        assert!(said.contains("6000 µs") && said.contains("5000 µs"), "{said}");
    }
}

// Fails if an arm with motors that show does not finish a run on a drive that declares 2 or 4 ms of delay: elastic joints rang.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_late_drives_with_motors_finish() {
    for robot in ["iiwa7", "panda", "fr3", "ur5e", "ur10e", "ur16e", "ur30"] {
        for preset in ["as_measured", "harsh"] {
            for each_s in [0.001, 0.002] {
                let cell = format!(
                    "robot = \"{robot}\"\n[plant]\npreset = \"{preset}\"\n[plant.drive]\nstate_delay_s = {each_s}\n\
                     command_delay_s = {each_s}\n"
                );
                all_finish(&[(robot, "1", &cell)], 30);
            }
        }
    }
}

// Fails if a run on any of the arms does.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_all_hard_arms_finish() {
    all_finish(&CASES, 30);
}

// Fails if a drive whose delay allows no safe gains is not refused with the delay
// and the limit before anything moves.
#[test]
fn a_drive_that_answers_too_late_is_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let cell = "[plant.drive]\nstate_delay_s = 0.003\ncommand_delay_s = 0.003\n";
    std::fs::write(folder.path().join("cell.toml"), cell).expect("written");
    let run = spherecal(folder.path(), &["run", "--config", "cell.toml", "--poses", "6"]);
    assert_eq!(run.status.code(), Some(1));
    let message = text(&run.stderr);
    assert!(message.contains("6000 µs") && message.contains("5000 µs"), "{message}");
}
