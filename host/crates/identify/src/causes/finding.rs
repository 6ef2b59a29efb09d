//! What the score tests give.

use nalgebra::DVector;
use serde::Serialize;

use super::alternatives::{Alternative, Family};
use super::payload::PAYLOAD_UNIT_KG;

/// A cause that the data speak for.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Finding {
    /// What it is.
    pub alternative: Alternative,
    /// In words, with size and uncertainty.
    pub words: String,
    /// Size, in mm (mrad for joints, parts per thousand for the scale).
    pub size: f64,
    /// Its standard deviation, same unit.
    pub sigma: f64,
    /// As many standard deviations of one normal variable as it is unlikely.
    pub sigmas: f64,
    /// Chance of it in a sound experiment, all alternatives counted: logarithm to
    /// the base 10.
    pub log10_p: f64,
    /// Mean TCP error over the workspace that it causes in the calibration, in mm.
    pub harm_mm: f64,
    /// Other causes that explain the same data.
    pub or: Vec<String>,
    /// Indices of the observations that it concerns.
    pub rows: Vec<usize>,
    /// What to do about it.
    pub next: &'static str,
    #[serde(skip)]
    pub(crate) columns: Vec<(DVector<f64>, f64)>,
    #[serde(skip)]
    pub(crate) effect: DVector<f64>,
}

impl Finding {
    /// How much heavier (kg) than stated the load at the flange is, if this is about it.
    pub(crate) fn load_kg(&self) -> Option<f64> {
        (self.alternative == Alternative::Payload).then(|| self.effect.sum() * PAYLOAD_UNIT_KG)
    }
}

/// The largest statistic of a family, found or not.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct FamilyTest {
    /// The family.
    pub family: Family,
    /// Alternatives tested.
    pub tested: usize,
    /// Largest statistic, as standard deviations of one normal variable.
    pub sigmas: f64,
    /// What it must stay under: the lowest limit of its alternatives.
    pub limit: f64,
    /// Whether a cause of this family was found. A statistic may be over its limit
    /// without it: a cause of another family explains the same data better.
    pub found: bool,
}
