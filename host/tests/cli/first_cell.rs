//! A first cell: from `spherecal init` to a report, and what `init` refuses.

use std::path::Path;
use std::process::{Command, Stdio};

use crate::support::{PROGRAM, spherecal, text};

const STATED: &[&str] = &[
    "--robot",
    "fr3",
    "--serial",
    "FR3-0042",
    "--plate",
    "300.0091,300.2437,300.1173",
    "--tool-mass-kg",
    "0.8",
];

fn init(folder: &Path, more: &[&str]) -> std::process::Output {
    let output = Command::new(PROGRAM)
        .args([&["init"], more].concat())
        .current_dir(folder)
        .stdin(Stdio::null())
        .output();
    output.expect("the program starts")
}

/// The last line of an output, without `Next: `, as a shell reads it.
fn next(stdout: &[u8]) -> Vec<String> {
    let said = text(stdout);
    let line = said.lines().last().unwrap_or_default();
    let command = line
        .strip_prefix("Next: spherecal ")
        .unwrap_or_else(|| panic!("{said}"));
    shlex::split(command).expect("as a shell reads it")
}

// Fails if five commands do not lead from nothing to the report of a simulated FR3, or if a command
// that `init` names is not the next one.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_from_init_to_the_report_in_five_commands() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let made = init(
        folder,
        &[STATED, &["--plate-certificate", "PC-7", "--yes", "--out", "my cell"]].concat(),
    );
    assert!(made.status.success(), "{}", text(&made.stderr));
    let words = next(&made.stdout);
    assert_eq!(words, ["run", "--config", "my cell/cell.toml", "--out", "my cell"]);
    let run: Vec<&str> = words.iter().map(String::as_str).chain(["--poses", "12"]).collect();
    let mut plan = run.clone();
    plan[0] = "plan";
    let commands: [&[&str]; 4] = [
        &["config", "--config", "my cell/cell.toml"],
        &plan,
        &run,
        &["report", "--out", "my cell"],
    ];
    for command in commands {
        let output = spherecal(folder, command);
        // Twelve poses may be too few for a result to be trusted.
        assert!(
            matches!(output.status.code(), Some(0 | 3)),
            "{command:?}: {}",
            text(&output.stderr)
        );
    }
    let summary = std::fs::read(folder.join("my cell/summary.json")).expect("a summary");
    let summary: serde_json::Value = serde_json::from_slice(&summary).expect("JSON");
    assert_eq!(
        (&summary["robot"], &summary["arm"]),
        (&"fr3".into(), &"FR3-0042".into())
    );
    assert_eq!(summary["poses"]["recorded"], 12);
    assert_eq!(summary["faults"].as_array().map(Vec::len), Some(0));
    let report = std::fs::read_to_string(folder.join("my cell/report.html")).expect("a report");
    assert!(report.contains("FR3-0042") && report.contains("PC-7"));
}

// Fails if the table that `init` begins is not one that `identify` takes with the command that it
// names, if a table without rows is identified, or if an option there is wrong.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_poses_are_filled_in_and_identified() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let made = init(folder, &[STATED, &["--plate-certificate", "PC-7"]].concat());
    assert!(made.status.success(), "{}", text(&made.stderr));
    let said = text(&made.stdout);
    let line = said.lines().find_map(|l| l.trim().strip_prefix("spherecal identify "));
    let words = shlex::split(line.unwrap_or_else(|| panic!("{said}"))).expect("as a shell reads it");
    let identify: Vec<&str> = ["identify"]
        .into_iter()
        .chain(words.iter().map(String::as_str))
        .collect();
    let empty = spherecal(folder, &identify);
    assert_eq!(empty.status.code(), Some(2));
    assert!(text(&empty.stderr).contains("no rows"), "{}", text(&empty.stderr));

    // With poses 12 degrees from the stretched posture, this FR3 swung through it and gave a sphere up.
    let measure = ["measure", "--config", "cell.toml", "--poses", "24", "--out", "o"];
    let measured = spherecal(folder, &measure);
    assert!(measured.status.success(), "{}", text(&measured.stderr));
    let exported = spherecal(folder, &["export", "--csv", "--out", "o"]);
    assert!(exported.status.success(), "{}", text(&exported.stderr));
    // The rows of the run, under the header that `init` wrote.
    let header = std::fs::read_to_string(folder.join("poses.csv")).expect("read");
    let columns: Vec<&str> = header.trim_end().split(',').collect();
    assert_eq!(header, "q1,q2,q3,q4,q5,q6,q7,sphere\n");
    let table = std::fs::read_to_string(folder.join("o/tables/poses.csv")).expect("read");
    let mut lines = table.lines();
    let names: Vec<&str> = lines.next().expect("a header").split(',').collect();
    let mut filled = header.clone();
    for line in lines {
        let cells: Vec<&str> = line.split(',').collect();
        let cell = |column: &&str| cells[names.iter().position(|name| name == column).expect("a column")];
        filled += &columns.iter().map(cell).collect::<Vec<_>>().join(",");
        filled.push('\n');
    }
    std::fs::write(folder.join("poses.csv"), filled).expect("written");
    let output = spherecal(folder, &identify);
    assert!(matches!(output.status.code(), Some(0 | 3)), "{}", text(&output.stderr));
    assert!(folder.join("identified/calibrated.toml").exists());
    let drafted = spherecal(folder, &["certificate", "identified", "--draft"]);
    assert!(drafted.status.success(), "{}", text(&drafted.stderr));
    let draft = std::fs::read_to_string(folder.join("identified/certificate-draft.html")).expect("a draft");
    assert!(draft.contains("PC-7") && draft.contains("FR3-0042"));
}

// Fails if the columns for an instrument are not those that `identify` takes.
#[test]
fn an_instrument_has_its_columns() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let made = init(folder, &[STATED, &["--instrument", "tracker", "--degrees"]].concat());
    assert!(made.status.success(), "{}", text(&made.stderr));
    let header = std::fs::read_to_string(folder.join("poses.csv")).expect("read");
    let joints: String = (1..=7).map(|k| format!("q{k}_deg,")).collect();
    assert_eq!(header, format!("{joints}x_mm,y_mm,z_mm\n"));
    let words = next(&made.stdout);
    let identify: Vec<&str> = words.iter().map(String::as_str).collect();
    assert_eq!(identify[..5], ["identify", "--robot", "fr3", "--data", "poses.csv"]);
    let output = spherecal(folder, &identify);
    assert_eq!(output.status.code(), Some(2));
    // The header is taken; only rows are missing.
    assert!(text(&output.stderr).contains("no rows"), "{}", text(&output.stderr));
}

// Fails if wrong or missing input is not refused with exit code 2 and the words that help, or if
// something is written then.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_wrong_input_is_refused_before_anything_is_written() {
    type Case = (&'static [&'static str], &'static [&'static str]);
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(
        folder.join("two.toml"),
        "[[sphere]]\nid = 4\nx_mm = 0\ny_mm = 0\nz_mm = 0\n",
    )
    .expect("written");
    let cases: &[Case] = &[
        (&["--robot", "fr4"], &["robot \"fr4\"", "did you mean fr3?", "ur5e"]),
        (&["--robot", "arm.urdf"], &["arm.urdf", "no such file"]),
        (&["--serial", ""], &["--serial is \"\"", "name plate"]),
        (
            &["--plate", "300,300"],
            &["--plate is \"300,300\"", "distances of the centres 1-2, 1-3 and 2-3"],
        ),
        (&["--plate", "300,x,300"], &["300,x,300", "no such file"]),
        (
            &["--plate", "100,100,250"],
            &["--plate is 100,100,250", "no triangle", "250"],
        ),
        (
            &["--plate", "0.3,0.3,0.3"],
            &["0.3 mm from sphere 1 to sphere 2", "in mm"],
        ),
        (&["--plate", "0,0,0;300,0,0;600,0.5,0"], &["one line", "certificate"]),
        (&["--plate", "0,0,0;300,0,0"], &["2 spheres", "three"]),
        (&["--plate", "two.toml"], &["two.toml", "number them 1, 2, 3"]),
        (&["--plate-u-mm", "0"], &["--plate-u-mm is 0", "k = 2"]),
        (
            &["--sphere-diameter-mm", "-5"],
            &["--sphere-diameter-mm is -5", "from 2 to 200"],
        ),
        (&["--tool-mass-kg", "-1"], &["--tool-mass-kg is -1", "above 0"]),
        (
            &["--tool-mass-kg", "3.01"],
            &["--tool-mass-kg is 3.01", "payload of 3 kg"],
        ),
        (&["--tool-mass-kg", "heavy"], &["heavy", "--tool-mass-kg"]),
        (&["--tool-mm", "1,2"], &["--tool-mm is \"1,2\"", "three numbers"]),
        (&["--tool-mm", "0,0,9999"], &["--tool-mm is \"0,0,9999\"", "2000"]),
        (&["--tool-mm", "0,0,0"], &["--tool-mm is 0,0,0", "radius"]),
        (
            &["--tool-com-mm", "a,b,c"],
            &["--tool-com-mm is \"a,b,c\"", "three numbers"],
        ),
        (
            &["--plate-at-mm", "2000,0,300"],
            &[
                "--plate-at-mm is 2000,0,300",
                "the arm reaches the whole plate",
                "--plate-yaw-deg",
            ],
        ),
        (
            &["--plate-at-mm", "1,2,3,4"],
            &["--plate-at-mm is \"1,2,3,4\"", "three numbers"],
        ),
        (&["--plate-yaw-deg", "1e3"], &["--plate-yaw-deg is 1000", "-360 to 360"]),
        (&["--instrument", "ruler"], &["--instrument", "ruler", "tracker"]),
    ];
    for (wrong, words) in cases {
        // The wrong value in the place of the good one.
        let mut arguments: Vec<&str> = STATED
            .chunks(2)
            .filter(|pair| pair[0] != wrong[0])
            .flatten()
            .copied()
            .collect();
        arguments.extend(*wrong);
        arguments.extend(["--yes", "--out", "o"]);
        let output = init(folder, &arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{wrong:?}: {said}");
        for word in *words {
            assert!(said.contains(word), "{wrong:?} does not say {word:?}: {said}");
        }
        assert!(!folder.join("o").exists(), "{wrong:?} leaves files");
    }
    for (arguments, words) in [
        (
            &[][..],
            &["no terminal", "--robot", "--serial", "--plate", "--tool-mass-kg"][..],
        ),
        (
            &["--robot", "fr3", "--serial", "A", "--yes"],
            &["--yes asks nothing", "--plate D12,D13,D23", "--tool-mass-kg"],
        ),
    ] {
        let output = init(folder, arguments);
        let said = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{said}");
        assert!(words.iter().all(|word| said.contains(word)), "{said}");
        assert_eq!(said.contains("--robot"), arguments.is_empty(), "{said}");
    }
    assert!(!folder.join("cell.toml").exists());
}

// Fails if a file of the user is overwritten, or is not named.
#[test]
fn nothing_is_overwritten() {
    for name in ["cell.toml", "plate.toml", "poses.csv"] {
        let folder = tempfile::tempdir().expect("a folder");
        let folder = folder.path();
        std::fs::write(folder.join(name), "mine").expect("written");
        let output = init(folder, STATED);
        assert_eq!(output.status.code(), Some(2));
        let said = text(&output.stderr);
        assert!(said.contains(name) && said.contains("give another --out"), "{said}");
        assert_eq!(std::fs::read_to_string(folder.join(name)).expect("read"), "mine");
        assert_eq!(std::fs::read_dir(folder).expect("a folder").count(), 1);
    }
}

// Fails if a built-in robot does not get from `init` to a report of a result that may be used, for a seed. The
// `ROBOT_SEEDS` (their number, 2 where it is not set) begin at 1.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_every_built_in_robot_from_init_to_the_report() {
    let seeds = std::env::var("ROBOT_SEEDS")
        .ok()
        .and_then(|n| n.parse().ok())
        .unwrap_or(2);
    let mut wrong = Vec::new();
    for &robot in spherecal_shared::robot::BUILT_IN {
        for seed in 1..=seeds {
            let folder = tempfile::tempdir().expect("a folder");
            let folder = folder.path();
            let seed = seed.to_string();
            let made = init(folder, &[&["--robot", robot], &STATED[2..], &["--yes"]].concat());
            let run = [
                "run",
                "--config",
                "cell.toml",
                "--seed",
                &seed,
                "--poses",
                "24",
                "--out",
                "o",
            ];
            let measured = spherecal(folder, &run);
            let reported = spherecal(folder, &["report", "--out", "o"]);
            for (name, output) in [("init", made), ("run", measured), ("report", reported)] {
                if output.status.code() != Some(0) {
                    let told = text(&output.stderr);
                    let last = told.lines().last().unwrap_or_default();
                    wrong.push(format!(
                        "{robot}, seed {seed}: {name} ends with {:?}: {last}",
                        output.status.code()
                    ));
                }
            }
        }
    }
    assert!(wrong.is_empty(), "{wrong:#?}");
}
