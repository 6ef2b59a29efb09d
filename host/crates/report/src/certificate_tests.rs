//! The certificate: every figure, and what is not known.

use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Repeatability;

use super::*;

/// A certificate with every field, and with hostile names.
fn certified(evil: &str) -> Certificate {
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
        contacts: true,
        number: evil(),
        customer: evil(),
        customer_address: evil(),
        laboratory: evil(),
        laboratory_address: evil(),
        place: evil(),
        operator: evil(),
        authorised_by: evil(),
        robot: "iiwa7".to_owned(),
        serial: evil(),
        measured: Some("2026-11-23T10:00:00Z".to_owned()),
        temperature_c: Some(21.5),
        conditions: evil(),
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
        conformity: Some(Conformity {
            asked_mm: 0.4321,
            rule: "The rule.".to_owned(),
            conforms: true,
            words: "it is below".to_owned(),
        }),
        may_be_used: true,
        reasons: (0..5).map(|k| format!("reason {k}")).collect(),
        validity_months: Some(12),
        next_calibration: Some("2027-11-23".to_owned()),
    }
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

// Fails if a figure or a name for programs is missing on the certificate, if markup gets through, if a simulated arm or a
// draft is not marked, or if a page lacks its number.
#[test]
fn it_has_every_figure_that_programs_get() {
    let certificate = certified("A. <Miller>");
    let page = certificate.document("2026-11-28", false);
    let mut found = Vec::new();
    numbers("certificate", &serde_json::to_value(&certificate).unwrap(), &mut found);
    assert!(found.len() > 26, "{}", found.len());
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
        "2026-11-28",
        "And 1 more.",
        "The robot conforms.",
        "@bottom-left{content:\"No\\00002e  A\\00002e  \\00003c Miller",
        "counter(page) \" of \" counter(pages)",
    ] {
        assert!(page.contains(words), "{words} in {page}");
    }
    // Fourteen names, and the number in the title.
    assert_eq!(page.matches("A. &lt;Miller&gt;").count(), 15);
    assert!(!page.contains("DRAFT") && !page.contains("<Miller"));
    assert!(
        certificate
            .document("2026-11-28", true)
            .contains("This page is no certificate.")
    );
    // What a program reads is what was written.
    let read: Certificate = serde_json::from_str(&serde_json::to_string(&certificate).unwrap()).unwrap();
    assert_eq!(read, certificate);
}

// Fails if the certificate invents what nobody stated, or if a name that ISO/IEC 17025 asks for is not asked for: of the
// plate, where contacts carry the metre, else of the instrument.
#[test]
fn what_is_not_known_is_not_stated() {
    let bare = Certificate {
        robot: "ur5e".to_owned(),
        operator: Some("  ".to_owned()),
        ..Certificate::default()
    };
    let page = bare.document("2026-11-28", true);
    // Number, nine facts, temperature, instrument and its certificate, signature, hashes; and the figures.
    assert!(page.matches(">not stated<").count() >= 16, "{page}");
    assert!(!page.contains("SIMULATED") && !page.contains("Next calibration") && !page.contains("Conformity"));
    let names = [
        "number",
        "customer",
        "customer_address",
        "laboratory",
        "laboratory_address",
        "place",
        "operator",
        "authorised_by",
        "serial",
        "measured_on",
        "instrument",
        "instrument_certificate",
        "temperature_c",
    ];
    assert_eq!(bare.missing(), names);
    let contacts = Certificate { contacts: true, ..bare };
    assert!(contacts.missing().contains(&"plate_certificate") && !contacts.missing().contains(&"instrument"));
    assert_eq!(certified("A. Miller").missing(), [""; 0]);
}
