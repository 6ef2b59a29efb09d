//! May the result be used? In numbers, in words, and as the exit code.
//!
//! One verdict for every way in which a calibration is made. `checks` looks at the
//! evidence and lists what was found, each check with its number and limit; the
//! [`Statement`] gives the error of the TCP over each region.
//!
//! ```text
//! Evidence ─┬ checks ─────────┬▶ Verdict
//!           └ Statement ──────┘
//! ```

mod asked;
mod checks;
mod diagnosed;

use nalgebra::Vector3;
use serde::Serialize;
use spherecal_model::Chain;
use spherecal_shared::robot::Tool;

use crate::causes::Causes;
use crate::hierarchy::constants::SURE;
use crate::judge::{HeldOut, Judged};
use crate::recordings::Recordings;
use crate::statement::{ExpectedErrors, Statement};
use crate::validate::ValidationTable;
use crate::{Calibration, GeometryOnly, Options};

use checks::{REAL_ARM, checks};

/// Everything that a check may look at.
#[derive(Clone, Copy)]
pub struct Evidence<'a> {
    /// What was measured.
    pub recordings: &'a Recordings,
    /// Options of the fit, after all choices from the data.
    pub options: &'a Options,
    /// Rows that the fit used, in the order of the calibration's observations.
    pub used: &'a [usize],
    /// Rows left out as gross errors, with their distance in mm.
    pub rejected: &'a [(usize, f64)],
    /// Rows that are copies of another.
    pub repeated: &'a [(usize, usize)],
    /// The result.
    pub calibration: &'a Calibration,
    /// Errors of rows that the fit has not seen, by model: `nominal`, `calibrated`.
    pub judged: Option<&'a Judged>,
    /// Whether those are a cross-validation of the calibration data.
    pub cross_validated: bool,
    /// The hold-out that was asked for.
    pub holdout: Option<&'a HeldOut>,
    /// Errors on the points of an independent instrument: `nominal`, `sphere`, others.
    pub table: Option<&'a ValidationTable>,
    /// What the residuals name; it is a part of the result.
    pub causes: &'a Causes,
    /// What the result is worth; `None` for estimators without a posterior.
    pub statement: Option<&'a Statement>,
    /// The geometry that files hold.
    pub geometry: &'a GeometryOnly,
    /// TCP of the nominal robot in the last frame of the table, in m: as it was given, or
    /// as the data said with the nominal geometry, where that was another tool.
    pub nominal_tcp_m: Vector3<f64>,
    /// Mean error (mm) that was asked for.
    pub accuracy_mm: Option<f64>,
    /// How far (mm) the validation points stood from their said frame, where a rigid
    /// motion of all of them was taken out.
    pub realigned_mm: Option<f64>,
}

/// One thing that was checked.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Check {
    /// Its name, which does not change from version to version.
    pub name: &'static str,
    /// What was found; none where it is not a number.
    pub value: Option<f64>,
    /// What it is held against.
    pub limit: Option<f64>,
    /// Whether the result passed.
    pub passed: bool,
    /// What a failure does: it refuses the result, or only qualifies it.
    pub refuses: bool,
    /// What was found, in words, with unit.
    pub words: String,
    /// Of a cause, what it would do to the TCP, as a share of the expected error; else 1. Remarks have this order.
    #[serde(skip)]
    weight: f64,
}

impl Check {
    /// A check whose failure refuses the result.
    pub fn new(name: &'static str, value: Option<f64>, limit: Option<f64>, passed: bool, words: String) -> Self {
        Self {
            name,
            value: value.filter(|v| v.is_finite()),
            limit: limit.filter(|v| v.is_finite()),
            passed,
            refuses: true,
            words,
            weight: 1.0,
        }
    }

    /// The same check, whose failure only qualifies the result.
    #[must_use]
    pub fn qualifying(self) -> Self {
        Self { refuses: false, ..self }
    }

    /// The same check with another weight among the remarks.
    fn weighing(self, weight: f64) -> Self {
        Self { weight, ..self }
    }
}

/// Whether a result may be used.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Before, after, of which artefact, over which region, may it be used: in one sentence.
    pub headline: String,
    /// Exit code 0 instead of 3.
    pub may_be_used: bool,
    /// Probability that the result is better over the work region than the nominal robot and, where an accuracy was
    /// asked for, than that; `None` where the statement is unknown.
    pub probability: Option<f64>,
    /// Error of the TCP to expect, in mm, over the work region and the others; `None` where it is unknown.
    pub expected_error_mm: Option<ExpectedErrors>,
    /// The same of the nominal robot.
    pub nominal_error_mm: Option<ExpectedErrors>,
    /// The same of the geometry alone, as files hold it.
    pub file_error_mm: Option<ExpectedErrors>,
    /// Share of the nominal mean error that is gone: by the independent instrument, else
    /// by rows that were measured apart, else by the expected error over the work region;
    /// none where nothing judged.
    pub improvement: Option<f64>,
    /// What was checked.
    pub checks: Vec<Check>,
    /// Words of the checks that failed: first those that refuse, then those that qualify.
    pub reasons: Vec<String>,
    /// What to do next.
    pub next: String,
}

/// Mean and largest error of the nominal and of the calibrated robot, in mm.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Compared {
    pub(crate) nominal: (f64, f64),
    pub(crate) calibrated: (f64, f64),
    /// Probability that the calibrated robot is the better one, by the rows that judge both; `None` where no rows do.
    pub(crate) better: Option<f64>,
}

/// What is expected of each model.
#[derive(Clone, Copy)]
pub(crate) struct Expected {
    /// Error of the calibrated robot.
    pub(crate) own: ExpectedErrors,
    /// Error of the nominal robot.
    pub(crate) nominal: ExpectedErrors,
    /// Error of the geometry alone.
    file: ExpectedErrors,
    /// Probability that the calibrated robot is better than the nominal one over the work region.
    pub(crate) better: f64,
    /// Probability that it is as good as was asked for.
    pub(crate) asked: Option<f64>,
}

impl Evidence<'_> {
    /// The nominal robot.
    pub(crate) fn nominal(&self) -> Chain {
        let experiment = &self.recordings.experiment;
        let tool = Tool {
            tcp_m: self.nominal_tcp_m.into(),
            ..experiment.tool
        };
        Chain::unchecked(&experiment.robot, &tool)
    }

    /// What the statement expects of each model, computed once; `None` without a statement.
    fn expected(&self) -> Option<Expected> {
        let statement = self.statement?;
        let nominal = self.nominal();
        let nominal = |q: &[f64]| nominal.pose(q).position;
        let alone = Chain::unchecked(&self.geometry.robot, &self.geometry.tool);
        let own = |q: &[f64]| self.calibration.tcp_m(q, None);
        Some(Expected {
            own: statement.expected_errors_of(own),
            nominal: statement.expected_errors_of(nominal),
            file: statement.expected_errors_of(|q| alone.pose(q).position),
            better: statement.probability_better(own, nominal),
            asked: self.accuracy_mm.map(|mm| statement.probability_below(own, mm)),
        })
    }

    /// What judges best: the independent instrument with the base as it measured it,
    /// else the rows that the fit has not seen.
    pub(crate) fn compared(&self) -> Option<Compared> {
        if let Some(table) = self.table {
            let of = |name| table.model(name).map(|m| (m.arcs.mean_mm, m.arcs.max_mm));
            return Some(Compared {
                nominal: of("nominal")?,
                calibrated: of("sphere")?,
                better: None,
            });
        }
        let of = |name: &str| {
            let errors = self.judged?.model(name)?.errors();
            (errors.n > 0).then_some((errors.mean_mm, errors.max_mm))
        };
        Some(Compared {
            nominal: of("nominal")?,
            calibrated: of("calibrated")?,
            better: self
                .judged
                .and_then(|judged| judged.model("calibrated")?.better_than(judged.model("nominal")?)),
        })
    }
}

/// Judges a result by all of its evidence.
pub fn verdict(evidence: &Evidence<'_>) -> Verdict {
    let expected = evidence.expected();
    let checks = checks(evidence, expected.as_ref());
    let failed = |refuses: bool| checks.iter().filter(move |c| !c.passed && c.refuses == refuses);
    let may_be_used = failed(true).next().is_none();
    let mut remarks: Vec<&Check> = failed(false).collect();
    remarks.sort_by(|a, b| b.weight.total_cmp(&a.weight));
    // The headline says that an arm was simulated.
    let said = failed(true).chain(remarks).filter(|c| c.name != REAL_ARM);
    let reasons = said.map(|c| c.words.clone()).collect();
    let independent = evidence.table.is_some() || (evidence.judged.is_some() && !evidence.cross_validated);
    let means = match (independent, expected) {
        (false, Some(e)) => Some((e.nominal.work.mean, e.own.work.mean)),
        _ => evidence.compared().map(|c| (c.nominal.0, c.calibrated.0)),
    };
    Verdict {
        headline: headline(evidence, expected.as_ref(), may_be_used),
        may_be_used,
        probability: expected.map(|e| e.asked.map_or(e.better, |asked| asked.min(e.better))),
        expected_error_mm: expected.map(|e| e.own),
        nominal_error_mm: expected.map(|e| e.nominal),
        file_error_mm: expected.map(|e| e.file),
        improvement: means
            .filter(|(nominal, _)| *nominal > 0.0)
            .map(|(nominal, calibrated)| 1.0 - calibrated / nominal),
        next: next(evidence, expected.as_ref(), may_be_used),
        reasons,
        checks,
    }
}

/// Before, after, of which artefact, over which region, may it be used.
fn headline(evidence: &Evidence<'_>, expected: Option<&Expected>, may_be_used: bool) -> String {
    let simulated = match &evidence.recordings.campaign {
        Some(campaign) if campaign.simulated => "SIMULATED ",
        _ => "",
    };
    let robot = &evidence.recordings.experiment.robot.name;
    let figures = match expected {
        Some(e) => {
            let file = if evidence.geometry.helps() {
                format!("{:.2} mm with calibrated.urdf alone", e.file.mean)
            } else {
                "no calibrated.urdf, which would be worse than the nominal robot".to_owned()
            };
            format!(
                "{:.2} mm -> {:.2} mm (expected, work region, with the compensator; {file})",
                e.nominal.mean, e.own.mean
            )
        }
        None => match evidence.compared() {
            Some(found) => format!(
                "{:.2} mm -> {:.2} mm (mean of the rows that judge it)",
                found.nominal.0, found.calibrated.0
            ),
            None => "nothing judged the result".to_owned(),
        },
    };
    let word = if may_be_used { "OK to use." } else { "DO NOT USE." };
    format!("{simulated}{robot}: {figures}. {word}")
}

/// What to do next, by the artefact with the error that it has.
fn next(evidence: &Evidence<'_>, expected: Option<&Expected>, may_be_used: bool) -> String {
    if !may_be_used {
        return "Do not load this model: remove the causes named above, or measure more poses over a wider range of \
                orientations and joint angles, and run again."
            .to_owned();
    }
    if evidence.recordings.campaign.as_ref().is_some_and(|c| c.simulated) {
        return "The files are those of a simulated arm: they show what a run gives, and fit no real robot.".to_owned();
    }
    let Some(Expected { own, file, .. }) = expected else {
        return "Load calibrated.urdf or calibrated.toml, and check it on a few points of your own with --validate."
            .to_owned();
    };
    if evidence.geometry.better.is_some_and(|p| p < SURE) {
        return format!(
            "Use the compensator of calibrated.toml ({:.3} mm expected over the work region). calibrated.urdf alone is not \
             surely better than the nominal robot there.",
            own.mean
        );
    }
    format!(
        "Load calibrated.urdf ({:.3} mm expected over the work region), or use the compensator of calibrated.toml too ({:.3} \
         mm). Check a few points of your own with --validate.",
        file.mean, own.mean
    )
}
