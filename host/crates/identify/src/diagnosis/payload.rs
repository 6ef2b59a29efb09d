//! The load at the flange as a cause: what it does to the TCP, and how much of it the data tell.
//!
//! The effect of a load is a product: of the joints' compliance and of the load's mass. Where the load is stated too
//! light, the fit gives the joints more compliance than they have, and a test that takes that compliance for granted
//! finds too little load with too little evidence. So a load that is tried is linearised where both are estimated.

use nalgebra::{DVector, Vector3};
use spherecal_shared::robot::GRAVITY_M_S2;

use super::discrepancy::Discrepancy;
use super::linear::{Linear, LinearRow, Posture};
use crate::error::IdentifyError;

/// Unit of the load's effect, in kg: a load that is less certain than 1 kg counts as not seen, as a
/// length does that is less certain than 5 mm.
pub(crate) const PAYLOAD_UNIT_KG: f64 = 200.0;
/// Linearisations after that of the fit. A third changes the logarithm of the evidence by less than 0.2 in eight of ten robots, and by
/// 0.7 at most.
const ROUNDS: usize = 2;

/// What the load at the flange does, where the masses are known.
pub(crate) struct LoadEffects<'a> {
    /// Estimated compliance of each joint, in rad/(N m).
    pub(crate) compliance: &'a [f64],
    /// The column of the linear model that is the compliance of each joint; none where it is not free.
    pub(crate) columns: Vec<Option<usize>>,
    /// Centre of mass of the tool in the last frame, in m, seen from the TCP.
    pub(crate) com_from_tcp_m: Vector3<f64>,
}

/// A load in the model, linearised where load and compliance are estimated.
pub(crate) struct LoadInModel {
    /// The linear model there.
    pub(crate) linear: Linear,
    /// The extended model with the load.
    pub(crate) model: Discrepancy,
    /// The load's whitened column and the sigma of its prior, in [`PAYLOAD_UNIT_KG`].
    pub(crate) columns: Vec<(DVector<f64>, f64)>,
}

impl LoadEffects<'_> {
    /// Whitened displacements of the targets by one unit of load, with these compliances in rad/(N m).
    pub(crate) fn column(&self, linear: &Linear, compliance: &[f64]) -> DVector<f64> {
        let joints = |p: &LinearRow| -> Vector3<f64> {
            let each = compliance.iter().enumerate();
            each.map(|(joint, c)| self.displacement(&p.posture, joint) * *c).sum()
        };
        linear.column(|p| joints(p) * PAYLOAD_UNIT_KG)
    }

    /// Displacement of the TCP (F0, m) by 1 kg more at the tool's centre of mass, for a joint's compliance of 1 rad/(N m).
    fn displacement(&self, p: &Posture, joint: usize) -> Vector3<f64> {
        let Some(column) = p.joints.get(joint) else {
            return Vector3::zeros();
        };
        let com = p.flange * self.com_from_tcp_m;
        let z = p.lengths.get(2 * joint + 1).copied().unwrap_or_default();
        let torque = (column + z.cross(&com)).z * GRAVITY_M_S2;
        -column * torque
    }

    /// The model with a load, linearised where both are estimated. `with` is `model` with the load's `columns` as they
    /// are at the fit.
    ///
    /// # Errors
    /// Equations that have no solution.
    pub(crate) fn in_model(
        &self,
        linear: &Linear,
        model: &Discrepancy,
        with: &Discrepancy,
        columns: &[(DVector<f64>, f64)],
    ) -> Result<LoadInModel, IdentifyError> {
        let each: Vec<DVector<f64>> = (0..self.compliance.len())
            .map(|joint| linear.column(|p| self.displacement(&p.posture, joint) * PAYLOAD_UNIT_KG))
            .collect();
        let (mut load, mut mean) = (with.named_effect(columns)?.0, with.mean()?);
        let mut round = 0;
        loop {
            round += 1;
            let mut there = linear.clone();
            let mut column = DVector::zeros(linear.y.len());
            // Load times compliance, c m, is c' m + m' c - c' m' near c' and m'.
            for ((each, fitted), free) in each.iter().zip(self.compliance).zip(&self.columns) {
                let mut compliance = *fitted;
                if let Some(free) = *free {
                    let scale = linear.scale[free];
                    let from_prior = scale * mean[free];
                    compliance += from_prior - scale * linear.estimate[free];
                    there.x.column_mut(free).axpy(load[0] * scale, each, 1.0);
                    there.y.axpy(load[0] * from_prior, each, 1.0);
                }
                column.axpy(compliance, each, 1.0);
            }
            let sigmas = columns.iter().map(|c| c.1);
            let columns: Vec<(DVector<f64>, f64)> = sigmas.map(|sigma| (column.clone(), sigma)).collect();
            let model = model.about(&there).with(&there, &columns)?;
            if round == ROUNDS {
                return Ok(LoadInModel {
                    linear: there,
                    model,
                    columns,
                });
            }
            (load, mean) = (model.named_effect(&columns)?.0, model.mean()?);
        }
    }
}
