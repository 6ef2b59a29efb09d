//! The page of results on real robots, against the program.

use serde_json::Value;

use crate::docs::root;
use crate::support::{spherecal, text};

/// Two sockets 50 mm apart, as the page says.
const SOCKETS: &str = "[[sphere]]\nid = 1\nx_mm = 0\ny_mm = 0\nz_mm = 0\nsigma_mm = 0.005\n\
                       [[sphere]]\nid = 2\nx_mm = 50\ny_mm = 0\nz_mm = 0\nsigma_mm = 0.005\n";

// Fails if the page states other figures than the program finds, if the table for sharing is not written, or if it
// replaces a file.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_the_page_states_what_the_program_finds() {
    let page = std::fs::read_to_string(root().join("docs/real-data.md")).expect("the page");
    let row = page
        .lines()
        .find(|line| line.starts_with("| KUKA LBR iiwa 14"))
        .expect("the row");
    let cells: Vec<&str> = row.split('|').map(str::trim).collect();
    let stated = |cell: usize| -> f64 { cells[cell].trim_end_matches(" mm").parse().expect("a number of mm") };
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("sockets.toml"), SOCKETS).expect("written");
    let data = |name: &str| root().join("tests/data").join(name).display().to_string();
    let (robot, table) = (data("iiwa14.urdf"), data("mukca_iiwa14.csv"));
    let mut arguments = vec![
        "identify",
        "--robot",
        &robot,
        "--data",
        &table,
        "--plate",
        "sockets.toml",
    ];
    arguments.extend(["--holdout", "place", "--json", "--anonymise", "shared.csv"]);
    let output = spherecal(folder.path(), &arguments);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let found: Value = serde_json::from_slice(&output.stdout).expect("one document");
    let mean = |model: &str| found["holdout"]["models"][model]["mean_mm"].as_f64().expect("a mean");
    for (cell, model) in [(4, "calibrated"), (5, "nominal")] {
        let (stated, found) = (stated(cell), mean(model));
        assert!(
            (stated - found).abs() < 0.0015,
            "{model}: {stated} stated, {found} found"
        );
    }
    let shared = std::fs::read_to_string(folder.path().join("shared.csv")).expect("written");
    assert_eq!(shared.lines().count(), 181);
    let again = spherecal(folder.path(), &arguments);
    let said = text(&again.stderr);
    assert_eq!(again.status.code(), Some(2), "{said}");
    assert!(said.contains("shared.csv exists already"), "{said}");
}

// Fails if a map of residuals is tried without being asked for, if the document does not say what was tried and why no map
// was kept, or if the text for people keeps it back. A warped tool is `spherecal-identify`'s own test.
#[test]
#[ignore = "long: scripts/test --long runs it"]
fn long_a_map_of_residuals_is_tried_where_it_is_asked_for() {
    let folder = tempfile::tempdir().expect("a folder");
    std::fs::write(folder.path().join("sockets.toml"), SOCKETS).expect("written");
    let data = |name: &str| root().join("tests/data").join(name).display().to_string();
    let (robot, table) = (data("iiwa14.urdf"), data("mukca_iiwa14.csv"));
    let plain = [
        "identify",
        "--robot",
        &robot,
        "--data",
        &table,
        "--plate",
        "sockets.toml",
    ];
    let document = |more: &[&str]| -> Value {
        let output = spherecal(folder.path(), &[&plain[..], more].concat());
        assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
        serde_json::from_slice(&output.stdout).expect("one document")
    };
    let without = document(&["--json"]);
    assert!(without["residual_map"].is_null(), "{}", without["residual_map"]);
    let with = document(&["--json", "--residual-map"]);
    assert_eq!(with["parameters"], without["parameters"]);
    let report = &with["residual_map"];
    assert!(report["map"].is_null(), "{report}");
    assert_eq!(report["blocks"], 10);
    assert_eq!(report["tried"][0]["input"], "orientation");
    assert_eq!(report["tried"][1]["input"], "joints");
    assert!(report["none_mm"].as_f64().is_some_and(|mm| mm > 0.1), "{report}");
    let output = spherecal(folder.path(), &[&plain[..], &["--residual-map"]].concat());
    let said = text(&output.stdout);
    assert!(
        said.contains("Residual map: none was kept (10 contiguous blocks"),
        "{said}"
    );
    let page = std::fs::read_to_string(folder.path().join("spherecal-out/report.html")).expect("the report");
    assert!(page.contains("residual map: none was kept"));
}
