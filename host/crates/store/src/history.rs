//! Past calibrations of each arm and their trend: does the arm drift, and when is the next
//! calibration due?
//!
//! Every finished run leaves a *fingerprint*: the TCP positions of its calibrated model, in the
//! robot's own frame, at configurations that depend only on the robot's joint limits, and their
//! uncertainty. Two fingerprints of one arm are aligned by a rigid motion, because the base's frame
//! is a convention. The remaining distance is how far the arm has *moved* between the two
//! calibrations. The arm *drifts* if that distance exceeds three times the combined uncertainty. A
//! straight line through all runs gives the speed. The next calibration is due when an arm at that
//! speed will have moved by the limit since the last calibration.

use std::collections::BTreeMap;

pub(super) use crate::past::HEADLINE;
pub use crate::past::{FINGERPRINT, Fingerprint, StoredPast};
use crate::time::{days, utc};
use crate::{CalibrationStore, StoreError};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

/// How far an arm may move, in mm, before it must be calibrated again, unless the user sets another
/// limit.
pub const LIMIT_MM: f64 = 0.3;
/// Name of the summary among a run's results.
const SUMMARY: &str = "summary";
/// How many times the uncertainty a move must be to count as drift.
const SIGNIFICANT: f64 = 3.0;
/// Days after which a calibration is due if the drift is unknown: the yearly interval of measuring
/// equipment.
const YEAR_DAYS: f64 = 365.0;
/// How far back the clock may be between two runs without being wrong, in days: two computers differ by
/// seconds.
const CLOCK_DAYS: f64 = 0.01;

/// What a list of past calibrations shows of a summary, which itself is a hundred times as long.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct SummaryExtract {
    trusted: Option<bool>,
    recorded: Option<u64>,
    residual_rms_mm: Option<f64>,
    nominal_mm: Option<f64>,
    calibrated_mm: Option<f64>,
}

impl SummaryExtract {
    /// Of a summary as JSON; empty if it is none.
    fn of(summary: &str) -> Self {
        let summary: serde_json::Value = serde_json::from_str(summary).unwrap_or_default();
        let models = &summary["validation"]["models"];
        Self {
            trusted: summary["verdict"]["may_be_used"].as_bool(),
            recorded: summary["poses"]["recorded"].as_u64(),
            residual_rms_mm: summary["residual"]["rms_mm"].as_f64(),
            nominal_mm: models["nominal"]["mean_mm"].as_f64(),
            calibrated_mm: models["sphere"]["mean_mm"].as_f64(),
        }
    }
}

/// Stores the summary of a run, as JSON, so that [`read`] finds it.
///
/// # Errors
/// When the store fails.
pub fn put_summary(store: &mut dyn CalibrationStore, run: i64, json: &str) -> Result<(), StoreError> {
    let headline = serde_json::to_string(&SummaryExtract::of(json)).map_err(|source| StoreError::Decode {
        path: store.path().to_owned(),
        field: "summary",
        source,
    })?;
    store.put_result(run, SUMMARY, json)?;
    store.put_result(run, HEADLINE, &headline)
}

/// One past calibration.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Past {
    /// Number of the run.
    pub run: i64,
    /// When it was begun, UTC.
    pub created_utc: String,
    /// Kind of robot.
    pub robot: String,
    /// Which one; empty where it was not named.
    pub arm: String,
    /// `running`, `measured` or `complete`.
    pub state: String,
    /// Whether its result was to be trusted.
    pub trusted: Option<bool>,
    /// Poses recorded.
    pub recorded: Option<u64>,
    /// Root mean square of its residuals, in mm.
    pub residual_rms_mm: Option<f64>,
    /// Mean TCP error before and after, in mm, if a tracker validated the run.
    pub nominal_mm: Option<f64>,
    /// See `nominal_mm`.
    pub calibrated_mm: Option<f64>,
    /// Its fingerprint.
    #[serde(skip)]
    pub fingerprint: Option<Fingerprint>,
}

/// All calibrations of a store, or those of one arm, oldest first.
///
/// # Errors
/// When the store fails.
pub fn read(store: &mut dyn CalibrationStore, arm: &str) -> Result<Vec<Past>, StoreError> {
    // The fingerprints of a fleet are megabytes of text: each core takes a part.
    let decoded = store.past(arm)?.into_par_iter().map(|run| {
        let headline: Option<SummaryExtract> = run.headline.and_then(|json| serde_json::from_str(&json).ok());
        let headline = headline.unwrap_or_default();
        Past {
            run: run.run,
            created_utc: run.created_utc,
            robot: run.robot,
            arm: run.arm,
            state: run.state,
            trusted: headline.trusted,
            recorded: headline.recorded,
            residual_rms_mm: headline.residual_rms_mm,
            nominal_mm: headline.nominal_mm,
            calibrated_mm: headline.calibrated_mm,
            fingerprint: run.fingerprint.and_then(|json| serde_json::from_str(&json).ok()),
        }
    });
    Ok(decoded.collect())
}

/// Sorts past calibrations by arm, in alphabetical order; those of one arm oldest first.
pub fn by_arm(past: Vec<Past>) -> Vec<Vec<Past>> {
    let mut arms: BTreeMap<(String, String), Vec<Past>> = BTreeMap::new();
    for run in past {
        arms.entry((run.robot.clone(), run.arm.clone())).or_default().push(run);
    }
    arms.into_values().collect()
}

/// One point of a trend.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TrendPoint {
    /// Number of the run.
    pub run: i64,
    /// Days since the first run of the trend.
    pub days: f64,
    /// How far the arm had moved since the first run, in mm.
    pub moved_mm: f64,
    /// And since the run before.
    pub moved_since_last_mm: f64,
    /// Combined uncertainty of both calibrations, in mm (1 sigma).
    pub sigma_mm: f64,
}

/// Trend of the calibrations of one arm.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Trend {
    /// Kind of robot.
    pub robot: String,
    /// Which one.
    pub arm: String,
    /// Trusted runs in the order of time. The others are compared with the first.
    pub steps: Vec<TrendPoint>,
    /// Whether the arm has moved by more than the calibrations' own uncertainty.
    pub drifting: bool,
    /// Whether the calibrations could have shown a move by the limit: there are two at least, and
    /// three times their uncertainty is within the limit. Without it, no drift means nothing.
    pub can_tell: bool,
    /// Slope of the straight line through all moves, in mm per year; `None` if all runs are from
    /// one day.
    pub mm_per_year: Option<f64>,
    /// Move at which a calibration is due, in mm.
    pub limit_mm: f64,
    /// Day on which the next calibration is due, UTC, after the last run.
    pub due_utc: Option<String>,
    /// A run that is dated before the one that was measured before it: a clock was wrong. Then neither
    /// a slope nor a date is stated.
    pub clock_back_at: Option<i64>,
}

impl Trend {
    /// Whether the next calibration is due at the time `now_utc` (RFC 3339). Where no date can be stated it is.
    pub fn is_due(&self, now_utc: &str) -> bool {
        let due = self.due_utc.as_deref().and_then(days);
        due.zip(days(now_utc)).is_none_or(|(due, now)| due <= now)
    }
}

/// The trends of all arms, in alphabetical order. An arm without a trusted calibration has none.
pub fn trends(past: Vec<Past>, limit_mm: f64) -> Vec<Trend> {
    by_arm(past).par_iter().filter_map(|own| trend(own, limit_mm)).collect()
}

/// The trend of one arm from its past runs, oldest first.
pub fn trend(past: &[Past], limit_mm: f64) -> Option<Trend> {
    let useful: Vec<(&Past, &Fingerprint, f64)> = past
        .iter()
        .filter(|p| p.trusted == Some(true))
        .filter_map(|p| Some((p, p.fingerprint.as_ref()?, days(&p.created_utc)?)))
        .collect();
    let (first, first_print, begun) = *useful.first()?;
    let mut steps: Vec<TrendPoint> = Vec::new();
    let mut before = first_print;
    for (run, print, day) in &useful {
        let sigma_mm = if run.run == first.run {
            first_print.sigma_mm
        } else {
            print.sigma_mm.hypot(first_print.sigma_mm)
        };
        steps.push(TrendPoint {
            run: run.run,
            days: day - begun,
            moved_mm: print.moved_mm(first_print)?,
            moved_since_last_mm: print.moved_mm(before)?,
            sigma_mm,
        });
        before = print;
    }
    let back = steps.windows(2).find(|pair| pair[1].days < pair[0].days - CLOCK_DAYS);
    let clock_back_at = back.map(|pair| pair[1].run);
    let last = steps.last()?;
    let drifting = last.moved_mm > SIGNIFICANT * last.sigma_mm;
    let can_tell = drifting || (steps.len() > 1 && SIGNIFICANT * last.sigma_mm <= limit_mm);
    // A line through the origin: the first run has not moved relative to itself.
    let (product, square) = steps.iter().fold((0.0, 0.0), |(p, s), step| {
        (p + step.days * step.moved_mm, s + step.days * step.days)
    });
    // Runs of one day do not determine a speed.
    let per_day = (last.days >= 1.0 && clock_back_at.is_none()).then(|| product / square);
    let until = match per_day {
        // The last calibration has corrected all movement until then.
        Some(speed) if drifting && speed > 0.0 => (limit_mm / speed).min(YEAR_DAYS),
        _ => YEAR_DAYS,
    };
    Some(Trend {
        robot: first.robot.clone(),
        arm: first.arm.clone(),
        drifting,
        can_tell,
        mm_per_year: per_day.map(|speed| speed * YEAR_DAYS),
        limit_mm,
        due_utc: clock_back_at
            .is_none()
            .then(|| utc(((begun + last.days + until) * 86_400.0).max(0.0) as u64)),
        clock_back_at,
        steps,
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::past::POINTS;
    use nalgebra::{Rotation3, Vector3};
    use spherecal_model::halton::halton;

    fn print(stretch: f64, turn: f64) -> Fingerprint {
        let turn = Rotation3::from_euler_angles(turn, -turn, 2.0 * turn);
        let points = (1..=POINTS).map(|k| {
            let p = Vector3::new(halton(k, 0), halton(k, 1), halton(k, 2) * (1.0 + stretch));
            (turn * p + Vector3::new(turn.angle(), 0.3, -0.1)).into()
        });
        Fingerprint {
            points_m: points.collect(),
            sigma_mm: 0.05,
        }
    }

    fn past(run: i64, created_utc: &str, fingerprint: Fingerprint) -> Past {
        Past {
            run,
            created_utc: created_utc.to_owned(),
            robot: "iiwa7".to_owned(),
            arm: "7".to_owned(),
            state: "complete".to_owned(),
            trusted: Some(true),
            recorded: None,
            residual_rms_mm: None,
            nominal_mm: None,
            calibrated_mm: None,
            fingerprint: Some(fingerprint),
        }
    }

    // Fails if a rigid motion counts as a move of the arm, or if a change of its shape does not.
    #[test]
    fn only_the_shape_counts() {
        assert!(print(0.0, 0.0).moved_mm(&print(0.0, 0.7)).expect("comparable") < 1e-9);
        let moved = print(0.0, 0.0).moved_mm(&print(0.004, 0.7)).expect("comparable");
        // A stretch by s along z moves points by s times their distance from the middle, which is
        // 0.25 on average.
        assert!((0.8..1.2).contains(&moved), "{moved}");
        assert_eq!(print(0.0, 0.0).moved_mm(&Fingerprint::default()), None);
    }

    // Fails if a clock that was set back by two years gives a slope, a date, or no word.
    #[test]
    fn a_clock_that_was_set_back_is_named() {
        let runs = [
            past(1, "2026-01-01T00:00:00Z", print(0.0, 0.1)),
            past(2, "2024-01-01T00:00:00Z", print(0.002, 0.2)),
            past(3, "2026-03-01T00:00:00Z", print(0.004, 0.3)),
        ];
        let t = trend(&runs, 1.0).expect("a trend");
        assert_eq!(
            (t.clock_back_at, t.mm_per_year, t.due_utc.as_deref()),
            (Some(2), None, None)
        );
        let t = trend(&runs[1..], 1.0).expect("a trend");
        assert!(t.clock_back_at.is_none() && t.due_utc.is_some(), "{t:?}");
    }

    // Fails if a calibration is due a second too early or too late, by the place's clock or by UTC, or if an arm of which
    // no date can be stated is passed over.
    #[test]
    fn a_calibration_is_due_from_its_date_on() {
        let runs = [
            past(1, "2025-01-01T00:00:00Z", print(0.0, 0.1)),
            past(2, "2025-07-01T00:00:00Z", print(0.0, 0.2)),
            past(3, "2024-07-01T00:00:00Z", print(0.0, 0.3)),
        ];
        let [dated, undated] = [&runs[..2], &runs[..]].map(|runs| trend(runs, 1.0).expect("a trend"));
        assert_eq!(dated.due_utc.as_deref(), Some("2026-07-01T00:00:00Z"));
        assert!(!dated.is_due("2026-06-30T23:59:59Z") && dated.is_due("2026-07-01T00:00:00Z"));
        assert!(dated.is_due("2026-07-01T01:30:00+01:00") && !dated.is_due("2026-07-01T00:30:00+01:00"));
        assert!(undated.is_due("2024-01-01T00:00:00Z"));
    }

    // Fails if noise counts as drift, if drift is missed, if "no drift" is said where the limit could not
    // be seen, or if the due date is not where the line
    // reaches the limit.
    #[test]
    fn drift_is_told_from_noise_and_dated() {
        let steady = [
            past(1, "2026-01-01T00:00:00Z", print(0.0, 0.1)),
            past(2, "2026-07-01T00:00:00Z", print(0.0002, 0.2)),
        ];
        let t = trend(&steady, 0.5).expect("a trend");
        assert!(!t.drifting && t.can_tell, "{t:?}");
        // 3 sigma of both together is 0.212 mm: a smaller limit could have been passed unseen.
        let t = trend(&steady, 0.2).expect("a trend");
        assert!(!t.drifting && !t.can_tell, "{t:?}");
        // One calibration says nothing of a move.
        assert!(!trend(&steady[..1], 0.5).expect("a trend").can_tell);
        assert_eq!(t.due_utc.as_deref(), Some("2027-07-01T00:00:00Z"));

        let drifting = [
            past(1, "2026-01-01T00:00:00Z", print(0.0, 0.1)),
            past(2, "2026-01-11T00:00:00Z", print(0.002, 0.2)),
            past(3, "2026-01-21T00:00:00Z", print(0.004, 0.3)),
        ];
        let t = trend(&drifting, 1.0).expect("a trend");
        assert!(t.drifting && t.can_tell);
        let per_day = t.mm_per_year.expect("a speed") / 365.0;
        assert!((0.04..0.06).contains(&per_day), "{per_day}");
        let due = days(t.due_utc.as_deref().expect("due")).expect("a date");
        let until = due - days("2026-01-21T00:00:00Z").expect("a date");
        assert!((until - 1.0 / per_day).abs() < 0.01, "{until}");
        assert!(trend(&[], 1.0).is_none());
    }
}
