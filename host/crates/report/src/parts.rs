//! Small parts of the page: tables, folds, lists of facts.

use maud::{DOCTYPE, Markup, PreEscaped, html};
use spherecal_identify::evaluate::model_title;

use super::charts;
use super::input::{ErrorTable, FileError, ParameterRow, SimpleTable};

/// A whole page that needs nothing else: `foot` stands in the margin of each sheet of paper.
pub(crate) fn document(title: &str, foot: &str, main: &Markup) -> String {
    let page = html! {
        (DOCTYPE)
        html lang="en" {
            head {
                meta charset="utf-8";
                meta name="viewport" content="width=device-width, initial-scale=1";
                meta name="generator" content=(concat!("spherecal ", env!("CARGO_PKG_VERSION")));
                title { (title) }
                style { (PreEscaped(include_str!("style.css"))) (PreEscaped(margin_text(foot))) }
            }
            body { main { (main) } }
        }
    };
    page.into_string()
}

/// Numbers the folded parts: each has a name of its own on the page.
#[derive(Default)]
pub(super) struct Folds(usize);

impl Folds {
    /// A part that is folded away until the reader opens it; paper has what is open on the screen. It is no `details`: the
    /// page has no script, and its print style could not open one.
    pub(super) fn fold(&mut self, words: &str, body: &Markup) -> Markup {
        self.0 += 1;
        let id = format!("fold-{}", self.0);
        html! {
            div.fold {
                input type="checkbox" id=(id);
                label for=(id) { (words) }
                div.folded { (body) }
            }
        }
    }
}

fn swatch(name: &str) -> Markup {
    let c = charts::colour(name);
    let index = charts::SERIES.iter().position(|s| *s == c).unwrap_or(0);
    html! { span.dot style=(format!("background:var(--series-{index})")) {} }
}

pub(super) fn error_table(table: &ErrorTable) -> Markup {
    let best = table.rows.iter().map(|r| r.mean_mm).fold(f64::INFINITY, f64::min);
    html! {
        h3 { (table.title) }
        @if !table.caption.is_empty() { p.lead { (table.caption) } }
        div.scroll { table {
            thead { tr { th { "model" } th { "mean" } th { "std" } th { "min" } th { "max (mm)" } } }
            tbody {
                @for r in &table.rows {
                    tr class=(if r.mean_mm <= best { "best" } else { "" }) {
                        td { (swatch(&r.name)) (model_title(&r.name)) }
                        @for v in [r.mean_mm, r.std_mm, r.min_mm, r.max_mm] { td { (format!("{v:.3}")) } }
                    }
                }
            }
        } }
    }
}

pub(super) fn file_table(files: &[FileError]) -> Markup {
    html! { @if !files.is_empty() {
        div.scroll { table.files {
            thead { tr { th { "file" } th.words { "what it holds" } th { "expected error, work region (mm)" } th { "95 % interval" } } }
            tbody { @for f in files {
                tr {
                    td { (f.name) } td.words { (f.holds) }
                    td { @match &f.expected_mm { Some(e) => b { (format!("{:.3}", e.mean)) }, None => "none" } }
                    td { @if let Some(e) = &f.expected_mm { (format!("{:.3} to {:.3}", e.interval[0], e.interval[1])) } }
                }
            } }
        } }
    } }
}

/// The style of the margins of paper: `text` at the foot of each page, beside the page's number.
pub(super) fn margin_text(text: &str) -> String {
    let escaped: String = text
        .chars()
        .map(|c| {
            // As a number, no character can end the string, the style or the page; the space ends the number.
            if c.is_alphanumeric() || c == ' ' {
                c.to_string()
            } else {
                format!("\\{:06x} ", u32::from(c))
            }
        })
        .collect();
    format!("@page{{@bottom-left{{content:\"{escaped}\"}}}}")
}

pub(super) fn simple_table(t: &SimpleTable) -> Markup {
    html! {
        h3 { (t.title) }
        @if !t.caption.is_empty() { p.lead { (t.caption) } }
        div.scroll { table {
            thead { tr { @for c in &t.columns { th { (c) } } } }
            tbody { @for row in &t.rows { tr { @for cell in row { td { (cell) } } } } }
        } }
    }
}

pub(super) fn tables(tables: &[SimpleTable]) -> Option<Markup> {
    (!tables.is_empty()).then(|| html! { @for t in tables { (simple_table(t)) } })
}

/// Recordings with the reason why each is named.
pub(super) fn outlier_table(rows: &[(String, String)]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr { th { "recording" } th { "why" } } }
            tbody { @for (which, why) in rows { tr { td { (which) } td.words { (why) } } } }
        } }
    }
}

pub(super) fn provenance(facts: &[(String, String)], configuration: &[String], folds: &mut Folds) -> Option<Markup> {
    if facts.is_empty() {
        return None;
    }
    let whole = html! { pre { @for line in configuration { (line) "\n" } } };
    Some(html! {
        dl.facts { @for (name, value) in facts { dt { (name) } dd { (value) } } }
        @if !configuration.is_empty() { (folds.fold("The whole configuration", &whole)) }
    })
}

/// A number with as many digits as its uncertainty justifies.
fn number(value: f64, sigma: f64) -> String {
    if value != 0.0 && value.abs() < 1e-3 && sigma < 1e-3 {
        return format!("{value:.2e}");
    }
    let digits = if sigma > 0.0 {
        (2.0 - sigma.log10().floor()).clamp(1.0, 7.0) as usize
    } else {
        4
    };
    format!("{value:.digits$}")
}

fn parameter_row(p: &ParameterRow) -> Markup {
    let shift = p.estimate - p.nominal;
    let percent = |v: f64| (50.0 + 50.0 * v / (3.0 * p.prior_sigma)).clamp(0.0, 100.0);
    let drawn = p.free && p.prior_sigma > 0.0 && p.prior_sigma < 1.0;
    let status = match (p.free, p.identified) {
        (false, _) => "held fixed",
        (true, true) => "identified",
        (true, false) => "from the prior",
    };
    html! {
        tr class=(if p.free { "" } else { "dim" }) {
            td { (p.name) }
            td { (number(p.nominal, p.sigma)) }
            td { (number(p.estimate, p.sigma)) }
            td { @if p.free { (number(shift, p.sigma)) } }
            td { @if p.free { (format!("{:.2e}", p.sigma)) } }
            td { (p.unit) }
            td { @if drawn {
                @let (low, high) = (percent(shift - 2.0 * p.sigma), percent(shift + 2.0 * p.sigma));
                span.bar title="shift from nominal and its 95 % interval, over ±3 prior sigma" {
                    i style=(format!("left:{low:.1}%;width:{:.1}%", (high - low).max(1.0))) {}
                    u {} b style=(format!("left:calc({:.1}% - 1px)", percent(shift))) {}
                }
            } }
            td { span class=(if p.identified { "tag yes" } else { "tag" }) { (status) } }
        }
    }
}

pub(super) fn parameter_table(rows: &[&ParameterRow]) -> Markup {
    html! {
        div.scroll { table {
            thead { tr { th { "parameter" } th { "nominal" } th { "estimate" } th { "shift" } th { "sigma" } th { "unit" }
                th { "over ±3 prior sigma" } th { "status" } } }
            tbody { @for p in rows { (parameter_row(p)) } }
        } }
    }
}
