//! Residuals of a fit, row by row and by sphere and place.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;
use serde::Serialize;

use super::chain::Prepared;
use super::hierarchy::Fit;
use super::normal::distances;
use super::targets::Reference;

/// Length of a whitened residual from which a row is an outlier: beyond what the tails of the noise explain.
pub(crate) const OUTLIER_SIGMAS: f64 = 5.0;

/// One observation's residual.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ResidualRow {
    /// Index of the observation in the experiment.
    pub index: usize,
    /// TCP minus target, in the target's frame, in mm; of several targets the first that was seen.
    pub error_mm: [f64; 3],
    /// Length of the whitened residual, in units of the estimated noise. That of several targets is scaled to
    /// three numbers, so that it compares with that of one.
    pub deviation: f64,
    /// Robust weight relative to a residual of zero.
    pub weight: f64,
}

/// An observation that the model does not believe.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Outlier {
    /// Index of the observation in the experiment.
    pub index: usize,
    /// Why it was named.
    pub why: String,
}

/// Statistics of the residuals of the calibration set.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Residual {
    /// Root mean square of the distances, in mm.
    pub rms_mm: f64,
    /// Mean distance, in mm.
    pub mean_mm: f64,
    /// Largest distance, in mm.
    pub max_mm: f64,
    /// Observations that the model does not believe; of geometry alone those that the full model does not believe.
    pub outliers: Vec<Outlier>,
    /// Every observation's.
    #[serde(skip)]
    pub rows: Vec<ResidualRow>,
}

/// Goodness of fit of the observations at one sphere and place, or by the tracker.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupFit {
    /// Frame.
    pub reference: Reference,
    /// Id of the sphere; none for measured points.
    pub sphere: Option<u32>,
    /// Number of the seat that the rows have for themselves.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seat: Option<u32>,
    /// Observations.
    pub count: usize,
    /// Root mean square of their distances, in mm.
    pub rms_mm: f64,
    /// Weighted chi-square at the estimated noise.
    pub chi_square: f64,
    /// The same per degree of freedom (three per observation): about 1.
    pub per_freedom: f64,
}

/// Residuals at the final state, by observation and by group.
pub(super) fn residuals(fit: &Fit) -> (Residual, Vec<GroupFit>) {
    let (state, layout) = (&fit.state, &fit.layout);
    let row = |((observation, &weight), &share): ((&Prepared, &f64), &f64)| {
        let residual = state.residual(observation, &state.at(observation).tcp);
        let residual = residual + fit.by_causes.get(&observation.index).copied().unwrap_or_default();
        // Of more rows than the causes were tested in, the others are held against the noise of the fit.
        let square = fit.left.get(&observation.index).copied().unwrap_or_else(|| {
            let own = distances(state, layout, std::slice::from_ref(observation), &fit.whitening);
            own.iter().map(|row| row.d2 * 3.0 / row.numbers).sum::<f64>() * fit.cross.white.powi(2)
        });
        let deviation = square.sqrt();
        let rotation = state.bases.get(observation.reference).map(|b| b.rotation);
        let error = rotation.unwrap_or_else(Matrix3::identity) * residual * 1000.0;
        ResidualRow {
            index: observation.index,
            error_mm: error.into(),
            deviation,
            weight: weight / share,
        }
    };
    let rows: Vec<ResidualRow> = fit
        .prepared
        .par_iter()
        .zip(&fit.weights)
        .zip(&fit.shares)
        .map(row)
        .collect();
    let length = |row: &ResidualRow| Vector3::from(row.error_mm).norm();
    let mean_square = |of: &[f64]| (of.iter().map(|x| x * x).sum::<f64>() / of.len().max(1) as f64).sqrt();
    let lengths: Vec<f64> = rows.iter().map(length).collect();
    let groups = fit
        .groups
        .iter()
        .map(|group| {
            let own: Vec<f64> = group.members.iter().map(|&i| lengths[i]).collect();
            let chi_square = group
                .members
                .iter()
                .map(|&i| rows[i].deviation.powi(2) * rows[i].weight)
                .sum::<f64>();
            GroupFit {
                reference: layout
                    .references
                    .get(group.reference)
                    .copied()
                    .unwrap_or(Reference::Tracker),
                sphere: group.sphere.and_then(|s| layout.spheres.get(s).copied()),
                seat: group.seat.and_then(|s| layout.seats.get(s).copied()),
                count: own.len(),
                rms_mm: mean_square(&own),
                chi_square,
                per_freedom: chi_square / (3.0 * own.len().max(1) as f64),
            }
        })
        .collect();
    let outliers = rows
        .iter()
        .filter(|row| row.deviation > OUTLIER_SIGMAS)
        .map(|row| Outlier {
            index: row.index,
            why: format!(
                "{:.3} mm from its target, {:.1} times the noise: counted with weight {:.2}",
                length(row),
                row.deviation,
                row.weight
            ),
        });
    let residual = Residual {
        rms_mm: mean_square(&lengths),
        mean_mm: lengths.iter().sum::<f64>() / lengths.len().max(1) as f64,
        max_mm: lengths.iter().copied().fold(0.0, f64::max),
        outliers: outliers.collect(),
        rows,
    };
    (residual, groups)
}
