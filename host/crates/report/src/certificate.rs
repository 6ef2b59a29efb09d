//! The certificate of a result: its figures and names for programs (`certificate` in `summary.json`), from which
//! `spherecal certificate` makes the document that a laboratory issues.

mod document;

use serde::{Deserialize, Serialize};
use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Repeatability;

/// Coverage factor of the expanded uncertainty.
pub const COVERAGE: f64 = 2.0;

/// A line of the budget.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
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
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
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

/// Conformity with an accuracy that was asked for.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Conformity {
    /// Largest mean error, in mm.
    pub asked_mm: f64,
    /// Decision rule, as a sentence.
    pub rule: String,
    /// Whether the robot conforms by that rule.
    pub conforms: bool,
    /// What was compared, as a sentence.
    pub words: String,
}

/// Everything on it. What is not known is `None`, and is printed as "not stated".
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Certificate {
    /// Whether the arm was a simulation: then this certifies no robot.
    pub simulated: bool,
    /// Whether the data are contacts with the spheres of a plate; else an instrument measured points.
    pub contacts: bool,
    /// Number of the certificate.
    pub number: Option<String>,
    /// Customer.
    pub customer: Option<String>,
    /// Address of the customer.
    pub customer_address: Option<String>,
    /// Laboratory.
    pub laboratory: Option<String>,
    /// Address of the laboratory.
    pub laboratory_address: Option<String>,
    /// Where the robot stands.
    pub place: Option<String>,
    /// Who calibrated.
    pub operator: Option<String>,
    /// Who authorises the certificate.
    pub authorised_by: Option<String>,
    /// Robot.
    pub robot: String,
    /// Its serial number.
    pub serial: Option<String>,
    /// When it was measured, in UTC.
    pub measured: Option<String>,
    /// Temperature, in degrees Celsius.
    pub temperature_c: Option<f64>,
    /// Further conditions of the measurement, in words.
    pub conditions: Option<String>,
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
    /// Conformity with the accuracy that was asked for; `None` if no accuracy was asked for.
    pub conformity: Option<Conformity>,
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

impl Certificate {
    /// What a certificate must state (ISO/IEC 17025, 7.8.2 and 7.8.4) and this one does not, by the names of the block
    /// `[certificate]`.
    pub fn missing(&self) -> Vec<&'static str> {
        let empty = |value: &Option<String>| value.as_deref().is_none_or(|v| v.trim().is_empty());
        let names = [
            ("number", &self.number),
            ("customer", &self.customer),
            ("customer_address", &self.customer_address),
            ("laboratory", &self.laboratory),
            ("laboratory_address", &self.laboratory_address),
            ("place", &self.place),
            ("operator", &self.operator),
            ("authorised_by", &self.authorised_by),
            ("serial", &self.serial),
            ("measured_on", &self.measured),
        ];
        // The scale of all lengths, to which the results are traceable.
        let source = if self.contacts {
            [("plate", &self.plate), ("plate_certificate", &self.plate_certificate)]
        } else {
            [
                ("instrument", &self.instrument),
                ("instrument_certificate", &self.instrument_certificate),
            ]
        };
        let mut missing: Vec<&'static str> = names
            .into_iter()
            .chain(source)
            .filter(|(_, value)| empty(value))
            .map(|(name, _)| name)
            .collect();
        if self.temperature_c.is_none() {
            missing.push("temperature_c");
        }
        missing
    }
}
