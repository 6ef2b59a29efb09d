//! Several cells and one PostgreSQL database. `scripts/test` starts the server
//! and names it in `SPHERECAL_POSTGRES_URL`; without it these tests say so and
//! are left out.

use std::path::Path;
use std::process::{Child, Output};

use serde_json::Value;

use crate::support::{Server, start};

fn url() -> Option<String> {
    let url = std::env::var("SPHERECAL_POSTGRES_URL").ok();
    if url.is_none() {
        assert!(
            std::env::var_os("SPHERECAL_REQUIRE_FIELD").is_none(),
            "SPHERECAL_POSTGRES_URL is not set: scripts/test starts a server"
        );
        eprintln!("left out: no PostgreSQL server is named in SPHERECAL_POSTGRES_URL");
    }
    url
}

fn ended(child: Child) -> Output {
    child.wait_with_output().expect("it ends")
}

fn json(output: &Output) -> Value {
    let said = String::from_utf8_lossy(&output.stderr);
    serde_json::from_slice(&output.stdout).unwrap_or_else(|e| panic!("{e}: {said}"))
}

/// Three robots at once, each of which writes to `store`, and what is then in
/// the database at `url`; `cell` begins their arms' names.
fn three_at_once(folder: &Path, cell: &str, store: &str, url: &str) {
    let seeds = ["11", "12", "13"];
    let robots: Vec<Child> = seeds
        .iter()
        .map(|seed| {
            let (arm, out) = (format!("{cell}-{seed}"), format!("{cell}{seed}"));
            let arguments = [
                "run", "--poses", "9", "--json", "--seed", seed, "--arm", &arm, "--store", store, "--out", &out,
            ];
            start(folder, &arguments)
        })
        .collect();
    let summaries: Vec<Value> = robots.into_iter().map(|r| json(&ended(r))).collect();

    let history = json(&ended(start(folder, &["history", "--json", "--store", url])));
    let runs = history["runs"].as_array().expect("runs").clone();
    for (seed, summary) in seeds.iter().zip(&summaries) {
        assert_eq!(summary["poses"]["recorded"], 9, "seed {seed}");
        let own = ended(start(
            folder,
            &[
                "run",
                "--poses",
                "9",
                "--json",
                "--seed",
                seed,
                "--out",
                &format!("own{seed}"),
            ],
        ));
        assert_eq!(
            json(&own)["recordings_sha256"],
            summary["recordings_sha256"],
            "seed {seed}"
        );
        // What the database gives back is what a file of its own does.
        let arm = format!("{cell}-{seed}");
        let mine: Vec<&Value> = runs.iter().filter(|r| r["arm"] == arm.as_str()).collect();
        let run = mine.last().expect("the run")["run"].to_string();
        let (from_server, from_file) = (format!("t{seed}"), format!("own{seed}"));
        for arguments in [
            vec!["export", "--csv", "--store", url, "--run", &run, "--out", &from_server],
            vec!["export", "--csv", "--out", &from_file],
        ] {
            let output = ended(start(folder, &arguments));
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
        for table in ["recordings", "contacts", "couplings", "phases", "laser", "parameters"] {
            let read = |out: &str| {
                let path = folder.join(out).join("tables").join(format!("{table}.csv"));
                std::fs::read_to_string(&path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
            };
            assert!(read(&from_server) == read(&from_file), "{table} of seed {seed} differs");
        }
    }
    let mut numbers: Vec<i64> = runs.iter().filter_map(|r| r["run"].as_i64()).collect();
    numbers.dedup();
    assert_eq!(numbers.len(), runs.len(), "{numbers:?}");
}

// Fails if robots that write to one database at once lose a recording, get one
// of another, or a number of a run that is taken, or if PostgreSQL gives back
// another bit than SQLite.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_three_robots_share_one_database() {
    let Some(url) = url() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    three_at_once(folder.path(), "A", &url, &url);
}

// Fails if they do where one server has the database, and they reach it over gRPC.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_three_robots_share_one_service() {
    let Some(url) = url() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let arguments = ["serve", "--grpc", "0", "--service", "store,page", "--store", &url];
    let server = Server::start_in(folder, &arguments);
    three_at_once(folder, "B", &server.peer, &url);
}

// Fails if two calibrations of one arm are seen as drift, or if another arm
// under the same name is not.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_drift_is_told_from_two_calibrations() {
    let Some(url) = url() else { return };
    let folder = tempfile::tempdir().expect("a folder");
    let calibrate = |seed: &str, arm: &str| {
        let out = format!("{seed}{arm}");
        let arguments = [
            "run", "--preset", "typical", "--poses", "30", "--json", "--seed", seed, "--arm", arm, "--store", &url,
            "--out", &out,
        ];
        let output = ended(start(folder.path(), &arguments));
        assert_eq!(
            output.status.code(),
            Some(0),
            "{}",
            String::from_utf8_lossy(&output.stderr)
        );
    };
    let name = |kind: &str| format!("{kind}-{}", std::process::id());
    let (steady, changed) = (name("steady"), name("changed"));
    for (seed, arm) in [("21", &steady), ("21", &steady), ("21", &changed), ("22", &changed)] {
        calibrate(seed, arm);
    }
    let trend = |arm: &str| {
        let output = ended(start(
            folder.path(),
            &["trend", "--json", "--store", &url, "--arm", arm],
        ));
        json(&output)["trends"][0].clone()
    };
    let t = trend(&steady);
    assert_eq!(t["drifting"], false, "{t}");
    assert_eq!(t["steps"].as_array().map(Vec::len), Some(2), "{t}");
    let t = trend(&changed);
    assert_eq!(t["drifting"], true, "{t}");
    assert!(t["steps"][1]["moved_mm"].as_f64().is_some_and(|mm| mm > 0.3), "{t}");
}

// Fails if a server that does not answer is not named, or its password is told.
#[test]
fn a_missing_server_is_named_without_its_password() {
    let folder = tempfile::tempdir().expect("a folder");
    let store = "postgres://robots:secret@127.0.0.1:1/fleet";
    let output = ended(start(folder.path(), &["history", "--store", store]));
    let said = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(
        said.contains("postgres://robots@127.0.0.1:1/fleet") && !said.contains("secret"),
        "{said}"
    );
}
