//! The whole simulated procedure with every built-in arm.

use crate::support::{spherecal, text};

// Fails if an arm with six joints and no elbow, or one with seven joints and a bent elbow, does not come through.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_arms_of_both_kinds_run_the_whole_procedure() {
    all_run(&["ur5e", "fr3"]);
}

// Fails if one of the built-in arms does not.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_every_built_in_arm_runs_the_whole_procedure() {
    let folder = tempfile::tempdir().expect("a folder");
    let list = text(&spherecal(folder.path(), &["robot", "list"]).stdout);
    let names: Vec<&str> = list.lines().filter_map(|line| line.split_whitespace().next()).collect();
    assert!(names.len() >= 7, "{list}");
    all_run(&names);
}

/// Fails if an arm does not come through planning, touching and identification, with the plate where it
/// stands by default or, where that is out of reach, at the very place that the refusal names; or if the
/// result is not far better than the nominal robot.
fn all_run(names: &[&str]) {
    let folder = tempfile::tempdir().expect("a folder");
    for name in names.iter().copied() {
        let mut cell = format!("robot = \"{name}\"\n[plant]\npreset = \"typical\"\n");
        let file = folder.path().join("cell.toml");
        std::fs::write(&file, &cell).expect("written");
        let plan = spherecal(folder.path(), &["plan", "--config", "cell.toml", "--poses", "6"]);
        if !plan.status.success() {
            let refusal = text(&plan.stderr);
            let place = refusal.find("[[cell.placements]]").map(|at| &refusal[at..]);
            cell.push_str(place.unwrap_or_else(|| panic!("{name}: no place is named: {refusal}")));
            std::fs::write(&file, &cell).expect("written");
        }
        let arguments = ["run", "--config", "cell.toml", "--poses", "45", "--json", "--out", name];
        let run = spherecal(folder.path(), &arguments);
        assert!(run.status.success(), "{name}: {}", text(&run.stderr));
        let summary: serde_json::Value = serde_json::from_slice(&run.stdout).expect("JSON");
        assert_eq!(summary["poses"]["recorded"], 45, "{name}");
        assert_eq!(summary["faults"].as_array().map(Vec::len), Some(0), "{name}");
        let mean = |model: &str| summary["validation"]["models"][model]["mean_mm"].as_f64();
        let (nominal, spheres) = (mean("nominal"), mean("sphere"));
        println!("{name}: nominal {nominal:?} mm, spheres {spheres:?} mm");
        assert!(
            spheres.zip(nominal).is_some_and(|(s, n)| s < 0.4 * n),
            "{name}: {spheres:?} of {nominal:?} mm"
        );
    }
}
