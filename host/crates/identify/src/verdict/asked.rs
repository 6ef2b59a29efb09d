//! Checks of the stated error: by the accuracy that was asked for, and by rows that were
//! measured apart.

use spherecal_model::statistics::median;

use super::{Check, Evidence, Expected};
use crate::hierarchy::constants::SURE;

/// A validation whose median error is beyond this many times the error that 95 % of the
/// rows should stay under contradicts the statement: another frame, tool or arm.
const CONTRADICTS: f64 = 3.0;
/// Least median error (mm) that contradicts: below it the instrument itself may be meant.
const LEAST_CONTRADICTION_MM: f64 = 0.5;
/// The same for one that only qualifies: the statement is too good.
const TOO_GOOD: f64 = 1.0;

/// Whether the result is as good as was asked for.
pub(super) fn asked_accuracy(evidence: &Evidence<'_>, expected: Option<&Expected>, checks: &mut Vec<Check>) {
    let Some(asked) = evidence.accuracy_mm else { return };
    // Like the expected error, that of the arm's shape: where the base stands is not in it.
    let by_instrument = evidence
        .table
        .and_then(|t| t.model("sphere"))
        .map(|m| m.best_fit.mean_mm);
    let (mean, by) = match (by_instrument, expected) {
        (Some(mean), _) => (mean, "on the independent instrument's points, the base fitted to them"),
        (None, Some(e)) => (e.own.mean, "expected over the work region"),
        (None, None) => {
            let words = "the accuracy that was asked for cannot be checked: the expected error is unknown".to_owned();
            checks.push(Check::new("asked_accuracy", None, Some(asked), false, words));
            return;
        }
    };
    let met = mean <= asked;
    let words = if met {
        format!("a mean error of {asked:.3} mm was asked for, and it is {mean:.3} mm {by}")
    } else {
        format!(
            "a mean error of {asked:.3} mm was asked for, but it is {mean:.3} mm {by}: measure more poses, on more \
             spheres and over a wider range of joint angles"
        )
    };
    checks.push(Check::new("asked_accuracy", Some(mean), Some(asked), met, words));
    if let (None, Some(sure)) = (by_instrument, expected.and_then(|e| e.asked)) {
        let words = format!("the mean error is below {asked:.3} mm with a probability of {sure:.3}");
        checks.push(Check::new(
            "asked_accuracy_sure",
            Some(sure),
            Some(SURE),
            sure >= SURE,
            words,
        ));
    }
}

/// Whether rows that were measured apart agree with the stated error.
pub(super) fn validation_agrees(evidence: &Evidence<'_>, expected: Option<&Expected>, checks: &mut Vec<Check>) {
    if let Some(off) = evidence.realigned_mm {
        let words = format!(
            "the validation points stand {off:.0} mm from their frame as a whole; this was taken out, so they judge the \
             shape of the arm and not where it stands"
        );
        checks.push(Check::new("validation_frame", Some(off), None, false, words).qualifying());
    }
    if evidence.cross_validated {
        return;
    }
    let (Some(judged), Some(expected)) = (evidence.judged, expected.map(|e| e.own)) else {
        return;
    };
    let Some(model) = judged.model("calibrated") else {
        return;
    };
    if model.samples.is_empty() {
        return;
    }
    let median = median(model.samples.iter().map(|s| s.distance_mm).collect());
    let limit = (CONTRADICTS * expected.measured.p95).max(LEAST_CONTRADICTION_MM);
    let agrees = median <= limit;
    let stated = format!(
        "the validation rows are {median:.3} mm off (median), and 95 % of such rows should stay below {:.3} mm",
        expected.measured.p95
    );
    let words = if agrees {
        stated.clone()
    } else {
        format!(
            "{stated}: they contradict the calibration; check that they are of this arm with this tool, in this frame, \
             and measured after no change to either"
        )
    };
    checks.push(Check::new(
        "validation_agrees",
        Some(median),
        Some(limit),
        agrees,
        words,
    ));
    let too_good = TOO_GOOD * expected.measured.p95;
    if agrees && median > too_good {
        let words = format!("{stated}: trust the validation, not the expected error");
        checks.push(Check::new("expected_error_confirmed", Some(median), Some(too_good), false, words).qualifying());
    }
}
