//! Table 5 of the paper, for any models and all three alignments.

use std::fmt;

use nalgebra::Vector3;
use serde::{Deserialize, Serialize};

use crate::Pose;
use spherecal_model::fit_pose;

/// How a model's base frame is brought into the tracker frame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Alignment {
    /// V1: the base measured by arcs.
    Arcs,
    /// V2: the best rigid fit to the validation points.
    BestFit,
    /// V3: the model's own base.
    Own,
}

impl Alignment {
    /// All three, in the order of the table.
    pub const ALL: [Self; 3] = [Self::Arcs, Self::BestFit, Self::Own];

    /// In words, for a heading.
    pub fn title(self) -> &'static str {
        match self {
            Self::Arcs => "base measured by arcs (V1, the paper's protocol)",
            Self::BestFit => "base fitted to the points (V2)",
            Self::Own => "the model's own base (V3)",
        }
    }
}

/// Mean, standard deviation (over n), minimum and maximum of errors, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct ErrorStatistics {
    /// Mean, in mm.
    pub mean_mm: f64,
    /// Standard deviation over n, in mm.
    pub std_mm: f64,
    /// Smallest, in mm.
    pub min_mm: f64,
    /// Largest, in mm.
    pub max_mm: f64,
}

impl ErrorStatistics {
    /// Of errors in mm; all zero for no errors at all.
    pub fn of(errors_mm: &[f64]) -> Self {
        if errors_mm.is_empty() {
            return Self::default();
        }
        let n = errors_mm.len() as f64;
        let mean_mm = errors_mm.iter().sum::<f64>() / n;
        Self {
            mean_mm,
            std_mm: (errors_mm.iter().map(|e| (e - mean_mm).powi(2)).sum::<f64>() / n).sqrt(),
            min_mm: errors_mm.iter().copied().fold(f64::INFINITY, f64::min),
            max_mm: errors_mm.iter().copied().fold(f64::NEG_INFINITY, f64::max),
        }
    }
}

/// What one model predicts for the validation configurations.
#[derive(Clone, Debug, PartialEq)]
pub struct Prediction {
    /// Name of the model, such as `nominal`, `sphere`, `laser`.
    pub name: String,
    /// Predicted TCP in the model's base frame F0, in m, one per measurement.
    pub points_m: Vec<[f64; 3]>,
    /// The model's own pose of F0 in the tracker frame (m). `None` if it has none; V3 then uses the
    /// arc-measured base.
    pub own_base: Option<Pose>,
}

/// One model's errors.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ModelErrors {
    /// Name of the model.
    pub name: String,
    /// V1: base measured by arcs.
    pub arcs: ErrorStatistics,
    /// V2: base fitted to the points.
    pub best_fit: ErrorStatistics,
    /// V3: the model's own base.
    pub own: ErrorStatistics,
    /// Errors of V1, V2 and V3 for each measurement, in mm (Figures 11 and 12).
    pub errors_mm: [Vec<f64>; 3],
}

impl ModelErrors {
    /// Statistics under one alignment.
    pub fn statistics(&self, alignment: Alignment) -> &ErrorStatistics {
        match alignment {
            Alignment::Arcs => &self.arcs,
            Alignment::BestFit => &self.best_fit,
            Alignment::Own => &self.own,
        }
    }
}

/// Errors of several models on the same measurements.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct ValidationTable {
    /// Number of measurements.
    pub n: usize,
    /// The models, in the order given.
    pub models: Vec<ModelErrors>,
}

/// Why models could not be validated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum ValidateError {
    /// Nothing to validate by.
    #[error("no validation measurements: give at least one (set = validate)")]
    Empty,
    /// A model predicts another number of points than were measured.
    #[error("model {model} predicts {found} points for {expected} measurements: predict one point for each")]
    Count {
        /// Name of the model.
        model: String,
        /// Points predicted.
        found: usize,
        /// Points measured.
        expected: usize,
    },
    /// A coordinate is NaN or infinite.
    #[error("validation point {index} of {source_name} is not a finite number: leave it out or measure it again")]
    NotFinite {
        /// Name of the model, or `the measurement`.
        source_name: String,
        /// Index of the point.
        index: usize,
    },
}

/// Judges models on measured points (m, tracker frame); `arc_base` is the pose
/// of F0 in the tracker frame as measured by arcs.
///
/// # Errors
/// No measurements, a model with another number of points, numbers that are not finite.
pub fn validate(
    measured_m: &[[f64; 3]],
    arc_base: &Pose,
    models: &[Prediction],
) -> Result<ValidationTable, ValidateError> {
    if measured_m.is_empty() {
        return Err(ValidateError::Empty);
    }
    require_finite("the measurement", measured_m)?;
    let judged = models.iter().map(|model| {
        if model.points_m.len() != measured_m.len() {
            return Err(ValidateError::Count {
                model: model.name.clone(),
                found: model.points_m.len(),
                expected: measured_m.len(),
            });
        }
        require_finite(&model.name, &model.points_m)?;
        let vectors = |points: &[[f64; 3]]| points.iter().map(|p| Vector3::from(*p)).collect::<Vec<_>>();
        // There are points, so there is a fit.
        let fitted = fit_pose(&vectors(&model.points_m), &vectors(measured_m)).unwrap_or(*arc_base);
        let bases = [arc_base, &fitted, model.own_base.as_ref().unwrap_or(arc_base)];
        let errors_mm = bases.map(|base| errors_mm(base, &model.points_m, measured_m));
        Ok(ModelErrors {
            name: model.name.clone(),
            arcs: ErrorStatistics::of(&errors_mm[0]),
            best_fit: ErrorStatistics::of(&errors_mm[1]),
            own: ErrorStatistics::of(&errors_mm[2]),
            errors_mm,
        })
    });
    Ok(ValidationTable {
        n: measured_m.len(),
        models: judged.collect::<Result<_, _>>()?,
    })
}

fn require_finite(name: &str, points: &[[f64; 3]]) -> Result<(), ValidateError> {
    match points.iter().position(|p| p.iter().any(|x| !x.is_finite())) {
        Some(index) => Err(ValidateError::NotFinite {
            source_name: name.to_owned(),
            index,
        }),
        None => Ok(()),
    }
}

/// Distances between measured points and predicted ones seen through `base`, in mm.
fn errors_mm(base: &Pose, predicted_m: &[[f64; 3]], measured_m: &[[f64; 3]]) -> Vec<f64> {
    predicted_m
        .iter()
        .zip(measured_m)
        .map(|(p, m)| (base.point(&Vector3::from(*p)) - Vector3::from(*m)).norm() * 1e3)
        .collect()
}

impl ValidationTable {
    /// The model of that name.
    pub fn model(&self, name: &str) -> Option<&ModelErrors> {
        self.models.iter().find(|m| m.name == name)
    }

    /// One block of the table as text, the shape of the paper's Table 5.
    pub fn block(&self, alignment: Alignment) -> String {
        let width = self
            .models
            .iter()
            .map(|m| m.name.chars().count())
            .max()
            .unwrap_or(0)
            .max(8);
        let row = |name: &str, cells: [String; 4]| {
            let [mean, std, min, max] = cells;
            format!("{name:width$}  {mean:>9}  {std:>9}  {min:>9}  {max:>9}\n")
        };
        let heading = row("", ["mean (mm)", "std (mm)", "min (mm)", "max (mm)"].map(str::to_owned));
        let rows = self.models.iter().map(|model| {
            let s = model.statistics(alignment);
            row(
                &model.name,
                [s.mean_mm, s.std_mm, s.min_mm, s.max_mm].map(|v| format!("{v:.3}")),
            )
        });
        std::iter::once(heading).chain(rows).collect()
    }
}

impl fmt::Display for ValidationTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        for (k, alignment) in Alignment::ALL.into_iter().enumerate() {
            if k > 0 {
                writeln!(f)?;
            }
            writeln!(f, "Error on {} measurements, {}", self.n, alignment.title())?;
            write!(f, "{}", self.block(alignment))?;
        }
        Ok(())
    }
}
