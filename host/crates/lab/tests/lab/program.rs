//! The program of the studies: its commands and their refusals; studies on several machines: shards, their merge, and
//! the examples for clusters.

use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::{Duration, Instant};

use clap::Parser as _;
use clap::error::ErrorKind;
use granit_parser::{Event, Parser};
use spherecal_lab::cli::LabCli;

/// The program under test.
const PROGRAM: &str = env!("CARGO_BIN_EXE_spherecal-lab");

/// Runs the program in `folder` to its end.
fn run(folder: &Path, arguments: &[&str]) -> Output {
    let mut command = Command::new(PROGRAM);
    command
        .args(arguments)
        .current_dir(folder)
        .output()
        .expect("the program starts")
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

/// The root of the repository.
fn root() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../..")
}

/// All pages of the documentation.
fn pages() -> Vec<PathBuf> {
    let (mut pages, mut folders) = (vec![root().join("README.md")], vec![root().join("docs")]);
    while let Some(folder) = folders.pop() {
        for entry in std::fs::read_dir(folder).expect("a folder of the book") {
            let path = entry.expect("an entry").path();
            if path.is_dir() {
                folders.push(path);
            } else if path.extension().is_some_and(|extension| extension == "md") {
                pages.push(path);
            }
        }
    }
    pages
}

// Fails if a page shows a command, an option or a value that the program refuses.
#[test]
fn every_command_in_the_documentation_is_one_that_the_program_takes() {
    let (mut checked, mut wrong) = (0, Vec::new());
    for page in pages() {
        let words = std::fs::read_to_string(&page).expect("a page");
        let shown = words.lines().filter_map(|line| line.strip_prefix("$ "));
        let named = words.split('`').filter(|code| !code.contains('\n'));
        for line in shown.chain(named).filter(|line| line.starts_with("spherecal-lab ")) {
            let command = line.split(['#', '|', '>', '&']).next().unwrap_or_default();
            checked += 1;
            match LabCli::try_parse_from(command.split_whitespace()) {
                Err(error) if error.kind() != ErrorKind::DisplayHelp => wrong.push(format!("{line}: {error}")),
                _ => {}
            }
        }
    }
    assert!(checked >= 15, "{checked} commands");
    assert!(wrong.is_empty(), "{wrong:#?}");
}

// Fails if a wrong value is not refused with exit code 2 and the values that there are, or if a study without a run or a
// fault without a name ends otherwise.
#[test]
fn wrong_values_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let cases: [(&[&str], &[&str]); 5] = [
        (&["worlds", "--world", "W9"], &["W9", "W0, W1"]),
        (&["worlds", "--estimator", "best"], &["best", "sphere"]),
        (
            &["faults", "--only", "earthquake"],
            &["\"earthquake\" is not a fault", "--list"],
        ),
        (&["soak", "--hours", "-1"], &["--hours is -1", "at most 10000"]),
        (&[], &["Usage: spherecal-lab"]),
    ];
    for (arguments, parts) in cases {
        let output = run(folder.path(), arguments);
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {told}");
        assert!(parts.iter().all(|part| told.contains(part)), "{arguments:?}: {told}");
    }
}

// Fails if a fault that `faults --list` names cannot be printed as a file.
#[test]
fn the_faults_are_listed_and_shown() {
    let folder = tempfile::tempdir().expect("a folder");
    let list = said(folder.path(), &["faults", "--list"]);
    let names: Vec<&str> = list.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.contains(&"human_push"), "{list}");
    for name in names {
        let file = said(folder.path(), &["faults", "--show", name]);
        assert!(file.contains('='), "{name}: {file}");
    }
}

/// What a command prints; it must end well.
fn said(folder: &Path, arguments: &[&str]) -> String {
    let output = run(folder, arguments);
    assert!(output.status.success(), "{arguments:?}: {}", text(&output.stderr));
    text(&output.stdout)
}

/// One run and the merge of three shards, in text and as JSON.
fn three_shards_and_one_run(study: &[&str], options: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let with = |more: &[&str]| said(folder, &[study, options, more].concat());
    for shard in ["2/3", "3/3", "1/3"] {
        let done = with(&["--shard", shard, "--out", "study"]);
        assert!(done.contains(&format!("Shard {shard}")), "{done}");
    }
    let again: serde_json::Value =
        serde_json::from_str(&with(&["--shard", "1/3", "--out", "study", "--json"])).expect("one document");
    assert_eq!(again["items"], again["done_before"]);
    for json in [&[][..], &["--json"]] {
        let merge = said(folder, &[study, &["--merge", "--out", "study"], json].concat());
        assert_eq!(merge, with(json), "{study:?}");
        assert!(merge.len() > 100, "{merge}");
    }
}

// Fails if the merge of three shards differs from one run by a bit, for any of the studies that can be
// divided, or if a shard that is finished is worked on again.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_three_shards_of_worlds_have_the_bits_of_one_run() {
    let options = ["--world", "W0", "--world", "W4", "--seeds", "2", "--poses", "20"];
    let estimators = ["--estimator", "nominal", "--estimator", "sphere"];
    three_shards_and_one_run(&["worlds"], &[&options[..], &estimators].concat());
}

#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_three_shards_of_faults_have_the_bits_of_one_run() {
    let options = [
        "--only",
        "state_frozen",
        "--only",
        "human_push",
        "--instants",
        "2",
        "--seeds",
        "1",
    ];
    three_shards_and_one_run(&["faults"], &options);
}

#[test]
#[ignore = "long: plans of eight sizes for three robots"]
fn long_three_shards_of_plans_have_the_bits_of_one_run() {
    three_shards_and_one_run(&["worlds", "--plan"], &["--world", "W0", "--seeds", "3"]);
}

#[test]
#[ignore = "long: thirty runs"]
fn long_three_shards_of_a_campaign_and_of_the_paper_have_the_bits_of_one_run() {
    three_shards_and_one_run(&["faults", "--campaign", "4"], &["--seeds", "2"]);
    three_shards_and_one_run(&["reproduce"], &["--robots", "3", "--world", "W1"]);
}

// Fails if a shard that is killed in the middle does not go on, works on a robot again, or if what is
// merged then is not what one run gives.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_killed_shard_goes_on() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let study = [
        "worlds",
        "--world",
        "W0",
        "--seeds",
        "12",
        "--poses",
        "20",
        "--estimator",
        "sphere",
    ];
    let shard = [&study[..], &["--shard", "1/1", "--out", "study"]].concat();
    let file = folder.join("study/worlds-shard-1-of-1.jsonl");
    let lines = || std::fs::read_to_string(&file).map_or(0, |text| text.lines().count());
    let mut child = Command::new(PROGRAM)
        .args(&shard)
        .current_dir(folder)
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .expect("the program starts");
    let begun = Instant::now();
    while lines() < 4 && begun.elapsed() < Duration::from_mins(5) {
        std::thread::sleep(Duration::from_millis(5));
    }
    child.kill().expect("killed");
    child.wait().expect("ended");
    let before = lines();
    assert!(before >= 4, "{before} lines");
    let json = said(folder, &[&shard[..], &["--json"]].concat());
    let done: serde_json::Value = serde_json::from_str(&json).expect("one document");
    assert!(done["done_before"].as_u64().is_some_and(|n| n >= 3), "{done}");
    let merged = said(
        folder,
        &["worlds", "--merge", "--json", "--out", "study", "--rows", "csv"],
    );
    assert_eq!(merged, said(folder, &[&study[..], &["--json"]].concat()));
    // One row for each robot, with the numbers of the table.
    let rows = std::fs::read_to_string(folder.join("study/worlds.csv")).expect("rows");
    let merged: serde_json::Value = serde_json::from_str(&merged).expect("one document");
    let robots = merged["cells"][0]["robots"].as_array().expect("robots");
    assert_eq!(rows.lines().count(), robots.len() + 1);
    let column = rows
        .lines()
        .next()
        .expect("a header")
        .split(',')
        .position(|c| c == "best_fit_mean_mm");
    for (row, robot) in rows.lines().skip(1).zip(robots) {
        let cell = row
            .split(',')
            .nth(column.expect("the column"))
            .and_then(|c| c.parse::<f64>().ok());
        assert_eq!(cell, robot["best_fit"]["mean_mm"].as_f64());
    }
}

// Fails if a wrong shard, a missing shard or one of another study is not refused with exit code 2 and
// what to do.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_wrong_shards_are_refused() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let study = [
        "worlds",
        "--world",
        "W0",
        "--seeds",
        "3",
        "--poses",
        "20",
        "--estimator",
        "nominal",
        "--out",
        "s",
    ];
    said(folder, &[&study[..], &["--shard", "1/3"]].concat());
    let mut other = study;
    other[4] = "4";
    let cases: [(Vec<&str>, &[&str]); 8] = [
        ([&study[..], &["--shard", "4/3"]].concat(), &["4/3", "I from 1 to N"]),
        ([&study[..], &["--shard", "2"]].concat(), &["give I/N"]),
        (
            [&study[..], &["--shard", "1/3", "--merge"]].concat(),
            &["--merge", "cannot be used with"],
        ),
        (
            [&other[..], &["--shard", "1/3"]].concat(),
            &["of another study", "choose another folder"],
        ),
        (
            vec!["worlds", "--merge", "--out", "s"],
            &["shard 2/3 has 0 of 1 robots", "--shard 2/3"],
        ),
        (
            vec!["worlds", "--merge", "--plan", "--out", "s"],
            &["holds no shard of `worlds --plan`"],
        ),
        (vec!["reproduce", "--shard", "1/3"], &["--robots N"]),
        (vec!["faults", "--worst", "--shard", "1/3"], &["cannot be used with"]),
    ];
    for (arguments, parts) in cases {
        let output = run(folder, &arguments);
        let told = text(&output.stderr);
        assert_eq!(output.status.code(), Some(2), "{arguments:?}: {told}");
        assert!(parts.iter().all(|part| told.contains(part)), "{arguments:?}: {told}");
    }
}

/// Runs a command of an example in `folder`.
fn shell(folder: &Path, command: &[&str], variables: &[(&str, &str)]) {
    let program = Path::new(PROGRAM).parent().expect("a folder");
    let path = format!("{}:{}", program.display(), std::env::var("PATH").unwrap_or_default());
    let output = Command::new("sh")
        .args(command)
        .current_dir(folder)
        .env("PATH", path)
        .envs(variables.iter().copied())
        .output()
        .expect("a shell");
    assert!(output.status.success(), "{command:?}: {}", text(&output.stderr));
}

/// The only argument of the container in a Kubernetes manifest, which must be YAML.
fn argument(manifest: &str) -> String {
    let text = std::fs::read_to_string(root().join("examples/cluster").join(manifest)).expect("the example");
    let scalars = Parser::new_from_str(&text).map(|event| match event.expect("YAML").0 {
        Event::Scalar(value, ..) => value.to_string(),
        _ => String::new(),
    });
    let words: Vec<String> = scalars.collect();
    let found = words.iter().find(|word| word.starts_with("exec spherecal-lab"));
    found.unwrap_or_else(|| panic!("{manifest}")).clone()
}

// Fails if the job array for Slurm or the manifests for Kubernetes do not run, or give another result
// than one run.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_the_examples_for_clusters_run() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let small = [("ROBOTS", "1"), ("POSES", "20"), ("SHARDS", "2"), ("ROWS", "csv")];
    let slurm = root()
        .join("examples/cluster/slurm.sh")
        .canonicalize()
        .expect("the example");
    let (job, merge) = (argument("kubernetes.yaml"), argument("kubernetes-merge.yaml"));
    for shard in 1..=2 {
        let (task, index) = (shard.to_string(), (shard - 1).to_string());
        let array = [
            ("SLURM_ARRAY_TASK_ID", &*task),
            ("SLURM_ARRAY_TASK_COUNT", "2"),
            ("STUDY", "slurm"),
        ];
        shell(folder, &[&slurm.display().to_string()], &[&small[..], &array].concat());
        let pod = [("JOB_COMPLETION_INDEX", &*index), ("STUDY", "pods")];
        shell(folder, &["-c", &job], &[&small[..], &pod].concat());
    }
    shell(folder, &["-c", &merge], &[&small[..], &[("STUDY", "pods")]].concat());
    assert!(folder.join("pods/worlds.csv").exists());
    let merged = |out: &str| said(folder, &["worlds", "--merge", "--json", "--out", out]);
    assert_eq!(merged("slurm"), merged("pods"));
    assert!(merged("slurm").contains("\"W4\""));
}
