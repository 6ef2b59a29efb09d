//! Tests that the page is complete, escapes what users write, and makes no network request.

use super::*;
use spherecal_identify::evaluate::model_title;
use spherecal_model::ContactTrace;

/// A report with something in every section, and with hostile names.
pub(crate) fn full() -> ReportInput {
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
            files: vec![FileError {
                name: evil.to_owned(),
                holds: evil.to_owned(),
                expected_mm: None,
            }],
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
        errors_axis: evil.to_owned(),
        comparison: evil.to_owned(),
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
        triggers: vec![HistogramChart {
            what: evil.to_owned(),
            of: evil.to_owned(),
            caption: evil.to_owned(),
            values: vec![20.0, 20.0, 23.0, f64::NAN],
            step: 1.0,
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
        regions: Some(SimpleTable::default()),
        prediction: Some(PredictedAccuracy {
            mean_mm: 0.1,
            max_mm: 0.2,
            pairs_mm: (0..100)
                .map(|k| (0.1 + 0.03 * wave(k, 1.0), 0.15 + 0.1 * wave(k, 3.0)))
                .collect(),
            frame: evil.to_owned(),
            axis: evil.to_owned(),
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
        configuration: vec![evil.to_owned()],
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
        "remarks",
        "accuracy",
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
    // The picture beside the answer, the table, and the histogram.
    assert_eq!(page.matches("Frames by arcs.").count(), 3);
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
        // Its dot in the table, and its curve; the nominal robot has the first half of the picture beside the answer.
        assert!(
            page.contains(&format!(
                "<span class=\"dot\" style=\"background:var(--series-{index})\">"
            )),
            "{number}"
        );
        let drawn = if *name == "nominal" { "fill" } else { "stroke" };
        assert!(page.contains(&format!("{drawn}:var(--series-{index})")), "{name}");
        // One name per model: that of the terminal, in the table and in the legends.
        let shown = model_title(name).split('\'').next().unwrap();
        assert!(page.matches(shown).count() >= 2, "{name}: {shown}");
        // In the light, in the dark, and on paper.
        assert_eq!(style.matches(&format!("--series-{index}:#")).count(), 3, "{name}");
    }
}

// Fails if the dot of the trigger is elsewhere than on the threshold, where the force passes it
// for good before the declaration.
#[test]
fn the_dot_stands_where_the_force_passes_the_threshold() {
    let mut trace = ContactTrace {
        sphere: 1,
        // An early crossing, a fall, and 1 N a sample of 10 ms from 0 at 0.1 s.
        samples: vec![(0.0, 2.0), (0.01, 9.0), (0.02, 1.0)],
        trigger_s: 0.2,
    };
    trace
        .samples
        .extend((0..20).map(|k| (0.1 + 0.01 * f64::from(k), f64::from(k))));
    let at = charts::crossing(&trace, 7.5).unwrap();
    assert!((at - 0.175).abs() < 1e-12, "{at}");
    // Slow telemetry: the sample that shows it comes after the declaration.
    trace.trigger_s = 0.175;
    assert!((charts::crossing(&trace, 7.5).unwrap() - 0.175).abs() < 1e-12);
    trace.trigger_s = 0.15;
    assert!((charts::crossing(&trace, 7.5).unwrap() - 0.0079 + 0.0).abs() < 0.0001);
    assert_eq!(charts::crossing(&trace, 50.0), None);
    assert_eq!(charts::crossing(&ContactTrace::default(), 7.5), None);
}

// Fails if values that are all the same are drawn as one bar, or if values that differ are not
// drawn.
#[test]
fn one_bar_is_said_in_words() {
    let mut histogram = HistogramChart {
        what: "latency (control periods)".to_owned(),
        of: "contacts".to_owned(),
        values: vec![20.0; 7],
        step: 1.0,
        ..HistogramChart::default()
    };
    let words = time_charts::single_value(&histogram);
    assert_eq!(
        words.as_deref(),
        Some("Latency (control periods): 20 in all 7 contacts.")
    );
    let mut input = full();
    input.triggers = vec![histogram.clone()];
    let page = render(&input).unwrap();
    assert!(page.contains("20 in all 7 contacts."));
    histogram.values.push(23.0);
    assert_eq!(time_charts::single_value(&histogram), None);
    // Counted values stand about their number: no bar is narrower than a step.
    let drawn = time_charts::histogram(&histogram).unwrap();
    assert!(drawn.contains("\n20\n") && !drawn.contains("\n20."), "{drawn}");
}

// Fails if a scale of colours or dots is without its values and unit, or if a figure with the base
// fitted to the points does not say so on its axis.
#[test]
fn scales_have_units_and_axes_their_frame() {
    let mut input = full();
    input.errors_axis = "base by arcs".to_owned();
    if let Some(prediction) = &mut input.prediction {
        prediction.axis = "base fitted to the points".to_owned();
    }
    let page = render(&input).unwrap();
    assert_eq!(page.matches("position error, base by arcs (mm)").count(), 1);
    assert_eq!(page.matches("found error, base fitted to the points (mm)").count(), 1);
    let figure = |label: &str| {
        let start = page.find(label).unwrap_or_else(|| panic!("{label}"));
        &page[start..start + page[start..].find("</svg>").unwrap()]
    };
    let map = figure("aria-label=\"Correlation of the parameters\"");
    for value in ["\n1\n", "\n0\n", "\n-1\n", "\ncorrelation\n"] {
        assert!(map.contains(value), "{value:?}");
    }
    for panel in ["before: nominal", "after: calibrated"] {
        let dots = figure(&format!("aria-label=\"Position errors, {panel}\""));
        assert!(dots.contains("error:") && dots.matches(" mm\n").count() == 3);
    }
}

// Fails if a folded part is a `details`, which browsers print closed even where the reader opened it, if paper has what the
// screen folds away, or if a parameter that the data leave open stands among those that they determine.
#[test]
fn paper_has_what_is_open_on_the_screen() {
    let mut input = full();
    let row = input.parameters[0].clone();
    input.parameters = (0..60)
        .map(|k| ParameterRow {
            name: format!("theta{k}"),
            identified: k % 5 != 0,
            ..row.clone()
        })
        .collect();
    let page = render(&input).unwrap();
    assert!(!page.contains("<details"));
    let fold = page.find("12 parameters that the data leave open").unwrap();
    assert!(page.find("theta1<").unwrap() < fold && page.find("theta5<").unwrap() > fold);
    let style = include_str!("style.css");
    let (screen, print) = style.split_once("@media print").unwrap();
    assert!(screen.contains("\n.fold>input:not(:checked)~.folded{display:none}"));
    assert!(print.contains(".fold>input:not(:checked)~label{display:none}"));
}

// Fails if the first screen has another order than answer, picture, remarks, files, if it has more than three remarks or a
// remark in full, or if a remark is lost.
#[test]
fn the_first_screen_answers() {
    let mut input = full();
    input.headline.reasons = (0..5)
        .map(|k| format!("sphere {k} is 0.3 mm off its place (x: 0.1), p = 1e-9; measure it again"))
        .collect();
    let page = render(&input).unwrap();
    let mut rest = page.as_str();
    for part in [
        "May be used",
        "The robot is 78 % more accurate.",
        "Position errors, before: nominal",
        "Position errors, after: calibrated",
        "<li>Sphere 0 is 0.3 mm off its place</li>",
        "<li>Sphere 2 is 0.3 mm off its place</li>",
        "2 more",
        "what it holds",
        "<nav>",
    ] {
        rest = rest.split_once(part).unwrap_or_else(|| panic!("{part}")).1;
    }
    assert!(!page.contains("<li>Sphere 3"));
    assert_eq!(rest.matches("; measure it again</li>").count(), 5);
}

// Fails if a text at the foot of a page can end its style, or loses a character.
#[test]
fn the_foot_of_a_page_is_escaped() {
    let style = parts::margin_text("a\"}</style> 7");
    assert_eq!(
        style,
        "@page{@bottom-left{content:\"a\\000022 \\00007d \\00003c \\00002f style\\00003e  7\"}}"
    );
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
    odd.triggers.push(HistogramChart::default());
    odd.stillness[0].curves[0].1 = vec![(0.0, f64::NAN)];
    odd.stillness.push(Curves::default());
    odd.residuals.truncate(1);
    odd.prediction = Some(PredictedAccuracy {
        pairs_mm: vec![(0.0, 0.0); 5],
        ..PredictedAccuracy::default()
    });
    render(&odd).unwrap();
}
