//! Checks of the posterior: which causes the data name, and whether the result is better
//! than the nominal robot over the work region.

use super::{Check, Evidence, Expected};
use crate::causes::{Alternative, Family, Finding, ScatteredPlace};
use crate::hierarchy::constants::{NEGLIGIBLE, SCALE_SIGMAS, SURE};

/// Rows that are named of a cause that concerns many.
const NAMED_ROWS: usize = 2;
/// What is done about a cause.
const TAKEN: &str = "The fit and the stated error hold it";

/// Adds the checks.
pub(super) fn diagnosed(evidence: &Evidence<'_>, expected: Option<&Expected>, checks: &mut Vec<Check>) {
    let Some(expected) = expected else { return };
    over_the_work_region(expected, checks);
    causes(evidence, expected, checks);
    places(evidence, checks);
    scale(evidence, checks);
    spheres(evidence, checks);
}

/// One check for each family of causes. What is named is a part of the fit, so it only qualifies the result, and what would
/// not matter without being a part of it is not even a remark, unless the rows of a whole place hardly count for it.
fn causes(evidence: &Evidence<'_>, expected: &Expected, checks: &mut Vec<Check>) {
    for test in &evidence.causes.families {
        let (name, sound) = match test.family {
            Family::Certificate => ("certificate", "every sphere is where its certificate says"),
            Family::Slip => ("plate_slip", "the plate (or tracker) did not slip"),
            Family::Drift => ("plate_drift", "the plate (or tracker) did not drift"),
            Family::SphereMoved => ("sphere_moved", "no sphere moved between couplings"),
            Family::Seat => ("coupling_seat", "every coupling was seated like the others"),
            Family::Encoder => ("encoder", "no encoder jumped or drifted"),
            Family::JointRegion => ("joint_region", "no joint is off in a part of its range"),
            Family::Lag => ("read_at_rest", "the angles were read at rest"),
            Family::Backlash => ("backlash", "no joint's error depends on the side that it came from"),
            Family::Place => ("place", "no place is off as a whole"),
            Family::Payload => ("payload", "the load at the flange is as stated"),
        };
        let of_family = |f: &&Finding| f.alternative.family() == test.family;
        let found: Vec<&Finding> = evidence.causes.findings.iter().filter(of_family).collect();
        let words = if found.is_empty() {
            let strength = format!("strongest of {} tests: {:.1} sigma", test.tested, test.sigmas);
            if test.sigmas > test.limit {
                format!("{sound}; another cause explains the data better ({strength})")
            } else {
                format!("{sound} ({strength})")
            }
        } else {
            let each: Vec<String> = found.iter().map(|f| in_words(evidence, f)).collect();
            each.join("; ")
        };
        let harm = found.iter().map(|f| f.harm_mm).fold(0.0, f64::max);
        let weight = harm / expected.own.mean;
        let hardly_counts = |f: &&Finding| evidence.causes.scattered.iter().any(|p| is_off(f, p));
        let sound = weight < NEGLIGIBLE && !found.iter().any(hardly_counts);
        let check = Check::new(name, Some(test.sigmas), Some(test.limit), sound, words);
        checks.push(check.qualifying().weighing(weight));
    }
}

/// Whether a finding says that the place which scatters is off as a whole.
fn is_off(finding: &Finding, scattered: &ScatteredPlace) -> bool {
    matches!(finding.alternative, Alternative::Place { place, .. } if place == scattered.place)
}

/// Whether no place scatters more than the others, those apart that are off as a whole.
fn places(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let off = |p: &ScatteredPlace| evidence.causes.findings.iter().any(|f| is_off(f, p));
    let scattered: Vec<&ScatteredPlace> = evidence.causes.scattered.iter().filter(|p| !off(p)).collect();
    let Some(worst) = scattered.first() else {
        return;
    };
    let words: Vec<String> = scattered
        .iter()
        .map(|p| format!("{} (p = {})", p.words, probability(p.log10_p)))
        .collect();
    checks.push(
        Check::new(
            "place_scatter",
            Some(worst.ratio),
            Some(ScatteredPlace::LIMIT),
            false,
            words.join("; "),
        )
        .qualifying(),
    );
}

/// Whether the scale of the instrument or the certificate is right.
fn scale(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let all = &evidence.calibration.parameters;
    let Some(scale) = all.iter().find(|p| p.name == "scale" && p.free && p.sigma > 0.0) else {
        return;
    };
    let sigmas = (scale.estimate / scale.sigma).abs();
    let (of, next) = if evidence.recordings.closed_loop() {
        (
            "the certificate's",
            "compare the plate file with its certificate: units, temperature, distances",
        )
    } else {
        ("the instrument's", "compare its units, temperature and settings")
    };
    let found = format!(
        "{:+.2} ± {:.2} parts per thousand",
        scale.estimate * 1e3,
        scale.sigma * 1e3
    );
    let right = sigmas <= SCALE_SIGMAS;
    let words = if right {
        format!("{of} scale is right ({found})")
    } else {
        format!("{of} scale is wrong: {found} ({sigmas:.1} sigma). {TAKEN}: {next}")
    };
    checks.push(Check::new("scale", Some(sigmas), Some(SCALE_SIGMAS), right, words).qualifying());
}

/// A cause with the rows that it concerns, what it does, and what to do about it.
fn in_words(evidence: &Evidence<'_>, finding: &Finding) -> String {
    let rows: Vec<usize> = finding
        .rows
        .iter()
        .filter_map(|k| evidence.used.get(*k).copied())
        .collect();
    format!(
        "{}{}, p = {} ({:.1} sigma); without it in the fit the TCP would be {:.3} mm off in the mean{}. {TAKEN}: {}",
        finding.words,
        in_rows(evidence, &rows),
        probability(finding.log10_p),
        finding.sigmas,
        finding.harm_mm,
        or(&finding.or),
        finding.next
    )
}

/// The rows of the recordings that show a cause.
fn in_rows(evidence: &Evidence<'_>, rows: &[usize]) -> String {
    let name = |i: &usize| evidence.recordings.describe(*i);
    match rows {
        [] => String::new(),
        few if few.len() <= NAMED_ROWS => {
            let names: Vec<String> = few.iter().map(name).collect();
            format!(" (in {})", names.join(" and "))
        }
        [first, .., last] => format!(" (in {} rows, from {} to {})", rows.len(), name(first), name(last)),
        [one] => format!(" (in {})", name(one)),
    }
}

/// What else explains the same data.
fn or(others: &[String]) -> String {
    if others.is_empty() {
        return String::new();
    }
    format!("; the data cannot tell it from: {}", others.join(", "))
}

/// A probability by its logarithm to the base 10, in words.
pub(super) fn probability(log10_p: f64) -> String {
    if log10_p > -2.0 {
        return format!("{:.2}", 10f64.powf(log10_p));
    }
    let exponent = log10_p.floor();
    format!("{:.0}e{exponent:.0}", 10f64.powf(log10_p - exponent))
}

/// Whether the calibrated robot is better than the nominal one over the work region, surely.
fn over_the_work_region(expected: &Expected, checks: &mut Vec<Check>) {
    let (own, before, sure) = (expected.own, expected.nominal, expected.better);
    let words = format!(
        "expected error over the work region {:.3} mm (95 % interval {:.3} to {:.3} mm), {:.3} mm for the nominal robot: \
         better with a probability of {sure:.3}",
        own.mean, own.interval[0], own.interval[1], before.mean
    );
    let better = sure >= SURE;
    let words = if better {
        words
    } else {
        format!("{words}; measure more poses over a wider range of joint angles")
    };
    checks.push(Check::new(
        "better_over_the_work_region",
        Some(sure),
        Some(SURE),
        better,
        words,
    ));
}

/// Whether there are enough spheres to tell the scale.
fn spheres(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    if !evidence.recordings.closed_loop() {
        return;
    }
    let seen: std::collections::BTreeSet<(u32, u32)> = evidence
        .used
        .iter()
        .filter_map(|&i| match evidence.recordings.experiment.observations.get(i)?.target {
            crate::Target::Sphere { sphere, place } => Some((place, sphere)),
            _ => None,
        })
        .collect();
    let most = seen
        .iter()
        .map(|(place, _)| seen.iter().filter(|s| s.0 == *place).count())
        .max()
        .unwrap_or(0);
    let enough = most >= 2;
    let words = if enough {
        format!("{most} spheres of one placement were touched: their distances give the scale")
    } else {
        "contacts with one sphere cannot tell the scale of the arm: touch at least two of one placement".to_owned()
    };
    checks.push(Check::new(
        "scale_observed",
        Some(most as f64),
        Some(2.0),
        enough,
        words,
    ));
}
