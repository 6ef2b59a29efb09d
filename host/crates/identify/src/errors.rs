//! Errors of predicted positions, and their statistics.

use nalgebra::Vector3;
use serde::Serialize;

/// Statistics of distances, in mm.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize)]
pub struct Errors {
    /// Samples.
    pub n: usize,
    /// Mean distance.
    pub mean_mm: f64,
    /// Standard deviation of the distances.
    pub std_mm: f64,
    /// Smallest distance.
    pub min_mm: f64,
    /// Largest distance.
    pub max_mm: f64,
    /// Root mean square of the distances.
    pub rms_mm: f64,
}

impl Errors {
    /// Of distances in mm.
    pub fn of(distances_mm: &[f64]) -> Self {
        let n = distances_mm.len();
        if n == 0 {
            return Self::default();
        }
        let mean = distances_mm.iter().sum::<f64>() / n as f64;
        let square = distances_mm.iter().map(|d| d * d).sum::<f64>() / n as f64;
        let spread = distances_mm.iter().map(|d| (d - mean).powi(2)).sum::<f64>() / n as f64;
        Self {
            n,
            mean_mm: mean,
            std_mm: spread.sqrt(),
            min_mm: distances_mm.iter().copied().fold(f64::INFINITY, f64::min),
            max_mm: distances_mm.iter().copied().fold(0.0, f64::max),
            rms_mm: square.sqrt(),
        }
    }
}

/// One sample's error.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct SampleError {
    /// Index of the sample among those judged.
    pub index: usize,
    /// Where the TCP is in F0 by the model, in m.
    pub at_m: [f64; 3],
    /// Predicted minus true, in mm.
    pub error_mm: [f64; 3],
    /// Its length.
    pub distance_mm: f64,
}

/// The error of a sample whose TCP is at `tcp` (m, F0) by the model, `off` (m) from its target.
pub(crate) fn error(index: usize, tcp: &Vector3<f64>, off: &Vector3<f64>) -> SampleError {
    SampleError {
        index,
        at_m: (*tcp).into(),
        error_mm: (off * 1e3).into(),
        distance_mm: off.norm() * 1e3,
    }
}
