//! The page, with its sections in the order of a reader's questions. The templates escape all text
//! from the user.

use maud::{Markup, PreEscaped, html};
use spherecal_model::ContactTrace;

use super::charts::{self, ChartError};
use super::headline::brief;
use super::input::{ErrorSeries, ParameterRow, ReportInput};
use super::parts::{
    Folds, document, error_table, file_table, outlier_table, parameter_table, provenance, simple_table, tables,
};
use super::{correlation_map, space, time_charts};

/// Remarks beside the answer, each by its first clause.
const SHOWN_REMARKS: usize = 3;
/// Outliers shown before the rest is folded away.
const SHOWN_OUTLIERS: usize = 5;

/// Renders the page.
///
/// # Errors
/// A figure could not be drawn.
pub fn render(input: &ReportInput) -> Result<String, ChartError> {
    let mut sections: Vec<(&str, &str, Markup)> = Vec::new();
    let mut add = |id: &'static str, title: &'static str, body: Option<Markup>| {
        if let Some(body) = body {
            sections.push((id, title, body));
        }
    };
    let mut figures = Figures(0);
    let mut folds = Folds::default();
    let answer = answer(input, &mut figures)?;
    add("remarks", "Remarks", remarks(input));
    add("stillness", "How still it holds", stillness(input, &mut figures)?);
    add("accuracy", "Accuracy", accuracy(input, &mut figures, &mut folds)?);
    add("predicted", "Predicted accuracy", predicted(input, &mut figures)?);
    add("parameters", "Parameters", parameters(input, &mut folds));
    add(
        "correlation",
        "Correlations",
        correlation(input, &mut figures, &mut folds)?,
    );
    add(
        "residuals",
        "Residuals and outliers",
        residuals(input, &mut figures, &mut folds)?,
    );
    add("contacts", "Contacts", contacts(input, &mut figures, &mut folds)?);
    add("health", "Faults and link", tables(&input.health_tables));
    add(
        "provenance",
        "Provenance",
        provenance(&input.provenance, &input.configuration, &mut folds),
    );
    let main = html! {
        header { h1 { (input.title) } p { (input.subtitle) } }
        (answer)
        nav { @for (id, title, _) in &sections { a href=(format!("#{id}")) { (title) } } }
        @for (id, title, body) in &sections {
            section id=(id) { h2 { (title) } (body) }
        }
        footer { "Written by spherecal " (env!("CARGO_PKG_VERSION")) ". This file is complete and makes no network request." }
    };
    Ok(document(&input.title, &input.title, &main))
}

struct Figures(usize);

impl Figures {
    fn figure(&mut self, svg: &str, caption: &Markup) -> Markup {
        self.0 += 1;
        html! {
            figure {
                div.scroll { (PreEscaped(svg)) }
                figcaption { b { "Figure " (self.0) ". " } (caption) }
            }
        }
    }
}

/// The answer: before, after, may it be used; the errors before and after as a picture; what to keep in mind; the files.
fn answer(input: &ReportInput, figures: &mut Figures) -> Result<Markup, ChartError> {
    let h = &input.headline;
    let picture = before_and_after(input, figures)?;
    let more = h.reasons.len().saturating_sub(SHOWN_REMARKS);
    Ok(html! {
        div class=(if h.trusted { "verdict" } else { "verdict no" }) {
            p.mark { (if h.trusted { "May be used" } else { "Not to be used" }) }
            p.say { (h.sentence) }
            @if !h.next.is_empty() { p.next { b { "Next: " } (h.next) } }
        }
        @if let Some(p) = picture { (p) }
        @if !h.reasons.is_empty() {
            ul.remarks {
                @for r in h.reasons.iter().take(SHOWN_REMARKS) { li { (brief(r)) } }
                @if more > 0 { li { a href="#remarks" { (more) " more" } } }
            }
        }
        (file_table(&h.files))
        @if !h.figures.is_empty() {
            dl.tiles {
                @for (label, value, remark) in &h.figures {
                    div { dt { (label) } dd { (value) small { (remark) } } }
                }
            }
        }
    })
}

/// The errors of the nominal and of the calibrated robot where they were measured, side by side, to one scale.
fn before_and_after(input: &ReportInput, figures: &mut Figures) -> Result<Option<Markup>, ChartError> {
    if input.workspace.len() < 2 {
        return Ok(None);
    }
    let [before, after] = space::panels(&input.workspace)?;
    let words = html! {
        "Position error at " (input.workspace.len()) " poses outside of the fit, each at its place, seen from the front right \
         and above. The radius of a dot is the error; both sides have one scale. " (frame_of_errors(input))
    };
    let pair = format!("<div class=\"pair\">{before}{after}</div>");
    Ok(Some(figures.figure(&pair, &words)))
}

/// In which frame the errors of the figures are: the first sentence of the first table's caption.
fn frame_of_errors(input: &ReportInput) -> &str {
    let caption = input.error_tables.first().map_or("", |t| t.caption.as_str());
    caption.find(". ").map_or(caption, |end| &caption[..=end])
}

fn accuracy(input: &ReportInput, figures: &mut Figures, folds: &mut Folds) -> Result<Option<Markup>, ChartError> {
    if input.error_tables.is_empty() && input.errors.is_empty() {
        return Ok(None);
    }
    // The picture beside the answer compares with the nominal robot; its errors would hide what the others differ in.
    let calibrated: Vec<&ErrorSeries> = input
        .errors
        .iter()
        .filter(|s| !s.errors_mm.is_empty() && s.name != "nominal")
        .collect();
    let mut drawn = None;
    if !calibrated.is_empty() {
        let svg = charts::histogram(
            &calibrated,
            "Histogram of position errors of the calibrated models",
            &input.errors_axis,
        )?;
        let words = html! { "Position errors of the calibrated models. " (frame_of_errors(input)) };
        drawn = Some(figures.figure(&svg, &words));
    }
    let (first, rest) = input.error_tables.split_at(input.error_tables.len().min(1));
    let tables = html! { div.two { @for t in rest { div { (error_table(t)) } } } };
    Ok(Some(html! {
        @if !input.comparison.is_empty() { p.lead { (input.comparison) } }
        @for t in first { (error_table(t)) }
        @if let Some(f) = drawn { (f) }
        @if !rest.is_empty() { (folds.fold("The same in other frames, or by groups", &tables)) }
    }))
}

fn predicted(input: &ReportInput, figures: &mut Figures) -> Result<Option<Markup>, ChartError> {
    let regions = input.regions.as_ref().map(simple_table);
    let Some(p) = &input.prediction else { return Ok(regions) };
    let mut figure = None;
    let inside = p.pairs_mm.iter().filter(|(s, e)| *e <= 2.0 * s).count();
    if p.pairs_mm.len() > 2 {
        let words = html! {
            "Each validation sample: the error that the fit's covariance predicts against the actual error. "
            (inside) " of " (p.pairs_mm.len()) " lie under the line of two sigma. " (p.frame)
        };
        figure = Some(figures.figure(&charts::prediction(p)?, &words));
    }
    Ok(Some(html! {
        @if let Some(t) = regions { (t) }
        p.lead {
            "From the covariance of all parameters, a predicted position is uncertain by "
            b { (format!("{:.3} mm", p.mean_mm)) } " (1 sigma, mean over the workspace), at worst "
            b { (format!("{:.3} mm", p.max_mm)) } ". This holds where the model is right; the expected error of the \
             verdict also holds what the model may leave out."
        }
        @if let Some(f) = figure { (f) }
    }))
}

fn parameters(input: &ReportInput, folds: &mut Folds) -> Option<Markup> {
    if input.parameters.is_empty() {
        return None;
    }
    let is_effect = |p: &&ParameterRow| {
        p.name.starts_with("harmonic") || p.name.starts_with("bending") || p.name.starts_with("tilt")
    };
    let main: Vec<&ParameterRow> = input.parameters.iter().filter(|p| !is_effect(p)).collect();
    let effects: Vec<&ParameterRow> = input.parameters.iter().filter(is_effect).collect();
    let (shown, folded): (Vec<_>, Vec<_>) = main.into_iter().partition(|p| p.identified);
    let identified = input.parameters.iter().filter(|p| p.identified).count();
    let free = input.parameters.iter().filter(|p| p.free).count();
    Some(html! {
        p.lead {
            (identified) " of " (free) " free parameters are determined by the data (their sigma is less than half of the prior sigma). "
            "Rows follow the modified DH table; the bar shows the shift with its 95 % interval."
        }
        @if !input.identifiability.is_empty() { ul { @for words in &input.identifiability { li { (words) } } } }
        (parameter_table(&shown))
        @if !folded.is_empty() {
            (folds.fold(&format!("{} parameters that the data leave open", folded.len()), &parameter_table(&folded)))
        }
        @if !effects.is_empty() {
            (folds.fold(&format!("Random effects: {} harmonics and bendings", effects.len()), &parameter_table(&effects)))
        }
    })
}

fn correlation(input: &ReportInput, figures: &mut Figures, folds: &mut Folds) -> Result<Option<Markup>, ChartError> {
    let Some(c) = input.correlation.as_ref().filter(|c| c.names.len() > 1) else {
        return Ok(None);
    };
    let mut strongest: Vec<(f64, &str, &str)> = Vec::new();
    for (i, row) in c.values.iter().enumerate() {
        for (j, &v) in row.iter().enumerate().take(i) {
            if v.abs() > 0.9
                && let (Some(a), Some(b)) = (c.names.get(i), c.names.get(j))
            {
                strongest.push((v, a, b));
            }
        }
    }
    strongest.sort_by(|a, b| b.0.abs().total_cmp(&a.0.abs()));
    let words = html! { "Correlation of the geometric parameters, from -1 (blue) to 1 (red), by the scale beside the map. The data determine a combination of a strongly correlated pair better than each of the two." };
    let figure = figures.figure(&correlation_map::correlation(c)?, &words);
    Ok(Some(html! {
        @if strongest.is_empty() {
            p.lead { "No two geometric parameters are correlated beyond 0.9." }
        } @else {
            p.lead {
                "Beyond 0.9: "
                @for (k, (v, a, b)) in strongest.iter().take(8).enumerate() {
                    @if k > 0 { ", " } (a) " and " (b) " (" (format!("{v:+.2}")) ")"
                }
                @if strongest.len() > 8 { ", and " (strongest.len() - 8) " more" } "."
            }
        }
        (folds.fold("The map of all correlations", &figure))
    }))
}

fn residuals(input: &ReportInput, figures: &mut Figures, folds: &mut Folds) -> Result<Option<Markup>, ChartError> {
    if input.residuals.is_empty() && input.outliers.is_empty() && input.fit_tables.is_empty() {
        return Ok(None);
    }
    let mut figure = None;
    if !input.residuals.is_empty() {
        let words = html! { "Distance of every recording from its target after calibration; outliers are ringed, and those beyond the frame are drawn at its upper edge." };
        figure = Some(figures.figure(&charts::residuals(&input.residuals)?, &words));
    }
    let (shown, folded) = input.outliers.split_at(input.outliers.len().min(SHOWN_OUTLIERS));
    Ok(Some(html! {
        @if let Some(f) = figure { (f) }
        @if !input.outliers.is_empty() {
            h3 { "Outliers" }
            (outlier_table(shown))
            @if !folded.is_empty() { (folds.fold(&format!("The other {}", folded.len()), &outlier_table(folded))) }
        } @else {
            p.lead { "No recording stands out." }
        }
        @let (fit, single) = input.fit_tables.split_at(input.fit_tables.len().min(1));
        @for t in fit { (simple_table(t)) }
        @for t in single { (folds.fold(&t.title, &simple_table(t))) }
    }))
}

fn contacts(input: &ReportInput, figures: &mut Figures, folds: &mut Folds) -> Result<Option<Markup>, ChartError> {
    if input.contacts.is_empty() && input.triggers.is_empty() {
        return Ok(None);
    }
    let mut drawn = Vec::new();
    for histogram in &input.triggers {
        // One bar says no more than its value in words.
        drawn.push(match time_charts::single_value(histogram) {
            Some(words) => html! { p.lead { (words) " " (histogram.caption) } },
            None => figures.figure(&time_charts::histogram(histogram)?, &html! { (histogram.caption) }),
        });
    }
    // The hardest contact is enlarged; the others are beside one another, to its scale.
    let peak = |trace: &ContactTrace| trace.samples.iter().map(|s| s.1).fold(0.0, f64::max);
    let hardest =
        (0..input.contacts.len()).max_by(|a, b| peak(&input.contacts[*a]).total_cmp(&peak(&input.contacts[*b])));
    if let Some(trace) = hardest.and_then(|k| input.contacts.get(k)) {
        let threshold = input.contact_threshold_n;
        let words = html! {
            "The hardest contact, on sphere " (trace.sphere) ": steady estimate of the force against the approach, at most " (format!("{:.2} N", peak(trace))) " in this time. "
            @if charts::crossing(trace, threshold).is_some() {
                "The dot is where it exceeds the threshold of " (format!("{threshold:.1} N")) " (dashed) for good; the line is the declaration of the contact."
            } @else {
                "The samples of the telemetry do not pass the threshold of " (format!("{threshold:.1} N")) " (dashed); the line is the declaration of the contact."
            }
        };
        drawn.push(figures.figure(&charts::force(trace, threshold, peak(trace), (760, 270))?, &words));
        let mut others = String::new();
        for (k, other) in input.contacts.iter().enumerate().filter(|(k, _)| Some(*k) != hardest) {
            let svg = charts::force(other, threshold, peak(trace), (300, 190))?;
            others += &format!("<div><span>{}. sphere {}</span>{svg}</div>", k + 1, other.sphere);
        }
        if !others.is_empty() {
            let words = html! { "The other contacts, in the order of the run, to the same scale of force." };
            let figure = figures.figure(&format!("<div class=\"small-multiples\">{others}</div>"), &words);
            drawn.push(folds.fold(&format!("The other {} contacts", input.contacts.len() - 1), &figure));
        }
    }
    Ok(Some(html! { @for f in &drawn { (f) } }))
}

fn stillness(input: &ReportInput, figures: &mut Figures) -> Result<Option<Markup>, ChartError> {
    if input.stillness.is_empty() && input.stillness_tables.is_empty() {
        return Ok(None);
    }
    let mut drawn = Vec::new();
    for curves in &input.stillness {
        drawn.push(figures.figure(&time_charts::curves(curves)?, &html! { (curves.caption) }));
    }
    Ok(Some(html! {
        @for t in &input.stillness_tables { (simple_table(t)) }
        @for f in &drawn { (f) }
    }))
}

/// All remarks in full: what the verdict says, then what else the user should know.
fn remarks(input: &ReportInput) -> Option<Markup> {
    let mut all: Vec<&String> = Vec::new();
    for words in input.headline.reasons.iter().chain(&input.notes) {
        if !all.contains(&words) {
            all.push(words);
        }
    }
    (!all.is_empty()).then(|| html! { ul { @for words in all { li { (words) } } } })
}
