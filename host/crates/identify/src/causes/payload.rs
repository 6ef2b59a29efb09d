//! The load at the flange as a cause: what it does to the TCP, and how much of it the data tell.
//!
//! The effect of a load is a product: of the joints' compliance and of the load's mass. Where the load is stated too
//! light, the fit gives the joints more compliance than they have, and a test that takes that compliance for granted
//! finds too little load with too little evidence. So a load that is tried is linearised where both are estimated.

use nalgebra::{DVector, Vector3};
use spherecal_shared::robot::{GRAVITY_M_S2, Tool};

use super::extended::Extended;
use super::linear::{Linear, Posture};
use crate::error::IdentifyError;
use crate::hierarchy::constants::FACTORS;
use crate::priors::COMPLIANCE_MEAN;

/// Unit of the load's effect, in kg: a load that is less certain than 1 kg counts as not seen, as a
/// length does that is less certain than 5 mm.
pub(crate) const PAYLOAD_UNIT_KG: f64 = 200.0;

/// How far the load is likely to be from the stated one, as a part of the arm's own mass: collaborative arms carry a quarter
/// of their mass, more or less. Without it, a load of 30 kg was named where hardly any compliance was left for it to act on.
const LIKELY: f64 = 0.25;

/// Hangs a load (kg, heavier than stated) at the tool's centre of mass: half way to the flange where the tool has no mass. Returns
/// what hangs there more than before: nothing weighs less than nothing.
pub(crate) fn hang(tool: &mut Tool, load_kg: f64) -> f64 {
    let body = &mut tool.body;
    let before = body.mass_kg;
    if before <= 0.0 {
        body.com_m = tool.tcp_m.map(|at| 0.5 * at);
    }
    body.mass_kg = (before + load_kg).max(0.0);
    body.mass_kg - before
}

/// What the load at the flange does, where the masses are known.
pub(crate) struct LoadEffects<'a> {
    /// Estimated compliance of each joint, in rad/(N m).
    pub(crate) compliance: &'a [f64],
    /// The column of the linear model that is the compliance of each joint; none where it is not free.
    pub(crate) columns: Vec<Option<usize>>,
    /// Centre of mass of the tool in the last frame, in m, seen from the TCP.
    pub(crate) com_from_tcp_m: Vector3<f64>,
    /// Mass of the arm's links, in kg.
    pub(crate) arm_kg: f64,
}

/// A load in the model, linearised where load and compliance are estimated.
pub(crate) struct LoadInModel {
    /// The linear model there.
    pub(crate) linear: Linear,
    /// The extended model with the load.
    pub(crate) model: Extended,
    /// The load's whitened column and the sigma of its prior, in [`PAYLOAD_UNIT_KG`].
    pub(crate) columns: Vec<(DVector<f64>, f64)>,
}

impl LoadEffects<'_> {
    /// Standard deviation of the load from the stated one before any data, in [`PAYLOAD_UNIT_KG`].
    pub(crate) fn prior(&self) -> f64 {
        LIKELY * self.arm_kg / PAYLOAD_UNIT_KG
    }

    /// Whitened displacements of the targets by one unit of load.
    pub(crate) fn column(&self, linear: &Linear) -> DVector<f64> {
        let mut column = DVector::zeros(linear.y.len());
        for (of_joint, compliance) in self.by_joint(linear).iter().zip(self.compliance) {
            column.axpy(*compliance, of_joint, 1.0);
        }
        column
    }

    /// What the joints have in common: the whitened column of a relative change of the compliance that all are expected to
    /// have, and the sigma of its prior. Joints of one arm are soft alike, and a load looks like that.
    pub(crate) fn softness(&self, linear: &Linear) -> (DVector<f64>, f64) {
        let mut column = DVector::zeros(linear.y.len());
        for free in self.columns.iter().flatten() {
            column.axpy(COMPLIANCE_MEAN / linear.scale[*free], &linear.x.column(*free), 1.0);
        }
        (column, FACTORS.compliance.ln())
    }

    /// The same by joint, for a compliance of 1 rad/(N m) each.
    fn by_joint(&self, linear: &Linear) -> Vec<DVector<f64>> {
        let joints = 0..self.compliance.len();
        joints
            .map(|joint| linear.column(|p| self.displacement(&p.posture, joint) * PAYLOAD_UNIT_KG))
            .collect()
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
        model: &Extended,
        with: &Extended,
        columns: &[(DVector<f64>, f64)],
    ) -> Result<LoadInModel, IdentifyError> {
        let by_joint = self.by_joint(linear);
        let first = self.linearised(linear, &by_joint, model, with, columns)?;
        // A third time changes the logarithm of the evidence by less than 0.2 in eight of ten robots, and by 0.7 at most.
        self.linearised(linear, &by_joint, model, &first.model, &first.columns)
    }

    /// The model with a load, linearised at the load and the compliance that `at` estimates; `columns` are the load's there.
    fn linearised(
        &self,
        linear: &Linear,
        by_joint: &[DVector<f64>],
        model: &Extended,
        at: &Extended,
        columns: &[(DVector<f64>, f64)],
    ) -> Result<LoadInModel, IdentifyError> {
        let load = at.named_effect(columns).0.sum();
        let mean = at.mean();
        let mut there = linear.clone();
        let mut column = DVector::zeros(linear.y.len());
        // Load times compliance, c m, is c' m + m' c - c' m' near c' and m'.
        for ((of_joint, fitted), free) in by_joint.iter().zip(self.compliance).zip(&self.columns) {
            let mut compliance = *fitted;
            if let Some(free) = *free {
                let scale = linear.scale[free];
                let from_prior = scale * mean[free];
                compliance += from_prior - scale * linear.estimate[free];
                there.x.column_mut(free).axpy(load * scale, of_joint, 1.0);
                there.y.axpy(load * from_prior, of_joint, 1.0);
            }
            column.axpy(compliance, of_joint, 1.0);
        }
        let columns: Vec<(DVector<f64>, f64)> = columns.iter().map(|c| (column.clone(), c.1)).collect();
        let model = model.about(&there)?.with(&there, &columns)?;
        Ok(LoadInModel {
            linear: there,
            model,
            columns,
        })
    }
}

#[cfg(test)]
mod tests {
    use spherecal_shared::robot::Tool;

    use super::hang;

    // Fails if a load hangs elsewhere than half way to the flange, or if a tool gets a mass below zero, which no reader takes.
    #[test]
    fn a_load_hangs_at_the_tool() {
        let mut tool = Tool {
            tcp_m: [0.1, 0.0, 0.2],
            ..Tool::default()
        };
        assert_eq!(hang(&mut tool, 2.0), 2.0);
        assert_eq!((tool.body.mass_kg, tool.body.com_m), (2.0, [0.05, 0.0, 0.1]));
        assert_eq!(hang(&mut tool, -3.0), -2.0);
        assert_eq!(tool.body.mass_kg, 0.0);
    }
}
