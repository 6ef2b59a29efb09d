//! Words and figures of a report's headline, the same for a run and for a study.

use spherecal_identify::ExpectedError;
use spherecal_identify::evaluate::Evaluation;

/// A figure of a headline: name, value, and what it is.
pub type HeadlineFigure = (String, String, String);

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

/// Mean and largest error as figures. `by` follows their names: how they were found, or nothing.
pub fn error_figures(by: &str, nominal: Error, calibrated: Error) -> [HeadlineFigure; 2] {
    [
        ("Mean error", nominal.mean_mm, calibrated.mean_mm),
        ("Largest error", nominal.max_mm, calibrated.max_mm),
    ]
    .map(|(name, before, now)| {
        (
            format!("{name}{by}"),
            format!("{now:.3} mm"),
            format!("nominally {before:.3} mm"),
        )
    })
}

/// The expected error over the work region as figures: that of the full model, which a compensator
/// carries out, and that of the geometry alone, which the files hold.
pub fn expected_figures(evaluation: &Evaluation) -> Vec<HeadlineFigure> {
    let Some(full) = &evaluation.verdict.expected_error_mm else {
        return Vec::new();
    };
    let figure = |name: &str, of: &str, error: &ExpectedError| {
        let [low, high] = error.interval;
        let what = format!("{of}; mean over the work region, 95 % interval {low:.3} to {high:.3} mm");
        (name.to_owned(), format!("{:.3} mm", error.mean), what)
    };
    let mut figures = vec![figure("Expected error", "full model, by the compensator", full)];
    if let Some(alone) = evaluation.verdict.file_error_mm.filter(|_| evaluation.geometry.helps()) {
        figures.push(figure("Geometry alone", "calibrated.urdf in a controller", &alone));
    }
    figures
}
