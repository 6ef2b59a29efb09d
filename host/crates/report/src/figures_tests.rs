//! Figures against their tables: each test reads the SVG as a reader does, by the numbers at its axes.

use roxmltree::{Document, Node};

use super::tests::full;
use super::*;
use spherecal_model::ContactTrace;

fn number(node: Node<'_, '_>, name: &str) -> f64 {
    let text = node.attribute(name).unwrap_or_else(|| panic!("{name} of {node:?}"));
    text.parse().unwrap_or_else(|_| panic!("{name}: {text}"))
}

fn colour(node: Node<'_, '_>) -> String {
    let style = node.attribute("style").unwrap_or_default();
    style
        .split("var(--")
        .nth(1)
        .unwrap_or_default()
        .trim_end_matches(')')
        .to_owned()
}

/// A line that maps pixels to values, through the outermost two of the numbers at an axis.
fn axis(numbers: &[(f64, f64)]) -> impl Fn(f64) -> f64 + use<> {
    let least = numbers.iter().copied().min_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    let most = numbers.iter().copied().max_by(|a, b| a.0.total_cmp(&b.0)).unwrap();
    assert!(most.0 - least.0 > 50.0, "{numbers:?}");
    move |pixel| least.1 + (most.1 - least.1) * (pixel - least.0) / (most.0 - least.0)
}

/// The axes of a chart: from pixels to values, right and up.
fn axes(svg: &Document<'_>) -> (impl Fn(f64) -> f64 + use<>, impl Fn(f64) -> f64 + use<>) {
    let labels: Vec<(f64, f64, f64)> = svg
        .descendants()
        .filter(|n| n.has_tag_name("text"))
        .filter_map(|n| Some((number(n, "x"), number(n, "y"), n.text()?.trim().parse().ok()?)))
        .collect();
    // Numbers below the axis have the same height, those beside it the same right edge.
    let bottom = labels.iter().map(|l| l.1).fold(0.0, f64::max);
    let left = labels.iter().map(|l| l.0).fold(f64::INFINITY, f64::min);
    let x: Vec<_> = labels.iter().filter(|l| l.1 == bottom).map(|l| (l.0, l.2)).collect();
    // `plotters` sets a number's middle at its mark by a shift of its own in em, which is the same for all.
    let y: Vec<_> = labels.iter().filter(|l| l.0 == left).map(|l| (l.1, l.2)).collect();
    (axis(&x), axis(&y))
}

fn elements<'a>(svg: &'a Document<'a>, tag: &'a str) -> impl Iterator<Item = Node<'a, 'a>> {
    svg.descendants().filter(move |n| n.has_tag_name(tag))
}

/// The first SVG of a page with this label.
fn figure<'a>(page: &'a str, label: &str) -> &'a str {
    let at = page
        .find(&format!("aria-label=\"{label}\""))
        .unwrap_or_else(|| panic!("{label}"));
    let start = page[..at].rfind("<svg").unwrap();
    &page[start..start + page[start..].find("</svg>").unwrap() + 6]
}

// Fails if a dot of the picture beside the answer has another radius than its error by the scale below it, if a pose is
// missing, or if the two halves have different scales.
#[test]
fn dots_are_the_errors_of_their_poses() {
    let mut input = full();
    for (k, p) in input.workspace.iter_mut().enumerate() {
        p.nominal_mm = 0.5 + 0.02 * k as f64;
        p.calibrated_mm = 0.1 + 0.01 * k as f64;
    }
    let page = render(&input).unwrap();
    let mut scales = Vec::new();
    for (label, series, of) in [
        (
            "before: nominal",
            "series-0",
            (|p| p.nominal_mm) as fn(&WorkspacePoint) -> f64,
        ),
        ("after: calibrated", "series-1", |p| p.calibrated_mm),
    ] {
        let svg = figure(&page, &format!("Position errors, {label}"));
        let svg = Document::parse(svg).unwrap();
        let mut drawn: Vec<f64> = elements(&svg, "circle")
            .filter(|c| colour(*c) == series)
            .map(|c| number(c, "r"))
            .collect();
        let scale: Vec<f64> = elements(&svg, "circle")
            .filter(|c| colour(*c) == "soft")
            .map(|c| number(c, "r"))
            .collect();
        let words: Vec<f64> = elements(&svg, "text")
            .filter_map(|t| t.text()?.trim().strip_suffix(" mm")?.parse().ok())
            .collect();
        assert_eq!((drawn.len(), scale.len(), words.len()), (125, 3, 3));
        let per_pixel = words[2] / scale[2];
        let mut errors: Vec<f64> = input.workspace.iter().map(of).collect();
        drawn.sort_by(f64::total_cmp);
        errors.sort_by(f64::total_cmp);
        for (r, error) in drawn.iter().zip(&errors) {
            // Pixels are whole, and no dot is smaller than two.
            assert!(
                (r - (error / per_pixel).max(2.0)).abs() <= 0.51,
                "{label}: {r} px of {error} mm"
            );
        }
        scales.push((scale, words));
    }
    assert_eq!(scales[0], scales[1]);
}

// Fails if the bars of a histogram do not hold all values of a model, or if their mean is not that of the model's row in the
// table.
#[test]
fn bars_are_the_rows_of_the_table() {
    let mut input = full();
    input.errors.truncate(3);
    input.error_tables[0].rows.truncate(3);
    for (row, series) in input.error_tables[0].rows.iter_mut().zip(&input.errors) {
        row.mean_mm = series.errors_mm.iter().sum::<f64>() / series.errors_mm.len() as f64;
    }
    let page = render(&input).unwrap();
    let svg = Document::parse(figure(&page, "Histogram of position errors of the calibrated models")).unwrap();
    let (x, y) = axes(&svg);
    for (index, row) in input.error_tables[0].rows.iter().enumerate().skip(1) {
        assert!(page.contains(&format!("<td>{:.3}</td>", row.mean_mm)));
        let bars: Vec<(f64, f64)> = elements(&svg, "rect")
            .filter(|r| colour(*r) == format!("series-{index}") && r.attribute("opacity") != Some("1"))
            .map(|r| {
                let (left, width) = (number(r, "x"), number(r, "width"));
                let (top, height) = (number(r, "y"), number(r, "height"));
                (x(left + width / 2.0), y(top) - y(top + height))
            })
            .collect();
        let count: f64 = bars.iter().map(|b| b.1).sum();
        let mean = bars.iter().map(|b| b.0 * b.1).sum::<f64>() / count;
        assert!((count - 125.0).abs() < 2.5, "{}: {count}", row.name);
        assert!(
            (mean / row.mean_mm - 1.0).abs() < 0.1,
            "{}: {mean}, {}",
            row.name,
            row.mean_mm
        );
    }
}

// Fails if a residual is drawn elsewhere than at its recording and distance, if an outlier is not ringed where it is drawn, or
// if the figure has another number of rings than the table has rows.
#[test]
fn residuals_stand_at_their_recordings() {
    let mut input = full();
    input.outliers.clear();
    for (k, point) in input.residuals.iter_mut().enumerate() {
        point.distance_mm = 0.05 + 0.001 * k as f64;
        point.outlier = k % 50 == 7;
        if point.outlier {
            input.outliers.push((format!("row {k}"), "far".to_owned()));
        }
    }
    let page = render(&input).unwrap();
    let svg = Document::parse(figure(&page, "Residual of every recording, by sphere")).unwrap();
    let (x, y) = axes(&svg);
    let places = |ring: bool| -> Vec<(f64, f64)> {
        let radius = if ring { 7.0 } else { 3.0 };
        elements(&svg, "circle")
            .filter(|c| number(*c, "r") == radius)
            .map(|c| (x(number(c, "cx")), y(number(c, "cy"))))
            .collect()
    };
    let (dots, rings) = (places(false), places(true));
    assert_eq!((dots.len(), rings.len()), (input.residuals.len(), input.outliers.len()));
    for (k, point) in input.residuals.iter().enumerate() {
        let near = |(a, b): &&(f64, f64)| (a - k as f64 - 0.5).abs() < 0.3 && (b - point.distance_mm).abs() < 0.004;
        assert!(dots.iter().any(|p| near(&p)), "recording {k}");
        assert_eq!(rings.iter().any(|p| near(&p)), point.outlier, "recording {k}");
    }
}

// Fails if the line of one sigma is not where both errors are equal, if a pair is drawn elsewhere, or if another number lies
// under the line of two sigma than the words say.
#[test]
fn predictions_stand_under_their_lines() {
    let input = full();
    let page = render(&input).unwrap();
    let svg = Document::parse(figure(&page, "Predicted and actual error of every validation sample")).unwrap();
    let (x, y) = axes(&svg);
    let pairs = &input.prediction.as_ref().unwrap().pairs_mm;
    let dots: Vec<(f64, f64)> = elements(&svg, "circle")
        .filter(|c| colour(*c) == "series-1")
        .map(|c| (x(number(c, "cx")), y(number(c, "cy"))))
        .collect();
    assert_eq!(dots.len(), pairs.len());
    for (drawn, pair) in dots.iter().zip(pairs) {
        assert!(
            (drawn.0 - pair.0).abs() < 0.001 && (drawn.1 - pair.1).abs() < 0.003,
            "{drawn:?} {pair:?}"
        );
    }
    let slopes: Vec<f64> = elements(&svg, "polyline")
        .filter(|l| colour(*l) == "soft" && l.attribute("stroke-width") == Some("2"))
        .filter_map(|l| {
            let end = l.attribute("points")?.split_whitespace().last()?;
            let (right, up) = end.split_once(',')?;
            Some(y(up.parse().ok()?) / x(right.parse().ok()?))
        })
        .collect();
    assert!(slopes.iter().any(|s| (s - 1.0).abs() < 0.05), "{slopes:?}");
    assert!(slopes.iter().any(|s| (s - 2.0).abs() < 0.1), "{slopes:?}");
    // Pixels are whole: a dot on the line may be drawn on either side.
    let under = |room: f64| dots.iter().filter(|d| d.1 <= 2.0 * d.0 + room).count();
    let said = |n| page.contains(&format!("{n} of {} lie under", pairs.len()));
    assert!((under(-0.003)..=under(0.003)).any(said), "{}", under(0.0));
}

// Fails if the enlarged contact is not the hardest, if its curve rises to another force than its caption says, or if the dot
// is not on the threshold.
#[test]
fn the_hardest_contact_rises_to_what_is_said() {
    let mut input = full();
    let harder = ContactTrace {
        sphere: 3,
        samples: input.contacts[0].samples.iter().map(|s| (s.0, 1.4 * s.1)).collect(),
        ..input.contacts[0].clone()
    };
    input.contacts.push(harder);
    let page = render(&input).unwrap();
    assert!(page.contains("on sphere 3: steady estimate of the force against the approach, at most 11.20 N"));
    let svg = Document::parse(figure(&page, "Force trace, sphere 3")).unwrap();
    let (_, y) = axes(&svg);
    let curve = elements(&svg, "polyline").find(|l| colour(*l) == "series-1").unwrap();
    let top = curve
        .attribute("points")
        .unwrap()
        .split_whitespace()
        .filter_map(|p| p.split_once(',')?.1.parse().ok())
        .map(y)
        .fold(0.0, f64::max);
    assert!((top - 11.2).abs() < 0.1, "{top}");
    let (_, y) = axes(&svg);
    let dot = elements(&svg, "circle").find(|c| colour(*c) == "alarm").unwrap();
    assert!((y(number(dot, "cy")) - 7.5).abs() < 0.1);
}
