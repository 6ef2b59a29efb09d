//! The certificate: the last page of the report, as a laboratory files it, and the same figures for
//! programs (`certificate` in `summary.json`). Both are made from one [`Certificate`].

use maud::{Markup, html};
use serde::Serialize;
use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Repeatability;

/// Coverage factor of the expanded uncertainty.
pub const COVERAGE: f64 = 2.0;
/// Reasons that the certificate lists; the report has all.
const REASONS: usize = 2;

/// A line of the budget.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct BudgetLine {
    /// Name for programs.
    pub source: String,
    /// Name for people.
    pub name: String,
    /// Root mean square of the TCP's displacement over the work region by this source alone, in mm;
    /// none where the data do not tell it.
    pub rms_mm: Option<f64>,
    /// What the term holds, or why it is not stated.
    pub remark: String,
}

/// The uncertainty of a position of the TCP, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Uncertainty {
    /// Standard uncertainty: root mean square of the position error over the work region.
    pub standard_mm: f64,
    /// Coverage factor.
    pub k: f64,
    /// Expanded uncertainty.
    pub expanded_mm: f64,
    /// Whether the data told the noise of seating or instrument from that of the encoders; else the
    /// options gave both.
    pub noise_by_data: bool,
}

/// Position errors that were measured at poses outside of the fit, in mm.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct PositionError {
    /// Who measured, and in which frame the errors are.
    pub by: String,
    /// Poses.
    pub n: usize,
    /// Mean error of the calibrated robot.
    pub mean_mm: f64,
    /// Its largest error.
    pub max_mm: f64,
    /// Mean error of the nominal robot.
    pub nominal_mean_mm: f64,
}

/// Everything on it. What is not known is `None`, and is printed as "not stated".
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Certificate {
    /// Whether the arm was a simulation: then this certifies no robot.
    pub simulated: bool,
    /// Number of the certificate.
    pub number: Option<String>,
    /// Laboratory.
    pub laboratory: Option<String>,
    /// Where the robot stands.
    pub place: Option<String>,
    /// Who calibrated.
    pub operator: Option<String>,
    /// Robot.
    pub robot: String,
    /// Its serial number.
    pub serial: Option<String>,
    /// When it was measured, in UTC.
    pub measured: Option<String>,
    /// Temperature, in degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Instrument.
    pub instrument: Option<String>,
    /// Number of the instrument's certificate.
    pub instrument_certificate: Option<String>,
    /// Plate.
    pub plate: Option<String>,
    /// Number of the plate's certificate.
    pub plate_certificate: Option<String>,
    /// How the data were made.
    pub method: String,
    /// Estimator and model.
    pub estimator: String,
    /// Program with its version.
    pub program: String,
    /// Commit of the program, where the build stated it.
    pub commit: Option<String>,
    /// SHA-256 of the configuration (of a run), or of the options (of a table of poses), as TOML.
    pub configuration_sha256: Option<String>,
    /// Recordings that were used.
    pub recordings: usize,
    /// SHA-256 of all recordings.
    pub recordings_sha256: String,
    /// Expected error of the full model over the work region.
    pub expected_error_mm: Option<ExpectedError>,
    /// That of the geometry alone, as the files hold it.
    pub geometry_alone_mm: Option<ExpectedError>,
    /// That of the nominal robot.
    pub nominal_error_mm: Option<ExpectedError>,
    /// Uncertainty of a position with the full model.
    pub uncertainty: Option<Uncertainty>,
    /// Where it comes from. The squares of the terms add up to that of the standard uncertainty.
    pub budget: Vec<BudgetLine>,
    /// Position errors that were measured.
    pub position_errors: Vec<PositionError>,
    /// Repeatability of coupling a sphere.
    pub repeatability: Option<Repeatability>,
    /// Verdict.
    pub may_be_used: bool,
    /// Why not, or what to keep in mind.
    pub reasons: Vec<String>,
    /// Months until the next calibration.
    pub validity_months: Option<u32>,
    /// Date of the next calibration; none for a result that may not be used, too.
    pub next_calibration: Option<String>,
}

/// A length in mm as the certificate prints it: micrometres, and a digit more below 10 of them.
pub fn millimetres(value: f64) -> String {
    if value != 0.0 && value.abs() < 0.01 {
        format!("{value:.4}")
    } else {
        format!("{value:.3}")
    }
}

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
    /// The page.
    pub(crate) fn page(&self) -> Markup {
        let text = |value: &Option<String>| stated(value.as_deref());
        let celsius = self.temperature_c.map(|c| format!("{c} \u{b0}C"));
        let program = html! { (self.program) ", commit " (text(&self.commit)) };
        html! {
            section #certificate.certificate {
                div.head {
                    h2 { "Calibration certificate" }
                    p { "No. " (text(&self.number)) }
                }
                @if self.simulated {
                    p.simulated { b { "SIMULATED" } " The arm was a simulation. This page certifies no robot." }
                }
                dl.facts2 {
                    (fact("Robot", &html! { (self.robot) }))
                    (fact("Serial number", &text(&self.serial)))
                    (fact("Laboratory", &text(&self.laboratory)))
                    (fact("Place", &text(&self.place)))
                    (fact("Operator", &text(&self.operator)))
                    (fact("Measured (UTC)", &text(&self.measured)))
                    (fact("Temperature", &stated(celsius.as_deref())))
                    (fact("Recordings", &html! { (self.recordings) }))
                    (fact("Plate", &text(&self.plate)))
                    (fact("Its certificate", &text(&self.plate_certificate)))
                    (fact("Instrument", &text(&self.instrument)))
                    (fact("Its certificate", &text(&self.instrument_certificate)))
                    (fact("Method", &html! { (self.method) }))
                    (fact("Estimator", &html! { (self.estimator) }))
                    (fact("Program", &program))
                }
                dl.facts2.hashes {
                    (fact("Configuration SHA-256", &text(&self.configuration_sha256)))
                    (fact("Recordings SHA-256", &stated(Some(&self.recordings_sha256))))
                }
                (self.results())
                (self.terms())
                (self.verdict())
            }
        }
    }

    fn results(&self) -> Markup {
        html! {
            table.results {
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
            }
            p.small {
                "Accuracy and repeatability follow ISO 9283 in their formulas only: each pose was measured once, and it is the \
                 coupling of a sphere that was repeated, from different poses, not one pose thirty times."
            }
        }
    }

    fn terms(&self) -> Markup {
        html! {
            table.results {
                thead { tr { th { "Budget of u" } th { "mm" } th.words { "" } } }
                tbody {
                    @for line in &self.budget {
                        (row(&line.name, &line.rms_mm.map_or_else(|| "not stated".to_owned(), millimetres), &line.remark))
                    }
                    @if let Some(u) = &self.uncertainty {
                        tr.total { td { "Together: u" } td { (millimetres(u.standard_mm)) } td.words { "root of the sum of the squares" } }
                    }
                }
            }
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
            div class=(if self.may_be_used { "verdict" } else { "verdict no" }) {
                p.mark { (if self.may_be_used { "May be used" } else { "Not to be used" }) }
                @if !self.reasons.is_empty() {
                    ul { @for r in self.reasons.iter().take(REASONS) { li { (r) } } }
                    @if more > 0 { p.small { "and " (more) " more in the report" } }
                }
            }
            dl.facts2 {
                (fact("Validity", &stated(self.validity_months.map(|m| format!("{m} months")).as_deref())))
                (fact("Next calibration", &self.next()))
                (fact("Date", &html! { span.line {} }))
                (fact("Signature", &html! { span.line {} }))
            }
        }
    }

    fn next(&self) -> Markup {
        if !self.may_be_used {
            return html! { "none: the result may not be used" };
        }
        stated(self.next_calibration.as_deref())
    }
}
