//! The document: one page of facts and figures, or two, for paper.

use maud::{Markup, html};
use spherecal_identify::ExpectedError;

use super::{Certificate, millimetres};
use crate::headline::{brief, first_upper};

/// Remarks that the certificate lists, each by its first clause; the report has all in full.
const REASONS: usize = 4;

fn stated(value: Option<&str>) -> Markup {
    if let Some(value) = value.map(str::trim).filter(|v| !v.is_empty()) {
        html! { (value) }
    } else {
        html! { span.unstated { "not stated" } }
    }
}

fn fact(name: &str, value: &Markup) -> Markup {
    html! { div { dt { (name) } dd { (value) } } }
}

/// A row of results: name, figure in mm, words.
fn row(name: &str, figure: &str, words: &str) -> Markup {
    html! { tr { td { (name) } td { (figure) } td.words { (words) } } }
}

fn expected(name: &str, error: Option<&ExpectedError>) -> Markup {
    match error {
        Some(e) => row(
            name,
            &millimetres(e.mean),
            &format!(
                "mean; 95 % interval {} to {}; 95 % of the work region below {}",
                millimetres(e.interval[0]),
                millimetres(e.interval[1]),
                millimetres(e.p95)
            ),
        ),
        None => row(name, "not stated", "the data do not tell it"),
    }
}

impl Certificate {
    /// The document, issued on the day `issued`. A draft says on every page that it is none.
    pub fn document(&self, issued: &str, draft: bool) -> String {
        let number = self.number.as_deref().unwrap_or("not stated");
        let foot = format!(
            "{}No. {number}",
            if draft { "DRAFT, not a certificate \u{b7} " } else { "" }
        );
        let title = format!("Calibration certificate {number}");
        crate::parts::document(&title, &foot, &self.page(issued, draft))
    }

    fn page(&self, issued: &str, draft: bool) -> Markup {
        let text = |value: &Option<String>| stated(value.as_deref());
        let celsius = self.temperature_c.map(|c| format!("{c} \u{b0}C"));
        html! {
            section #certificate.certificate {
                div.head { h1 { "Calibration certificate" } p { "No. " (text(&self.number)) } }
                @if draft { p.simulated { b { "DRAFT" } " This page is no certificate." } }
                @if self.simulated {
                    p.simulated { b { "SIMULATED" } " The arm was a simulation. This page certifies no robot." }
                }
                dl.facts2 {
                    (fact("Customer", &text(&self.customer)))
                    (fact("Laboratory", &text(&self.laboratory)))
                    (fact("Address", &text(&self.customer_address)))
                    (fact("Address", &text(&self.laboratory_address)))
                    (fact("Item", &html! { "robot arm, " (self.robot) }))
                    (fact("Serial number", &text(&self.serial)))
                    (fact("Measured (UTC)", &text(&self.measured)))
                    (fact("Place", &text(&self.place)))
                    (fact("Operator", &text(&self.operator)))
                    (fact("Issued", &html! { (issued) }))
                }
                h2 { "Method" }
                p { "The data are " (self.method) "; " (self.recordings) " recordings; " (self.estimator) ", by " (self.program) @if let Some(commit) = &self.commit { ", commit " (commit) } "." }
                p {
                    "Conditions: " (stated(celsius.as_deref())) " at the robot"
                    @if let Some(more) = &self.conditions { "; " (more) } "."
                }
                p { (self.traceability()) }
                h2 { "Results" }
                (self.results())
                (self.terms())
                (self.verdict())
                p.small {
                    "The results hold for this item alone, as it was measured. This certificate may be copied only as a whole. \
                     Configuration SHA-256 " (text(&self.configuration_sha256)) ", recordings SHA-256 "
                    (stated(Some(&self.recordings_sha256))) "."
                }
            }
        }
    }

    /// To what the lengths are traceable.
    fn traceability(&self) -> Markup {
        let text = |value: &Option<String>| stated(value.as_deref());
        let by = |name: &str, what: &Option<String>, number: &Option<String>| {
            html! { (name) " " (text(what)) ", certificate " (text(number)) }
        };
        let plate = by("the plate", &self.plate, &self.plate_certificate);
        let instrument = by("the instrument", &self.instrument, &self.instrument_certificate);
        html! {
            "Traceability: the metre of the results is that of "
            @if self.contacts { (plate) } @else { (instrument) } "."
            @if self.contacts && self.instrument.is_some() { " The measured accuracy is by " (instrument) "." }
        }
    }

    fn results(&self) -> Markup {
        html! {
            div.scroll { table.results {
                thead { tr { th { "Position of the TCP" } th { "mm" } th.words { "" } } }
                tbody {
                    (expected("Expected error, full model", self.expected_error_mm.as_ref()))
                    @match &self.uncertainty {
                        Some(u) => (row(
                            &format!("Uncertainty U (k = {})", u.k),
                            &millimetres(u.expanded_mm),
                            &format!("{} u, with u = {}: root mean square error over the work region", u.k, millimetres(u.standard_mm)),
                        )),
                        None => (row("Uncertainty U (k = 2)", "not stated", "the data do not tell it")),
                    }
                    (expected("Expected error, geometry alone", self.geometry_alone_mm.as_ref()))
                    (expected("Expected error, nominal robot", self.nominal_error_mm.as_ref()))
                    @for e in &self.position_errors {
                        (row(
                            "Measured accuracy",
                            &millimetres(e.mean_mm),
                            &format!(
                                "mean of {} poses, largest {}, nominally {}; {}",
                                e.n, millimetres(e.max_mm), millimetres(e.nominal_mean_mm), e.by
                            ),
                        ))
                    }
                    @if self.position_errors.is_empty() {
                        (row("Measured accuracy", "not stated", "nothing measured the calibrated robot at poses outside of the fit"))
                    }
                    @match &self.repeatability {
                        Some(r) => (row(
                            "Repeatability of coupling",
                            &r.iso_formula_mm.map_or_else(|| "not stated".to_owned(), millimetres),
                            &format!(
                                "mean distance + 3 sigma of {} couplings on {} {} (standard deviation {})",
                                r.couplings,
                                r.spheres,
                                if r.spheres == 1 { "sphere" } else { "spheres" },
                                millimetres(r.sigma_mm)
                            ),
                        )),
                        None => (row("Repeatability of coupling", "not stated", "no sphere was coupled twice")),
                    }
                }
            } }
            p.small {
                "Accuracy and repeatability follow ISO 9283 in their formulas only: each pose was measured once, and it is the \
                 coupling of a sphere that was repeated, from different poses, not one pose thirty times."
            }
        }
    }

    fn terms(&self) -> Markup {
        html! {
            div.scroll { table.results {
                thead { tr { th { "Budget of u" } th { "mm" } th.words { "" } } }
                tbody {
                    @for line in &self.budget {
                        (row(&line.name, &line.rms_mm.map_or_else(|| "not stated".to_owned(), millimetres), &line.remark))
                    }
                    @if let Some(u) = &self.uncertainty {
                        tr.total { td { "Together: u" } td { (millimetres(u.standard_mm)) } td.words { "root of the sum of the squares" } }
                    }
                }
            } }
            p.small {
                "The base is aligned: where the robot stands is not in these figures, nor are temperatures and loads other \
                 than those of the measurement."
                @match &self.uncertainty {
                    Some(u) if u.noise_by_data => " Seating (or instrument) and encoder noise are told apart by the data: \
                        that of the encoders turns with the posture.",
                    Some(_) => " Seating (or instrument) and encoder noise are those of the options.",
                    None => "",
                }
            }
        }
    }

    fn verdict(&self) -> Markup {
        let more = self.reasons.len().saturating_sub(REASONS);
        html! {
            @if let Some(c) = &self.conformity {
                h2 { "Conformity" }
                p {
                    "Asked: a mean position error of at most " (millimetres(c.asked_mm)) " mm. " (c.rule) " "
                    b { (if c.conforms { "The robot conforms." } else { "Conformity is not shown." }) } " " (first_upper(&c.words)) "."
                }
            }
            @if !self.reasons.is_empty() {
                h2 { "Remarks" }
                ul { @for r in self.reasons.iter().take(REASONS) { li { (brief(r)) } } }
                p.small { @if more > 0 { "And " (more) " more. " } "The report has them in full." }
            }
            @if let Some(months) = self.validity_months {
                p {
                    "Next calibration, as agreed with the customer: after " (months) " months"
                    @if let Some(day) = &self.next_calibration { ", " (day) } "."
                }
            }
            dl.facts2.signed {
                (fact("Authorised by", &stated(self.authorised_by.as_deref())))
                (fact("Signature, date", &html! { span.line {} }))
            }
        }
    }
}
