//! `spherecal certificate`: the same figures as `summary.json`, from a run and from a table of poses, what it refuses, and what
//! becomes of it and of the report on paper.

use std::path::Path;

use serde_json::{Value, json};

use crate::field::{check, python, table};
use crate::support::{spherecal, text};

/// What a laboratory states.
const STATED: &str = "[certificate]\nnumber = \"K-2026-117\"\nlaboratory = \"Metrology <North> & Sons\"\n\
                      laboratory_address = \"1 Station Road, York\"\ncustomer = \"Gearworks\"\n\
                      customer_address = \"4 Mill Lane, Leeds\"\nauthorised_by = \"A. Brown\"\nserial = \"A-17\"\n\
                      place = \"Hall 2, cell 7\"\noperator = \"Zo\u{eb} Miller\"\ntemperature_c = 21.4\n\
                      instrument = \"AT960 s/n 750312\"\ninstrument_certificate = \"D-K-2026-0815\"\n\
                      plate = \"P3 s/n 41\"\nplate_certificate = \"D-K-2026-0042\"\nvalidity_months = 12\n";

fn read(path: &Path) -> String {
    std::fs::read_to_string(path).unwrap_or_else(|e| panic!("{}: {e}", path.display()))
}

/// The certificate as text, without markup.
fn certificate_of(page: &str) -> String {
    let start = page.find("<body>").expect("a page");
    let section = &page[start..];
    let mut out = String::new();
    let mut inside = false;
    for c in section.chars() {
        match c {
            '<' => {
                inside = true;
                out.push(' ');
            }
            '>' => inside = false,
            c if !inside => out.push(c),
            _ => {}
        }
    }
    let plain = out
        .replace("&lt;", "<")
        .replace("&gt;", ">")
        .replace("&quot;", "\"")
        .replace("&#39;", "'")
        .replace("&amp;", "&");
    plain.split_whitespace().collect::<Vec<_>>().join(" ")
}

/// Every figure and name of the certificate, as it is printed.
fn shown(path: &str, value: &Value, out: &mut Vec<(String, String)>) {
    match value {
        Value::Number(n) => {
            let number = n.as_f64().expect("a number");
            let plain = number.fract() == 0.0 || path.ends_with("temperature_c");
            let words = if plain {
                number.to_string()
            } else {
                spherecal::report::millimetres(number)
            };
            out.push((path.to_owned(), words));
        }
        // The name of a source for programs.
        Value::String(s) if !path.ends_with(".source") => out.push((path.to_owned(), s.clone())),
        Value::Array(list) => list
            .iter()
            .enumerate()
            // The certificate has reasons by their first clause.
            .filter(|_| !path.ends_with(".reasons"))
            .for_each(|(k, v)| shown(&format!("{path}.{k}"), v, out)),
        Value::Object(map) => map.iter().for_each(|(k, v)| shown(&format!("{path}.{k}"), v, out)),
        _ => {}
    }
}

fn same(certificate: &Value, page: &str, least: usize) {
    let mut all = Vec::new();
    shown("certificate", certificate, &mut all);
    assert!(all.len() >= least, "{} in {certificate:#}", all.len());
    // What is stated of a plate says nothing of measured points.
    let of_no_use = |path: &str| certificate["contacts"] == false && path.starts_with("certificate.plate");
    for (path, words) in all.into_iter().filter(|(path, _)| !of_no_use(path)) {
        let words = words.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(
            page.contains(&words),
            "{path}: {words} is not on the certificate: {page}"
        );
    }
    // The terms add up.
    let number = |v: &Value| v.as_f64().expect("a number");
    let terms = certificate["budget"].as_array().expect("a budget").iter();
    let squares: f64 = terms.filter_map(|t| t["rms_mm"].as_f64()).map(|t| t * t).sum();
    let u = number(&certificate["uncertainty"]["standard_mm"]);
    assert!((squares.sqrt() / u - 1.0).abs() < 1e-6, "{certificate:#}");
    assert!((number(&certificate["uncertainty"]["expanded_mm"]) / u - 2.0).abs() < 1e-9);
    let mean = number(&certificate["expected_error_mm"]["mean"]);
    assert!((0.9..2.0).contains(&(u / mean)), "u {u} mm, expected error {mean} mm");
}

// Fails if the certificate of a run shows another figure, name or hash than summary.json has under `certificate`, lacks what
// the user stated, hides that the run is simulated, or is written as more than a draft; or if report or certificate are cut
// on A4 or Letter, or longer than they may be.
#[test]
#[ignore = "slow: the gate runs it"]
fn slow_a_run_has_its_certificate() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    std::fs::write(folder.join("cell.toml"), format!("arm = \"A-17\"\n{STATED}")).expect("written");
    let output = spherecal(folder, &["run", "--config", "cell.toml", "--poses", "60", "--out", "o"]);
    assert_eq!(output.status.code(), Some(0), "{}", text(&output.stderr));
    let refused = spherecal(folder, &["certificate", "o"]);
    assert_eq!(refused.status.code(), Some(2));
    assert!(text(&refused.stderr).contains("the arm was a simulation"));
    let written = spherecal(folder, &["certificate", "o", "--draft"]);
    assert_eq!(written.status.code(), Some(0), "{}", text(&written.stderr));
    let summary: Value = serde_json::from_str(&read(&folder.join("o/summary.json"))).expect("JSON");
    let certificate = &summary["certificate"];
    let html = read(&folder.join("o/report.html"));
    assert!(!html.contains("certifies no robot"));
    let page = certificate_of(&read(&folder.join("o/certificate-draft.html")));
    same(certificate, &page, 45);
    assert_eq!(certificate["recordings_sha256"], summary["recordings_sha256"]);
    for figure in ["mean", "interval", "p95"] {
        assert_eq!(
            certificate["expected_error_mm"][figure],
            summary["verdict"]["expected_error_mm"][figure]
        );
    }
    assert_eq!(
        (&certificate["simulated"], &certificate["serial"]),
        (&json!(true), &json!("A-17"))
    );
    assert!(
        page.contains("SIMULATED") && page.contains("certifies no robot") && page.contains("DRAFT"),
        "{page}"
    );
    assert_eq!(certificate["position_errors"].as_array().map(Vec::len), Some(2));
    let sphere = &summary["validation"]["models"]["sphere"];
    assert_eq!(certificate["position_errors"][0]["mean_mm"], sphere["mean_mm"]);
    assert_eq!(
        certificate["position_errors"][1]["mean_mm"],
        sphere["best_fit"]["mean_mm"]
    );
    assert!(
        certificate["repeatability"]["couplings"]
            .as_u64()
            .is_some_and(|n| n >= 2)
    );
    // The hash is that of the configuration that the database has.
    let again = spherecal(folder, &["identify", "--out", "o", "--json"]);
    let again: Value = serde_json::from_slice(&again.stdout).expect("JSON");
    assert_eq!(&again["certificate"], certificate);
    // Models have the names that the terminal prints.
    let table = spherecal(folder, &["validate", "--out", "o"]);
    let said = text(&table.stdout);
    for name in ["spheres (this calibration)", "laser tracker, full model"] {
        assert!(said.contains(name) && html.contains(name), "{name}");
    }

    let Some(python) = python() else { return };
    let shots = std::env::var_os("SPHERECAL_SHOTS").map_or_else(|| folder.join("shots"), Into::into);
    for (page, pages, folds) in [("report.html", 3..=6, 4), ("certificate-draft.html", 1..=2, 0)] {
        let path = folder.join("o").join(page);
        let found = check(&python, "tests/python/check_print.py", &[&path, &shots]);
        for paper in ["a4", "letter"] {
            let found = &found[paper];
            assert_eq!(found["cut"], json!([]), "{page}, {paper}: {found}");
            assert_eq!(
                (&found["open"], &found["split_rows"]),
                (&json!(0), &json!(0)),
                "{page}, {paper}: {found}"
            );
            assert!(
                found["folds"].as_u64().is_some_and(|n| n >= folds),
                "{page}, {paper}: {found}"
            );
            assert!(
                found["pages"].as_u64().is_some_and(|n| pages.contains(&n)),
                "{page}, {paper}: {found}"
            );
        }
    }
}

// Fails if a table of poses gives no certificate, if the certificate shows another figure than summary.json, invents a plate, a
// date or an accuracy, if names that were given are lost, or if a certificate is written that lacks a name, or of a result
// that must not be used.
#[test]
fn a_table_of_poses_has_a_certificate_with_what_is_known() {
    let folder = tempfile::tempdir().expect("a folder");
    let folder = folder.path();
    let ur5e = spherecal::model::robots::load("ur5e").expect("a built-in robot");
    std::fs::write(folder.join("poses.csv"), table(&ur5e)).expect("written");
    std::fs::write(
        folder.join("cell.toml"),
        format!("{STATED}measured_on = \"2026-02-28\"\n"),
    )
    .expect("written");
    let identify = ["identify", "--robot", "ur5e", "--data", "poses.csv", "--out"];
    for (out, more, least) in [
        ("bare", &[][..], 20),
        ("named", &["--certificate", "cell.toml"][..], 30),
    ] {
        let output = spherecal(folder, &[&identify[..], &[out], more].concat());
        assert!(matches!(output.status.code(), Some(0 | 3)), "{}", text(&output.stderr));
        let file = folder.join(out).join("summary.json");
        let summary: Value = serde_json::from_str(&read(&file)).expect("JSON");
        let certificate = &summary["certificate"];
        assert_eq!(certificate["may_be_used"], true, "{certificate:#}");
        let written = spherecal(folder, &["certificate", out]);
        let page = if out == "bare" {
            assert_eq!(written.status.code(), Some(2));
            let told = text(&written.stderr);
            assert!(
                told.contains("does not state number, customer,") && told.contains("temperature_c: "),
                "{told}"
            );
            assert!(!folder.join("bare/certificate.html").exists());
            assert_eq!(
                spherecal(folder, &["certificate", out, "--draft"]).status.code(),
                Some(0)
            );
            "certificate-draft.html"
        } else {
            assert_eq!(written.status.code(), Some(0), "{}", text(&written.stderr));
            "certificate.html"
        };
        let page = certificate_of(&read(&folder.join(out).join(page)));
        same(certificate, &page, least);
        assert_eq!(certificate["simulated"], false);
        for unknown in ["plate", "seating"] {
            let terms = certificate["budget"].as_array().expect("a budget");
            let term = terms.iter().find(|t| t["source"] == unknown).expect(unknown);
            assert!(
                term["rms_mm"].is_null() && term["remark"].to_string().contains("no plate"),
                "{term}"
            );
        }
        assert!(certificate["repeatability"].is_null() && page.contains("no sphere was coupled twice"));
        // A cross-validation is no independent measurement.
        assert_eq!(certificate["position_errors"], json!([]));
        if out == "bare" {
            assert!(certificate["measured"].is_null() && certificate["next_calibration"].is_null());
            assert!(page.matches("not stated").count() > 12, "{page}");
            // Names that are stated after the measurement.
            let named = spherecal(folder, &["certificate", out, "--names", "cell.toml"]);
            assert_eq!(named.status.code(), Some(0), "{}", text(&named.stderr));
            assert!(read(&folder.join("bare/certificate.html")).contains("AT960 s/n 750312"));
        } else {
            assert_eq!(certificate["next_calibration"], "2027-02-28");
        }
        let mut refused = summary.clone();
        refused["certificate"]["may_be_used"] = json!(false);
        std::fs::write(&file, refused.to_string()).expect("written");
        let none = spherecal(folder, &["certificate", out, "--draft"]);
        assert_eq!(none.status.code(), Some(3), "{}", text(&none.stderr));
        assert!(text(&none.stderr).contains("must not be used"));
    }
    for (text_of, words) in [
        ("seed = 1\n", "has no block [certificate]"),
        (
            "[certificate]\ntemperature_c = 300\n",
            "certificate.temperature_c is 300",
        ),
        ("[certificate]\noperater = \"A\"\n", "operater"),
    ] {
        std::fs::write(folder.join("bad.toml"), text_of).expect("written");
        let output = spherecal(
            folder,
            &[&identify[..], &["none", "--certificate", "bad.toml"]].concat(),
        );
        assert_eq!(output.status.code(), Some(2), "{words}");
        assert!(text(&output.stderr).contains(words), "{}", text(&output.stderr));
    }
    assert!(!folder.join("none").exists());
}
