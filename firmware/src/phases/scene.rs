//! What a phase sees, made by hand: for the unit tests of single phases.

use nalgebra::{SVector, Vector3};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Arm, JointLimits, iiwa7, iiwa7_tool};

use super::{CartesianState, Departed, Env};
use crate::law::{Excess, Snapshot, Stiffness, Wrench};
use crate::testing::HOME;

/// The built-in arm at home, at rest, and what the controller would know of it.
pub(super) struct Scene {
    pub(super) snapshot: Snapshot<7>,
    pub(super) wrench: Wrench,
    pub(super) external: SVector<f64, 7>,
    pub(super) departed: Option<Departed<7>>,
    pub(super) excess: Option<Excess>,
    pub(super) joint_speed: f64,
    pub(super) force_n: f64,
    pub(super) elapsed_s: f64,
    pub(super) period_s: f64,
    pub(super) procedure: Procedure,
    pub(super) joints: [JointLimits; 7],
}

impl Scene {
    pub(super) fn new() -> Self {
        Self::at(&HOME, &[0.0; 7])
    }

    pub(super) fn at(q: &[f64; 7], dq: &[f64; 7]) -> Self {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        Self {
            snapshot: Snapshot::new(&arm, q, dq).expect("a mass matrix"),
            wrench: Wrench::default(),
            external: SVector::zeros(),
            departed: None,
            excess: None,
            joint_speed: 0.0,
            force_n: 0.0,
            elapsed_s: 0.0,
            period_s: 1e-3,
            procedure: Procedure {
                motion: Procedure::default().paper().motion,
                ..Procedure::default()
            },
            joints: core::array::from_fn(|i| iiwa7().joints[i].limits),
        }
    }

    /// What the phase sees.
    pub(super) fn env(&self) -> Env<'_, 7> {
        Env {
            snapshot: &self.snapshot,
            wrench: self.wrench,
            external: &self.external,
            departed: self.departed.as_ref(),
            excess: self.excess,
            tau: &[0.0; 7],
            joint_speed: self.joint_speed,
            force_n: self.force_n,
            procedure: &self.procedure,
            speeds: &[1.0; 7],
            joints: &self.joints,
            period_s: self.period_s,
            elapsed_s: self.elapsed_s,
            time_us: 0,
            tick: 0,
        }
    }

    /// The Cartesian state of an arm that has engaged its spring here.
    pub(super) fn engaged(&self, direction: Vector3<f64>) -> CartesianState<7> {
        let mut cartesian = CartesianState {
            direction,
            ..CartesianState::default()
        };
        cartesian.engage(&self.snapshot, Stiffness::isotropic(50.0, 200.0));
        cartesian
    }
}
