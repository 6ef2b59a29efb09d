//! The page of results on real robots, against the program.

use serde_json::Value;

use crate::docs::root;
use crate::support::{spherecal, text};

/// Two sockets 50 mm apart, as the page says.
pub(crate) const SOCKETS: &str = "[[sphere]]\nid = 1\nx_mm = 0\ny_mm = 0\nz_mm = 0\nsigma_mm = 0.005\n\
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
