//! The simulated laser tracker measures what Section 4.3 of the paper measured:
//! 284 configurations to calibrate from, 125 to validate, and the arcs.

use super::{JobError, Prepared};
use crate::laser;
use crate::plant::{Plant, TrackerSession};
use crate::store::LaserShot;

/// What shots were made for, as the store names it.
pub(super) const CALIBRATE: &str = "calibrate";
pub(super) const VALIDATE: &str = "validate";
pub(super) const BASE: &str = "base_";
pub(super) const TOOL: &str = "tool_";

/// Measures the whole laser plan with the plant's tracker.
///
/// # Errors
/// A plan or a plant that cannot be made.
pub fn measure_laser(prepared: &Prepared) -> Result<Vec<LaserShot>, JobError> {
    match prepared.robot.dof() {
        6 => shots::<6>(prepared),
        7 => shots::<7>(prepared),
        joints => Err(crate::link::LinkError::Joints {
            joints,
            built: "6 and 7",
        }
        .into()),
    }
}

fn shots<const N: usize>(prepared: &Prepared) -> Result<Vec<LaserShot>, JobError> {
    let plan = laser::plan(&prepared.robot, &prepared.tool, prepared.config.seed)?;
    let mut plant = Plant::<N>::new(&prepared.robot, &prepared.tool, &prepared.plant, &[0.0; N])?;
    let mut shots = Vec::new();
    let mut take = |plant: &mut Plant<N>, purpose: &str, configurations: &[Vec<f64>]| {
        for q in configurations {
            // The plan is made for this robot: every configuration has N joints.
            if let Ok(q) = <&[f64; N]>::try_from(q.as_slice()) {
                let shot = plant.tracker_shot(q);
                shots.push(LaserShot {
                    purpose: purpose.to_owned(),
                    q: shot.q_encoder.to_vec(),
                    point_m: shot.point_m,
                });
            }
        }
    };
    plant.tracker_session(TrackerSession::BaseArcs);
    for arc in &plan.base_arcs {
        take(&mut plant, &format!("{BASE}{}", arc.joint), &arc.configurations);
    }
    plant.tracker_session(TrackerSession::ToolArcs);
    for arc in &plan.tool_arcs {
        take(&mut plant, &format!("{TOOL}{}", arc.joint), &arc.configurations);
    }
    plant.tracker_session(TrackerSession::Measurement);
    take(&mut plant, CALIBRATE, &plan.calibration);
    take(&mut plant, VALIDATE, &plan.validation);
    Ok(shots)
}
