//! What is checked, each check with its number and limit.

use super::asked::{asked_accuracy, validation_agrees};
use super::diagnosed::{diagnosed, probability};
use super::{Check, Evidence, Expected};
use crate::Method;
use crate::causes::log_tail;
use crate::hierarchy::constants::SURE;
use crate::residuals::OUTLIER_SIGMAS;

/// Name of the check that the arm is a real one.
pub(super) const REAL_ARM: &str = "real_arm";
/// Smallest share of the nominal mean error that a calibration should remove.
const SMALL_GAIN: f64 = 0.05;
/// Factor on the nominal largest error where the rows themselves judge: single rows
/// differ by chance.
const WORST_ROW: f64 = 1.5;
/// Most of the rows that may be outliers.
const MOST_OUTLIERS: f64 = 0.2;
/// Rows and poses that a check names.
const NAMED: usize = 5;
/// A seated nest that moves further under the test pull is doubtful, in mm.
const DOUBTFUL_SEAT_MM: f64 = 1.0;

/// All checks, the most important first.
pub(super) fn checks(evidence: &Evidence<'_>, expected: Option<&Expected>) -> Vec<Check> {
    let mut checks = Vec::new();
    diagnosed(evidence, expected, &mut checks);
    asked_accuracy(evidence, expected, &mut checks);
    validation_agrees(evidence, expected, &mut checks);
    against_nominal(evidence, &mut checks);
    held_out(evidence, &mut checks);
    parameters(evidence, &mut checks);
    rows(evidence, &mut checks);
    campaign(evidence, &mut checks);
    checks
}

/// Whether the calibrated robot is better than the nominal one.
fn against_nominal(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let by = match (evidence.table, evidence.judged) {
        (Some(_), _) => "on the independent instrument's points",
        (None, Some(_)) if evidence.cross_validated => "in cross-validation",
        _ => "on rows that the fit has not seen",
    };
    let Some(found) = evidence.compared() else {
        checks.push(Check::new(
            "judged",
            None,
            None,
            false,
            "nothing judged the result: give --validate, or more rows".to_owned(),
        ));
        return;
    };
    let (nominal, calibrated) = (found.nominal, found.calibrated);
    // Rows differ: a gain that chance explains is none.
    let sure = found.better.is_none_or(|probability| probability >= SURE);
    let better = calibrated.0 < nominal.0 && sure;
    let comparison = format!("mean {:.3} mm against {:.3} mm {by}", calibrated.0, nominal.0);
    checks.push(Check::new(
        "better_than_nominal",
        Some(calibrated.0),
        Some(nominal.0),
        better,
        if better {
            format!("the calibrated robot is better than the nominal one: {comparison}")
        } else {
            format!("the calibrated robot is not better than the nominal one, or only by chance: {comparison}")
        },
    ));
    if better {
        let gain = 1.0 - calibrated.0 / nominal.0;
        let words = format!("the gain is {:.0} %: {comparison}", gain * 100.0);
        let enough = gain >= SMALL_GAIN;
        checks.push(Check::new("gain", Some(gain), Some(SMALL_GAIN), enough, words).qualifying());
        let limit = if evidence.table.is_some() { 1.0 } else { WORST_ROW } * nominal.1;
        checks.push(
            Check::new(
                "largest_error",
                Some(calibrated.1),
                Some(limit),
                calibrated.1 <= limit,
                format!(
                    "the worst sample is {:.3} mm off {by}, {:.3} mm nominally",
                    calibrated.1, nominal.1
                ),
            )
            .qualifying(),
        );
    }
    let independent = evidence.table.is_some() || !evidence.cross_validated;
    checks.push(
        Check::new(
            "independent_validation",
            None,
            None,
            independent,
            if independent {
                format!("the result was judged {by}")
            } else {
                "no separate validation was given; the errors are from cross-validation and hold where the data are"
                    .to_owned()
            },
        )
        .qualifying(),
    );
}

/// Whether it is better also on the values of a column that were held out.
fn held_out(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let Some(holdout) = evidence.holdout else { return };
    let of = |name: &str| holdout.pooled.model(name).map_or(0.0, |m| m.errors().mean_mm);
    let (nominal, calibrated) = (of("nominal"), of("calibrated"));
    let better = calibrated < nominal;
    checks.push(Check::new(
        "held_out",
        Some(calibrated),
        Some(nominal),
        better,
        format!(
            "held out by {}, the calibrated robot is {}better than the nominal one: mean {calibrated:.3} mm against \
             {nominal:.3} mm",
            holdout.column,
            if better { "" } else { "not " },
        ),
    ));
}

/// Whether the data determine what was estimated.
fn parameters(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let calibration = evidence.calibration;
    // With priors every parameter is determined: what the data leave open is in the
    // expected error.
    if !matches!(calibration.method, Method::Full | Method::Geometry) {
        let free = calibration.parameters.iter().filter(|p| p.free);
        let blind: Vec<&str> = free.filter(|p| !p.moved).map(|p| p.name.as_str()).collect();
        let words = if blind.is_empty() {
            "every estimated parameter is determined by the data".to_owned()
        } else {
            format!(
                "these parameters were never identified but are used: {}",
                blind.join(", ")
            )
        };
        checks.push(Check::new(
            "parameters_determined",
            Some(blind.len() as f64),
            Some(0.0),
            blind.is_empty(),
            words,
        ));
    }
    let rows = evidence.used.len() as f64;
    let least = (calibration.effective_parameters + 6.0) / 3.0;
    let check = Check::new(
        "enough_rows",
        Some(rows),
        Some(least),
        rows > least,
        if rows > least {
            format!("{rows} rows for {:.0} parameters", calibration.effective_parameters)
        } else {
            format!(
                "{rows} rows are too few for {:.0} parameters: measure more poses",
                calibration.effective_parameters
            )
        },
    );
    // What few rows leave open is in the stated error.
    checks.push(check.qualifying());
}

/// Chance of at least `bad` outliers in rows with normal noise: logarithm to the base 10.
fn so_many(bad: usize, all: usize) -> f64 {
    let expected = all as f64 * log_tail(OUTLIER_SIGMAS * OUTLIER_SIGMAS, 3).exp();
    // Poisson: the first term rules where few are expected, and each further one is smaller.
    let mut term = bad as f64 * expected.ln() - expected - libm::lgamma(bad as f64 + 1.0);
    let mut log = term;
    for k in bad + 1..bad + 50 {
        term += expected.ln() - (k as f64).ln();
        let (high, low) = if log > term { (log, term) } else { (term, log) };
        log = high + (low - high).exp().ln_1p();
    }
    log.min(0.0) / core::f64::consts::LN_10
}

/// The outliers by name: first those that were left out, with their distance, then those
/// that the fit does not believe.
fn outliers(evidence: &Evidence<'_>) -> String {
    let recordings = evidence.recordings;
    let left_out = evidence
        .rejected
        .iter()
        .map(|(i, mm)| format!("{} ({mm:.1} mm)", recordings.describe(*i)));
    let residual = &evidence.calibration.residual;
    let doubted = residual.outliers.iter().filter_map(|o| {
        let size = residual.rows.iter().find(|r| r.index == o.index).map(|r| {
            let [x, y, z] = r.error_mm;
            (x * x + y * y + z * z).sqrt()
        });
        let row = recordings.describe(*evidence.used.get(o.index)?);
        Some(size.map_or_else(|| row.clone(), |mm| format!("{row} ({mm:.2} mm)")))
    });
    listed(left_out.chain(doubted))
}

/// The first of some names, and how many there are besides.
fn listed(names: impl Iterator<Item = String>) -> String {
    let mut names: Vec<String> = names.collect();
    if let Some(more) = names.len().checked_sub(NAMED).filter(|more| *more > 0) {
        names.truncate(NAMED);
        names.push(format!("and {more} more"));
    }
    names.join(", ")
}

/// Whether the rows agree with the model and with each other.
fn rows(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let all = evidence.used.len() + evidence.rejected.len();
    let bad = evidence.rejected.len() + evidence.calibration.residual.outliers.len();
    let share = bad as f64 / all.max(1) as f64;
    let words = if bad == 0 {
        format!("none of {all} rows is an outlier")
    } else {
        let (are, repeat) = if bad == 1 {
            ("is an outlier", "repeat this pose, or leave its row out")
        } else {
            ("are outliers", "repeat these poses, or leave their rows out")
        };
        format!(
            "{bad} of {all} rows {are}, which the fit leaves out or hardly counts (so many by chance: p = {}): {}; {repeat}",
            probability(so_many(bad, all)),
            outliers(evidence)
        )
    };
    checks.push(
        Check::new(
            "outliers",
            Some(share),
            Some(MOST_OUTLIERS),
            share <= MOST_OUTLIERS,
            if share <= MOST_OUTLIERS {
                words.clone()
            } else {
                format!("{words}: find out why")
            },
        )
        .qualifying(),
    );
    if bad > 0 && share <= MOST_OUTLIERS {
        checks.push(Check::new("no_outliers", Some(bad as f64), Some(0.0), false, words).qualifying());
    }
    if let Some((copy, first)) = evidence.repeated.first() {
        let words = format!(
            "{} rows are copies of others and count once; the first: {} repeats {}",
            evidence.repeated.len(),
            evidence.recordings.describe(*copy),
            evidence.recordings.describe(*first)
        );
        let count = evidence.repeated.len() as f64;
        checks.push(Check::new("copied_rows", Some(count), Some(0.0), false, words).qualifying());
    }
}

/// What the campaign noted.
fn campaign(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let Some(campaign) = &evidence.recordings.campaign else {
        return;
    };
    if campaign.simulated {
        let words = "SIMULATED: the arm was a simulation; the result says nothing of a real robot".to_owned();
        checks.insert(0, Check::new(REAL_ARM, None, None, false, words).qualifying());
    }
    let recorded = evidence.recordings.experiment.observations.len();
    let lost = campaign.planned.saturating_sub(recorded);
    let mut note = |name, value: f64, limit: f64, words: String| {
        checks.push(Check::new(name, Some(value), Some(limit), value <= limit, words).qualifying());
    };
    note(
        "poses_recorded",
        lost as f64,
        0.0,
        if campaign.given_up.is_empty() {
            format!("{lost} of {} poses were not recorded", campaign.planned)
        } else {
            let given_up = campaign.given_up.iter();
            let names = listed(given_up.map(|(sphere, pose)| format!("pose {pose} (sphere {sphere})")));
            format!("{lost} of {} poses were not recorded: {names}", campaign.planned)
        },
    );
    let worst = campaign.worst_seat_m * 1e3;
    note(
        "seats_held",
        worst,
        DOUBTFUL_SEAT_MM,
        if worst > DOUBTFUL_SEAT_MM {
            let sphere = campaign
                .worst_seat_sphere
                .map_or_else(String::new, |id| format!(" on sphere {id}"));
            format!("the nest{sphere} moved by {worst:.2} mm under the test pull: look at its seat")
        } else {
            format!("the nests moved by {worst:.2} mm at most under the test pull")
        },
    );
    note(
        "faults",
        campaign.faults as f64,
        0.0,
        format!("{} faults on the way, all recovered from", campaign.faults),
    );
}
