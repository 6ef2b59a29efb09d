//! Orientations as telemetry writes them.

use nalgebra::{Matrix3, Rotation3};
use serde::{Deserialize, Serialize};
use spherecal_model::chain::quaternion;

/// Rounded to a nanometre or 1e-9: digits beyond cannot be compressed, and nobody needs them.
pub(super) fn rounded(x: f64) -> f64 {
    (x * 1e9).round() / 1e9
}

/// A unit quaternion.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Quaternion {
    /// Its x part.
    pub x: f64,
    /// Its y part.
    pub y: f64,
    /// Its z part.
    pub z: f64,
    /// Its real part; not negative.
    pub w: f64,
}

impl Default for Quaternion {
    /// No rotation.
    fn default() -> Self {
        Self {
            x: 0.0,
            y: 0.0,
            z: 0.0,
            w: 1.0,
        }
    }
}

impl From<&Matrix3<f64>> for Quaternion {
    fn from(rotation: &Matrix3<f64>) -> Self {
        let [w, x, y, z] = quaternion(&Rotation3::from_matrix_unchecked(*rotation)).map(rounded);
        Self { x, y, z, w }
    }
}
