//! What a step measures, and whether it is within its limit.

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::Statistics;

use super::{StepEnd, StepReport};

/// Whether a figure is within its limit.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Judgement {
    /// It is.
    Within,
    /// It is not, or it is not a number.
    Beyond,
    /// It has no limit: it is for the person to read.
    Shown,
    /// It could not be measured.
    CannotTell,
}

/// A measured value with its unit and its limit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Figure {
    /// What it is.
    pub name: String,
    /// The value; none if it could not be measured.
    pub value: Option<f64>,
    /// Unit of value and limit.
    pub unit: String,
    /// Largest magnitude that is accepted; none if nothing is judged.
    pub limit: Option<f64>,
}

impl Figure {
    /// A value with the largest magnitude that is accepted.
    pub(crate) fn judged(name: impl Into<String>, value: f64, unit: &str, limit: f64) -> Self {
        Self {
            name: name.into(),
            value: Some(value),
            unit: unit.to_owned(),
            limit: Some(limit),
        }
    }

    pub(crate) fn shown(name: impl Into<String>, value: f64, unit: &str) -> Self {
        Self {
            name: name.into(),
            value: Some(value),
            unit: unit.to_owned(),
            limit: None,
        }
    }

    /// What could not be measured.
    pub(crate) fn unknown(name: impl Into<String>, unit: &str) -> Self {
        Self {
            name: name.into(),
            value: None,
            unit: unit.to_owned(),
            limit: None,
        }
    }

    /// Whether it is within its limit.
    pub fn judgement(&self) -> Judgement {
        match (self.value, self.limit) {
            (None, _) => Judgement::CannotTell,
            (Some(_), None) => Judgement::Shown,
            // A NaN is within no limit.
            (Some(value), Some(limit)) if value.abs() <= limit => Judgement::Within,
            _ => Judgement::Beyond,
        }
    }
}

/// Name of the figure of [`punctuality`].
const MISSED: &str = "control periods without a state";

/// The share of the control periods between two statistics that had no state of the robot; none if no cycle ran between
/// them.
pub(super) fn punctuality(before: &Statistics, after: &Statistics, limit: f64) -> Option<Figure> {
    // Both counters begin again with the controller.
    let ticks = after.ticks.checked_sub(before.ticks).filter(|ticks| *ticks > 0)?;
    let missed = after.missed.checked_sub(before.missed)?;
    let share = f64::from(missed) / ticks as f64;
    Some(Figure::judged(MISSED, share * 100.0, "%", limit * 100.0))
}

/// The report, with a word on lateness where a step did not pass and the controller was late in it.
pub(super) fn late(mut report: StepReport) -> StepReport {
    let missed = report
        .figures
        .iter()
        .find(|figure| figure.name == MISSED)
        .and_then(|f| f.value);
    if report.verdict == StepEnd::Failed && missed.is_some_and(|missed| missed > 0.0) {
        report.remarks.push(
            "The controller was late: some control periods had no state of the robot. The last torque acts on in them, so a \
             joint may have become too fast. Let this computer do nothing else, see `spherecal doctor --realtime`, and \
             begin again."
                .to_owned(),
        );
    }
    report
}

#[cfg(test)]
mod tests {
    use super::super::CommissioningStep;
    use super::*;

    fn counted(ticks: u64, missed: u32) -> Statistics {
        Statistics {
            ticks,
            missed,
            ..Statistics::default()
        }
    }

    // Fails if late periods of an earlier step count, if a step that was late passes or does not say so, or if a counter
    // that began again gives a figure.
    #[test]
    fn a_late_controller_is_told() {
        let step = CommissioningStep::FreeMotion;
        for (missed, verdict, remarks) in [
            (100, StepEnd::Passed, 0),
            (101, StepEnd::Passed, 0),
            (150, StepEnd::Failed, 2),
        ] {
            let figure = punctuality(&counted(5000, 100), &counted(7000, missed), 0.02).expect("cycles ran");
            let report = late(StepReport::of(step, vec![figure], Vec::new()));
            assert_eq!((report.verdict, report.remarks.len()), (verdict, remarks), "{report:?}");
        }
        let beyond = Figure::judged("x", 2.0, "N", 1.0);
        let on_time = late(StepReport::of(step, vec![beyond], Vec::new()));
        assert_eq!(on_time.remarks, [step.remedy()]);
        for after in [counted(5000, 100), counted(10, 0), counted(7000, 1)] {
            assert_eq!(punctuality(&counted(5000, 100), &after, 0.02), None);
        }
    }
}
