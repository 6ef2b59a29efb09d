//! What no model of single joints holds: errors of a joint that depend on the angles of the others.
//!
//! Friction, loads that couple through the links and errors of assembly make the residuals of postures that are alike
//! alike. Where they are taken for white noise, a slow course of them passes for a plate that slipped or an encoder that
//! jumped, and what is stated is too good. So each joint has an error that is a smooth function of each other joint's angle:
//! its first orders, with one size for all, beside the white noise. They are no part of the result, because a table hardly
//! determines them one by one: they are integrated out of the estimate, of the tests of causes and of the statement.

use nalgebra::{DVector, Vector3};

use super::extended::Extended;
use super::linear::Linear;
use crate::error::IdentifyError;
use crate::hierarchy::constants::{CROSS_RAD, CROSS_RANGES, FACTORS};
use crate::hierarchy::cross::columns;
use crate::hierarchy::highest;

/// Steps by the golden ratio for the noise, to 1 % of its interval, and for the size at each noise.
const STEPS: (usize, usize) = (9, 14);

/// A fit with the errors.
pub(super) struct Cross {
    /// The linear model with the white noise that they leave.
    pub(super) linear: Linear,
    /// The same with their columns.
    pub(super) model: Extended,
    /// Size of an error, 1 sigma, in rad.
    pub(super) size_rad: f64,
    /// White noise that is left, as a share of that of the fit.
    pub(super) white: f64,
}

impl Cross {
    /// The size and the rest of the white noise that explain the rows best, which count as so many `numbers`.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(super) fn new(linear: Linear, numbers: f64) -> Result<Self, IdentifyError> {
        let displacements: Vec<Vec<Vector3<f64>>> = linear
            .rows
            .iter()
            .map(|row| columns(&row.posture.q, &row.posture.joints))
            .collect();
        let count = displacements.first().map_or(0, Vec::len);
        let column = |c: usize| {
            let mut rows = displacements.iter();
            let whitened = linear.column(|_| rows.next().map_or_else(Vector3::zeros, |row| row[c]));
            (whitened, CROSS_RAD)
        };
        let columns: Vec<(DVector<f64>, f64)> = (0..count).map(column).collect();
        let model = Extended::new(&linear)?.with(&linear, &columns)?;
        let (mut size, mut white) = (1.0, 1.0);
        if count > 0 {
            let at_noise = |noise: f64| {
                let Ok(by_size) = model.by_size(&linear, numbers, noise.exp()) else {
                    return (0.0, f64::NEG_INFINITY);
                };
                let evidence = |size: f64| by_size.at(size.exp()) - 0.5 * (size / FACTORS.made.ln()).powi(2);
                highest(CROSS_RANGES[0], STEPS.1, evidence)
            };
            let noise = highest(CROSS_RANGES[1], STEPS.0, |noise| at_noise(noise).1).0;
            (size, white) = (at_noise(noise).0.exp(), noise.exp());
        }
        Ok(Self {
            model: model.rescaled(&linear, size, white)?,
            linear: linear.with_noise(white),
            size_rad: CROSS_RAD * size,
            white,
        })
    }
}
