//! Page one of the report: every figure, and what is not known.

use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Repeatability;

use super::tests::full;
use super::*;

/// A certificate with every field, and with hostile names.
pub(crate) fn certified(evil: &str) -> Certificate {
    let evil = || Some(evil.to_owned());
    let error = |mean: f64| {
        Some(ExpectedError {
            mean,
            p95: 1.9 * mean,
            interval: [0.8 * mean, 1.3 * mean],
        })
    };
    Certificate {
        simulated: true,
        number: evil(),
        laboratory: evil(),
        place: evil(),
        operator: evil(),
        robot: "iiwa7".to_owned(),
        serial: evil(),
        measured: Some("2026-11-23T10:00:00Z".to_owned()),
        temperature_c: Some(21.5),
        instrument: evil(),
        instrument_certificate: evil(),
        plate: evil(),
        plate_certificate: evil(),
        method: "contacts".to_owned(),
        estimator: "full, full model".to_owned(),
        program: "spherecal 0.1.0".to_owned(),
        commit: None,
        configuration_sha256: Some("c0".repeat(32)),
        recordings: 150,
        recordings_sha256: "d1".repeat(32),
        expected_error_mm: error(0.1234),
        geometry_alone_mm: error(0.3456),
        nominal_error_mm: error(1.2345),
        uncertainty: Some(Uncertainty {
            standard_mm: 0.1421,
            k: COVERAGE,
            expanded_mm: 0.2842,
            noise_by_data: false,
        }),
        budget: [
            ("plate", Some(0.0087)),
            ("seating", Some(0.0213)),
            ("encoder_noise", Some(0.0456)),
            ("open_parameters", None),
        ]
        .map(|(source, rms_mm)| BudgetLine {
            source: source.to_owned(),
            name: source.to_owned(),
            rms_mm,
            remark: "why".to_owned(),
        })
        .to_vec(),
        position_errors: vec![PositionError {
            by: "laser tracker, base measured by arcs".to_owned(),
            n: 125,
            mean_mm: 0.1789,
            max_mm: 0.4567,
            nominal_mean_mm: 1.3579,
        }],
        repeatability: Some(Repeatability {
            spheres: 3,
            couplings: 9,
            sigma_mm: 0.0321,
            iso_formula_mm: Some(0.0654),
        }),
        may_be_used: true,
        reasons: (0..5).map(|k| format!("reason {k}")).collect(),
        validity_months: Some(12),
        next_calibration: Some("2027-11-23".to_owned()),
    }
}

/// The certificate of a report.
fn certificate_of(page: &str) -> &str {
    let start = page
        .find("<section class=\"certificate\" id=\"certificate\"")
        .expect("a certificate");
    &page[start..start + page[start..].find("</section>").expect("its end")]
}

/// Every number of a document, with the path to it.
fn numbers(path: &str, value: &serde_json::Value, out: &mut Vec<(String, f64)>) {
    match value {
        serde_json::Value::Number(n) => out.push((path.to_owned(), n.as_f64().unwrap())),
        serde_json::Value::Array(list) => list
            .iter()
            .enumerate()
            .for_each(|(k, v)| numbers(&format!("{path}.{k}"), v, out)),
        serde_json::Value::Object(map) => map.iter().for_each(|(k, v)| numbers(&format!("{path}.{k}"), v, out)),
        _ => {}
    }
}

// Fails if a figure for programs is missing on the certificate, if it is not the last page of the
// report, or if a simulated run is not marked.
#[test]
fn it_has_every_figure_that_programs_get() {
    let mut input = full();
    let certificate = certified("A. Miller");
    input.certificate = Some(certificate.clone());
    let page = render(&input).unwrap();
    // The answer comes first, the certificate is the last page.
    assert!(page.find("<header>") < page.find("<section id="));
    assert!(page.rfind("<section id=") < page.find("<section class=\"certificate\""));
    let page = certificate_of(&page);
    let mut found = Vec::new();
    numbers("certificate", &serde_json::to_value(&certificate).unwrap(), &mut found);
    assert!(found.len() > 25, "{}", found.len());
    for (path, value) in found {
        let shown = if value.fract() == 0.0 || path.ends_with("temperature_c") {
            format!("{value}")
        } else {
            millimetres(value)
        };
        assert!(page.contains(&shown), "{path}: {shown} in {page}");
    }
    for words in [
        "SIMULATED",
        "certifies no robot",
        "2027-11-23",
        "2026-11-23T10:00:00Z",
        "and 3 more in the report",
    ] {
        assert!(page.contains(words), "{words}");
    }
    assert_eq!(page.matches("A. Miller").count(), 9);
}

// Fails if the certificate invents what nobody stated, or gives a date for the next calibration of a
// result that may not be used.
#[test]
fn what_is_not_known_is_not_stated() {
    let mut input = full();
    input.certificate = Some(Certificate {
        robot: "ur5e".to_owned(),
        operator: Some("  ".to_owned()),
        validity_months: Some(12),
        ..Certificate::default()
    });
    let page = render(&input).unwrap();
    let page = certificate_of(&page);
    // Ten names and numbers, date, temperature, commit, both hashes.
    assert!(page.matches(">not stated<").count() >= 18, "{page}");
    assert!(!page.contains("SIMULATED"));
    assert!(page.contains("none: the result may not be used") && page.contains("Not to be used"));
    assert!(!render(&ReportInput::default()).unwrap().contains("id=\"certificate\""));
}
