//! Words of a report's headline, the same for a run and for a study.

use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Evaluation;

use super::input::{FileError, SimpleTable};

/// Mean and largest error of a model, in mm.
#[derive(Clone, Copy, Debug)]
pub struct Error {
    /// Mean error.
    pub mean_mm: f64,
    /// Largest error.
    pub max_mm: f64,
}

/// Says how much more accurate a robot is than the nominal one. `subject` begins the sentence, for
/// instance "The calibrated iiwa7".
pub fn compared(subject: &str, robot: &str, nominal: Error, calibrated: Error) -> String {
    let gain = 1.0 - calibrated.mean_mm / nominal.mean_mm.max(1e-12);
    if gain <= 0.0 {
        return format!(
            "The calibrated {robot} is not better than the nominal one: mean position error {:.3} mm, with the nominal \
             model {:.3} mm.",
            calibrated.mean_mm, nominal.mean_mm
        );
    }
    format!(
        "{subject} is {:.0} % more accurate: its mean position error fell from {:.3} mm to {:.3} mm, the largest from \
         {:.3} mm to {:.3} mm.",
        gain * 100.0,
        nominal.mean_mm,
        calibrated.mean_mm,
        nominal.max_mm,
        calibrated.max_mm
    )
}

/// Characters of a remark after which its first clause may end: a clause before is a mere heading, such as `SIMULATED:`.
const HEADING: usize = 24;

/// The first clause of a remark, for a list that is read at a glance; the whole remark stands in the report.
pub fn brief(remark: &str) -> String {
    let ends = [". ", "; ", " (", ", (", ": "];
    let end = ends
        .iter()
        .flat_map(|end| remark.match_indices(end))
        .map(|(at, _)| at)
        .filter(|at| *at >= HEADING)
        .min();
    let clause = &remark[..end.unwrap_or(remark.len())];
    first_upper(clause)
}

/// Words as the beginning of a sentence.
pub(super) fn first_upper(words: &str) -> String {
    let mut letters = words.chars();
    letters
        .next()
        .into_iter()
        .flat_map(char::to_uppercase)
        .chain(letters)
        .collect()
}

/// The files of a result with the error that each has over the work region, and the robot as it was. Empty where no error
/// is expected of them.
pub fn files(evaluation: &Evaluation) -> Vec<FileError> {
    let verdict = &evaluation.verdict;
    let (Some(full), Some(nominal), Some(alone)) = (
        verdict.expected_error_mm,
        verdict.nominal_error_mm,
        verdict.file_error_mm,
    ) else {
        return Vec::new();
    };
    let row = |name: &str, holds: &str, error| FileError {
        name: name.to_owned(),
        holds: holds.to_owned(),
        expected_mm: error,
    };
    let urdf = if evaluation.geometry.helps() {
        row(
            "calibrated.urdf",
            "geometry alone, for a controller or a simulator",
            Some(alone.work),
        )
    } else {
        row("no calibrated.urdf", "it would be worse than the robot as it was", None)
    };
    vec![
        row("as it was", "the nominal robot", Some(nominal.work)),
        row("calibrated.toml", "the full model, for a compensator", Some(full.work)),
        urdf,
    ]
}

/// The expected error over each region, of the robot as it was and of each file.
pub fn regions(evaluation: &Evaluation) -> Option<SimpleTable> {
    let verdict = &evaluation.verdict;
    let file = if evaluation.geometry.helps() {
        "calibrated.urdf"
    } else {
        "geometry alone"
    };
    let models = [
        ("as it was", verdict.nominal_error_mm?),
        ("calibrated.toml", verdict.expected_error_mm?),
        (file, verdict.file_error_mm?),
    ];
    let words = |e: &ExpectedError| {
        format!(
            "{:.3} ({:.3} to {:.3}), {:.3}",
            e.mean, e.interval[0], e.interval[1], e.p95
        )
    };
    Some(SimpleTable {
        title: "Expected error, in mm".to_owned(),
        caption: "Mean over the region (its 95 % interval), and what 95 % of the region are below. As measured: at the postures \
                  of the data, with the noise of the instrument. The whole reach is extrapolated."
            .to_owned(),
        columns: ["", "work region", "as measured", "whole reach"].map(str::to_owned).to_vec(),
        rows: models
            .iter()
            .map(|(name, e)| vec![(*name).to_owned(), words(&e.work), words(&e.measured), words(&e.whole)])
            .collect(),
    })
}
