//! Tests that the page is complete, escapes what users write, and makes no network request.

use super::*;
use spherecal_campaign::telemetry::ContactTrace;

/// A report with something in every section, and with hostile names.
pub(super) fn full() -> ReportInput {
    let evil = "<script>alert(1)</script> & \"friends\"";
    let wave = |k: usize, a: f64| (k as f64 * a).sin();
    ReportInput {
        title: evil.to_owned(),
        subtitle: evil.to_owned(),
        headline: Headline {
            trusted: true,
            sentence: "The robot is 78 % more accurate.".to_owned(),
            reasons: vec![evil.to_owned()],
            next: "Load it.".to_owned(),
            figures: vec![(
                "Mean error".to_owned(),
                "0.152 mm".to_owned(),
                "nominally 1.4 mm".to_owned(),
            )],
        },
        error_tables: vec![ErrorTable {
            title: "Table 5".to_owned(),
            caption: evil.to_owned(),
            rows: ["nominal", "sphere", "laser", evil]
                .iter()
                .map(|n| ModelRow {
                    name: (*n).to_owned(),
                    mean_mm: 0.6,
                    std_mm: 0.2,
                    min_mm: 0.1,
                    max_mm: 0.9,
                })
                .collect(),
        }],
        errors: [("nominal", 1.4), ("sphere", 0.3), ("laser", 0.2), (evil, 0.5)]
            .iter()
            .map(|(n, m)| ErrorSeries {
                name: (*n).to_owned(),
                errors_mm: (0..125).map(|k| (m + 0.4 * m * wave(k, 1.7)).abs()).collect(),
            })
            .collect(),
        workspace: (0..125)
            .map(|k| WorkspacePoint {
                at_m: [0.5 + 0.4 * wave(k, 1.1), 0.5 * wave(k, 2.3), 0.6 + 0.4 * wave(k, 0.7)],
                nominal_mm: 1.4 + wave(k, 3.0),
                calibrated_mm: 0.2 + 0.1 * wave(k, 5.0),
            })
            .collect(),
        contacts: vec![ContactTrace {
            sphere: 1,
            samples: (0..800)
                .map(|k| {
                    (
                        f64::from(k) * 1e-3,
                        8.0 / (1.0 + (-(f64::from(k) - 600.0) / 20.0).exp()),
                    )
                })
                .collect(),
            trigger_s: 0.65,
        }],
        contact_threshold_n: 7.5,
        triggers: vec![Histogram {
            what: evil.to_owned(),
            of: evil.to_owned(),
            caption: evil.to_owned(),
            values: vec![20.0, 20.0, 23.0, f64::NAN],
        }],
        stillness: vec![Curves {
            what: evil.to_owned(),
            caption: evil.to_owned(),
            curves: vec![(
                evil.to_owned(),
                (0..30).map(|k| (f64::from(k), 0.1 * f64::from(k))).collect(),
            )],
            band: 1.0,
        }],
        stillness_tables: vec![SimpleTable::default()],
        parameters: (0..30)
            .map(|k| ParameterRow {
                name: format!("{evil}{k}"),
                unit: "mm".to_owned(),
                nominal: 400.0,
                estimate: 400.0 + 0.4 * wave(k, 2.0),
                sigma: 0.03,
                prior_sigma: 0.5,
                free: k % 5 != 0,
                identified: k % 3 != 0,
            })
            .collect(),
        identifiability: vec![evil.to_owned()],
        residuals: (0..150)
            .map(|k| ResidualPoint {
                group: format!("sphere {} {evil}", k / 50 + 1),
                distance_mm: 0.06 + 0.04 * wave(k, 9.0) + if k == 77 { 3.0 } else { 0.0 },
                outlier: k == 77,
            })
            .collect(),
        outliers: vec![(evil.to_owned(), evil.to_owned())],
        correlation: Some(Correlation {
            names: (0..20).map(|k| format!("alpha{k}{evil}")).collect(),
            values: (0..20)
                .map(|i| (0..20).map(|j| if i == j { 1.0 } else { wave(i * j, 1.3) }).collect())
                .collect(),
        }),
        prediction: Some(Prediction {
            mean_mm: 0.1,
            max_mm: 0.2,
            pairs_mm: (0..100)
                .map(|k| (0.1 + 0.03 * wave(k, 1.0), 0.15 + 0.1 * wave(k, 3.0)))
                .collect(),
            frame: evil.to_owned(),
        }),
        fit_tables: vec![SimpleTable {
            title: evil.to_owned(),
            caption: evil.to_owned(),
            columns: vec![evil.to_owned()],
            rows: vec![vec![evil.to_owned()]],
        }],
        health_tables: vec![SimpleTable::default()],
        notes: vec![evil.to_owned()],
        provenance: vec![(evil.to_owned(), evil.to_owned())],
    }
}

#[test]
fn everything_is_escaped_and_nothing_is_fetched() {
    let page = render(&full()).unwrap();
    assert!(!page.contains("<script"), "a script got through");
    for fetch in ["src=", "@import", "url(", "href=\"http", "<link"] {
        assert!(!page.contains(fetch), "{fetch}");
    }
    // Inline SVG and the page's own markup are well-formed, and every section is present.
    for id in [
        "accuracy",
        "workspace",
        "predicted",
        "parameters",
        "correlation",
        "residuals",
        "contacts",
        "stillness",
        "health",
        "provenance",
    ] {
        assert!(page.contains(&format!("<section id=\"{id}\"")), "{id}");
    }
    let start = page.find("<svg").unwrap();
    let end = page[start..].find("</svg>").unwrap() + start + 6;
    roxmltree::Document::parse(&page[start..end]).unwrap();
}

// Fails if a figure of errors does not say in which frame they are: errors with the base fitted
// to the points are smaller than those with the base as measured.
#[test]
fn every_figure_of_errors_names_its_frame() {
    let mut input = full();
    input.error_tables[0].caption = "Frames by arcs.".to_owned();
    if let Some(prediction) = &mut input.prediction {
        prediction.frame = "Base fitted.".to_owned();
    }
    let page = render(&input).unwrap();
    // The table, two histograms and the workspace.
    assert_eq!(page.matches("Frames by arcs.").count(), 4);
    assert_eq!(page.matches("Base fitted.").count(), 1);
}

// Fails if two models in one figure share a colour, if a model has one colour in the table and
// another in its figure, or if the page lacks a colour.
#[test]
fn every_model_has_a_colour_of_its_own() {
    let names = [
        "nominal",
        "sphere",
        "laser",
        "laser_full",
        "paper_nelder_mead",
        "known_laws",
        "calibrated_table_only",
        "another",
    ];
    let mut input = full();
    input.error_tables[0].rows = names
        .iter()
        .map(|name| ModelRow {
            name: (*name).to_owned(),
            ..input.error_tables[0].rows[0].clone()
        })
        .collect();
    input.errors = names
        .iter()
        .map(|name| ErrorSeries {
            name: (*name).to_owned(),
            errors_mm: vec![0.1, 0.2, 0.3],
        })
        .collect();
    let page = render(&input).unwrap();
    let style = include_str!("style.css");
    for (number, name) in names.iter().enumerate() {
        let own = charts::colour(name);
        let same = names.iter().filter(|other| charts::colour(other) == own).count();
        assert_eq!(same, 1, "{name}");
        let index = charts::SERIES.iter().position(|s| *s == own).unwrap();
        // Its dot in the table, and its curve.
        assert!(
            page.contains(&format!(
                "<span class=\"dot\" style=\"background:var(--series-{index})\">"
            )),
            "{number}"
        );
        assert!(page.contains(&format!("stroke:var(--series-{index})")), "{name}");
        // In the light, in the dark, and on paper.
        assert_eq!(style.matches(&format!("--series-{index}:#")).count(), 3, "{name}");
    }
}

/// Empty and degenerate input gives a page, not a panic.
#[test]
fn an_empty_report_is_a_page() {
    assert!(render(&ReportInput::default()).unwrap().contains("<main>"));
    let mut odd = full();
    odd.errors[0].errors_mm = vec![f64::NAN, 0.0];
    odd.errors[1].errors_mm = Vec::new();
    odd.workspace.truncate(2);
    odd.workspace[0].at_m = odd.workspace[1].at_m;
    odd.contacts[0].samples = Vec::new();
    odd.triggers[0].values = vec![7.0];
    odd.triggers.push(Histogram::default());
    odd.stillness[0].curves[0].1 = vec![(0.0, f64::NAN)];
    odd.stillness.push(Curves::default());
    odd.residuals.truncate(1);
    odd.prediction = Some(Prediction {
        pairs_mm: vec![(0.0, 0.0); 5],
        ..Prediction::default()
    });
    render(&odd).unwrap();
}
