//! Checks of the residuals: which causes the data name, and whether the result is better
//! than the nominal robot over the whole workspace.

use super::{Check, Evidence};
use crate::diagnosis::{Diagnosis, Family, Finding, ScatteredPlace, has_heavy_tails};
use crate::evaluate::OwnSeat;

/// A cause that adds less than this share of the expected error qualifies the result: it
/// is named, and the expected error holds it. One that adds more refuses the result, if it is certain.
const HARMLESS: f64 = 0.5;
/// The same in mm: less than the repeatability of any arm.
const HARMLESS_MM: f64 = 0.01;
/// What makes a cause certain enough to refuse a result whose errors are not normal: its chance, as a logarithm to the
/// base 10, or its size in its own standard deviations. The chance is that of normal errors: nests that seat badly make
/// chances of 2e-9 in sound robots, with sizes of up to 7.3 standard deviations. See `docs/theory.md`.
const CERTAIN_LOG10_P: f64 = -10.0;
const CERTAIN_SIZE: f64 = 8.0;
/// What is said of such a cause.
const DOUBTFUL: &str = "the errors are not normal, so it may also be chance; the expected error holds it";
/// What is said of a load that only the priors of the compliance tell from chance.
const MAY_BE_CHANCE: &str = "it may also be chance; the expected error holds it";
/// The chance, as a logarithm to the base 10, up to which a load is certain where the errors are normal: that of all
/// other causes together. A load is named from a larger one on.
const CERTAIN_LOAD_LOG10_P: f64 = -3.0;
/// Largest chance that the result is no better than the nominal robot. Set after the real
/// data of the iiwa 14 were seen, where it is 0.044: see `docs/theory.md`.
const NOT_BETTER: f64 = 0.05;
/// Noise of one pose, in mm, beyond which these are not data of this robot: data sheets
/// state repeatabilities of 0.1 mm and less (ISO 9283), and gears ripple by some tenths.
const MOST_NOISE_MM: f64 = 1.0;
/// Sigmas of its prior that a parameter may move before it is mentioned.
const FAR_SIGMAS: f64 = 4.0;
/// Sigmas of its prior that a length or twist of a link may move: beyond this the arm is
/// not the one described.
const OTHER_ARM_SIGMAS: f64 = 10.0;
/// What was done about rows that sat elsewhere, and what to do.
const SEATED: &str = "the fit gives them seats of their own, so that they tell less: clean nest and sphere";
/// Rows that are named of a cause that concerns many.
const NAMED_ROWS: usize = 2;
/// Other causes that are named beside a seat.
const NAMED_OTHERS: usize = 3;

/// Adds the checks of the diagnosis, where there is one.
pub(super) fn diagnosed(evidence: &Evidence<'_>, checks: &mut Vec<Check>) {
    let Some(diagnosis) = evidence.diagnosis else { return };
    causes(evidence, diagnosis, checks);
    places(diagnosis, checks);
    over_the_workspace(evidence, diagnosis, checks);
    this_robot(diagnosis, checks);
    spheres(evidence, checks);
}

/// One check for each family of causes.
fn causes(evidence: &Evidence<'_>, diagnosis: &Diagnosis, checks: &mut Vec<Check>) {
    let harmless = (HARMLESS * diagnosis.drawn_mm).max(HARMLESS_MM);
    let normal = !has_heavy_tails(evidence.calibration.heavy_tails) && evidence.seats.is_empty();
    let seats = !evidence.seats.is_empty();
    let doubt = |f: &Finding| doubt(f.alternative.family(), f.log10_p, f.size.abs() / f.sigma, normal, seats);
    let described = |f: &Finding| {
        let words = in_words(evidence, f);
        match doubt(f) {
            None => words,
            Some(doubt) => format!("{words} ({doubt})"),
        }
    };
    for test in &diagnosis.families {
        let (name, sound) = match test.family {
            Family::Certificate => ("certificate", "every sphere is where its certificate says"),
            Family::CertificateScale => (
                "certificate_scale",
                "the certificate's distances fit the robot's lengths",
            ),
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
            Family::Orientation => (
                "tool_orientation",
                "the target does not depend on the tool's orientation",
            ),
        };
        let of_family = |f: &&Finding| f.alternative.family() == test.family;
        let found: Vec<&Finding> = diagnosis.findings.iter().filter(of_family).collect();
        let own: &[OwnSeat] = match test.family {
            Family::Seat => evidence.seats,
            _ => &[],
        };
        let words = if !own.is_empty() {
            let seats: Vec<String> = own.iter().map(|seat| seated(evidence, seat)).collect();
            let rest = found.iter().map(|f| described(f));
            let count: usize = own.iter().map(|seat| seat.rows.len()).sum();
            let seats = format!("the nest sat elsewhere in {count} rows: {}; {SEATED}", seats.join("; "));
            std::iter::once(seats).chain(rest).collect::<Vec<_>>().join("; ")
        } else if found.is_empty() {
            let strength = format!("strongest of {} tests: {:.1} sigma", test.tested, test.sigmas);
            if test.sigmas > test.limit {
                format!("{sound} as far as can be told: another cause explains the data better ({strength})")
            } else {
                format!("{sound} ({strength})")
            }
        } else {
            let each: Vec<String> = found.iter().map(|f| described(f)).collect();
            each.join("; ")
        };
        let sound = found.is_empty() && own.is_empty();
        let sigmas = own.iter().filter_map(|seat| seat.sigmas).fold(test.sigmas, f64::max);
        let check = Check::new(name, Some(sigmas), Some(test.limit), sound, words);
        let refuses = found.iter().any(|f| f.harm_mm >= harmless && doubt(f).is_none());
        checks.push(if refuses { check } else { check.qualifying() });
    }
}

/// Why a cause only qualifies a result, however much it moves the TCP; none of one that is certain. `sizes` is its size in its
/// own standard deviations, `normal` whether the errors are normal, `seats` whether rows have seats of their own.
fn doubt(family: Family, log10_p: f64, sizes: f64, normal: bool, seats: bool) -> Option<&'static str> {
    let certain = match family {
        Family::Payload if normal && log10_p > CERTAIN_LOAD_LOG10_P => return Some(MAY_BE_CHANCE),
        _ if normal => true,
        // It is held against the lengths of the links, and not against the scatter of the rows.
        Family::CertificateScale => true,
        // Where rows have seats of their own, one more qualifies as they do.
        Family::Seat if seats => false,
        _ => sizes >= CERTAIN_SIZE || log10_p <= CERTAIN_LOG10_P,
    };
    (!certain).then_some(DOUBTFUL)
}

/// Whether no place scatters more than the others.
fn places(diagnosis: &Diagnosis, checks: &mut Vec<Check>) {
    let Some(worst) = diagnosis.scattered.first() else {
        return;
    };
    let each = diagnosis.scattered.iter();
    let words: Vec<String> = each
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

/// A cause with the rows that it concerns, what it does, and what to do about it.
fn in_words(evidence: &Evidence<'_>, finding: &Finding) -> String {
    let rows: Vec<usize> = finding
        .rows
        .iter()
        .filter_map(|k| evidence.used.get(*k).copied())
        .collect();
    format!(
        "{}{}, p = {} ({:.1} sigma); it moves the calibrated TCP by {:.3} mm in the mean{}: {}",
        finding.words,
        in_rows(evidence, &rows),
        probability(finding.log10_p),
        finding.sigmas,
        finding.harm_mm,
        or(&finding.or),
        finding.next
    )
}

/// A seat that some rows have for themselves in the fit: how far off, in which rows, and what speaks for it.
fn seated(evidence: &Evidence<'_>, seat: &OwnSeat) -> String {
    let [x, y, z] = seat.offset_mm;
    let by = match seat.sigmas {
        Some(sigmas) => format!("{sigmas:.1} sigma"),
        None => "rest of that coupling".to_owned(),
    };
    format!(
        "{:.3} ± {:.3} mm{}, {by}{}",
        (x * x + y * y + z * z).sqrt(),
        seat.sigma_mm,
        in_rows(evidence, &seat.rows),
        or_few(&seat.or)
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

/// What else explains the same data; of many the first few, and how many more.
fn or_few(others: &[String]) -> String {
    let few: Vec<String> = others.iter().take(NAMED_OTHERS).cloned().collect();
    match others.len().saturating_sub(NAMED_OTHERS) {
        0 => or(&few),
        more => format!("{} and {more} more", or(&few)),
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

/// Whether the calibrated robot is better than the nominal one over the workspace.
fn over_the_workspace(evidence: &Evidence<'_>, diagnosis: &Diagnosis, checks: &mut Vec<Check>) {
    let nominal = evidence.nominal();
    let calibrated_tcp = |q: &[f64]| evidence.calibration.tcp_m(q, None);
    let nominal_tcp = |q: &[f64]| nominal.pose(q).position;
    let calibrated = diagnosis.expected_error_of(calibrated_tcp);
    let before = diagnosis.expected_error_of(nominal_tcp);
    let chance = diagnosis.chance_not_better(calibrated_tcp, nominal_tcp);
    let comparison = format!(
        "expected error over the workspace {:.3} mm (95 % interval {:.3} to {:.3} mm), {:.3} mm for the nominal robot",
        calibrated.mean, calibrated.interval[0], calibrated.interval[1], before.mean
    );
    let better = chance <= NOT_BETTER;
    let words = if better {
        comparison
    } else {
        format!(
            "{comparison}: in {:.0} % of the cases that the data allow it is no better; measure more poses, on more \
             spheres and over a wider range of joint angles",
            chance * 100.0
        )
    };
    checks.push(Check::new(
        "better_over_the_workspace",
        Some(chance),
        Some(NOT_BETTER),
        better,
        words,
    ));
}

/// Whether the rows are those of the robot that was described.
fn this_robot(diagnosis: &Diagnosis, checks: &mut Vec<Check>) {
    let noise = diagnosis.noise_mm;
    let plausible = noise <= MOST_NOISE_MM;
    let words = if plausible {
        format!("the noise of one pose is {noise:.3} mm")
    } else {
        format!(
            "the poses scatter by {noise:.1} mm about the best model: check that robot, tool, plate and units are those \
             of these data; give --uncalibrated for an arm that was never calibrated"
        )
    };
    checks.push(Check::new(
        "noise_mm",
        Some(noise),
        Some(MOST_NOISE_MM),
        plausible,
        words,
    ));
    let Some(moved) = &diagnosis.moved else { return };
    let words = format!("{} moved furthest, {:.1} sigma of its prior", moved.name, moved.sigmas);
    let near = moved.sigmas <= FAR_SIGMAS;
    let other_arm = moved.shape && moved.sigmas > OTHER_ARM_SIGMAS;
    let check = Check::new(
        "parameters_near_nominal",
        Some(moved.sigmas),
        Some(if other_arm { OTHER_ARM_SIGMAS } else { FAR_SIGMAS }),
        near,
        if near {
            words
        } else {
            format!("{words}: check that the robot's description is that of this arm")
        },
    );
    checks.push(if other_arm { check } else { check.qualifying() });
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

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a load that some sound robots show refuses a result, if one that is certain does not, if another
    // cause is held to the load's limit, or if any but the scale is certain in errors that are not normal before it is far off.
    #[test]
    fn what_may_be_chance_refuses_nothing() {
        let normal = |family, log10_p| doubt(family, log10_p, 3.0, true, false);
        assert_eq!(normal(Family::Payload, -2.5), Some(MAY_BE_CHANCE));
        assert_eq!(normal(Family::Payload, -3.5), None);
        assert_eq!(normal(Family::Slip, -2.5), None);
        let heavy = |family, log10_p, sizes| doubt(family, log10_p, sizes, false, true);
        for family in [Family::Payload, Family::Slip] {
            assert_eq!(heavy(family, -9.0, 7.9), Some(DOUBTFUL));
            assert_eq!(heavy(family, -9.0, 8.1), None);
            assert_eq!(heavy(family, -10.5, 3.0), None);
        }
        assert_eq!(heavy(Family::CertificateScale, -2.5, 3.0), None);
        assert_eq!(heavy(Family::Seat, -12.0, 9.0), Some(DOUBTFUL));
    }
}
