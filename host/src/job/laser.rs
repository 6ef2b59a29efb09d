//! The laser tracker, here or behind gRPC, measures what Section 4.3 of the paper measured:
//! 284 configurations to calibrate from, 125 to validate, and the arcs.

use super::{JobError, Prepared};
use crate::laser;
use crate::link::LinkError;
use crate::plant::{Plant, TrackerSession};
use crate::store::LaserShot;

/// What shots were made for, as the store names it.
pub(super) const CALIBRATE: &str = "calibrate";
pub(super) const VALIDATE: &str = "validate";
pub(super) const BASE: &str = "base_";
pub(super) const TOOL: &str = "tool_";

/// A laser tracker, and the robot that shows it its reflector.
pub trait Tracker {
    /// The robot stands at `q` (rad) and the tracker, stationed for `session`,
    /// measures: the joint angles as the encoders show them, in rad, and the
    /// point in the tracker's frame, in m.
    ///
    /// # Errors
    /// When robot or tracker fail.
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), JobError>;
}

/// The plant's tracker.
struct Simulated<const N: usize>(Plant<N>);

impl<const N: usize> Tracker for Simulated<N> {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), JobError> {
        let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: N,
            robot: q.len(),
        })?;
        self.0.tracker_session(session);
        let shot = self.0.tracker_shot(q);
        Ok((shot.q_encoder.to_vec(), shot.point_m))
    }
}

/// The simulated tracker of a configuration, as it is before its first shot.
///
/// # Errors
/// A plant that cannot be made.
pub fn simulated_tracker(prepared: &Prepared) -> Result<Box<dyn Tracker + Send>, JobError> {
    fn made<const N: usize>(prepared: &Prepared) -> Result<Box<dyn Tracker + Send>, JobError> {
        let plant = Plant::<N>::new(&prepared.robot, &prepared.tool, &prepared.plant, &[0.0; N])?;
        Ok(Box::new(Simulated(plant)))
    }
    match prepared.robot.dof() {
        6 => made::<6>(prepared),
        7 => made::<7>(prepared),
        joints => Err(LinkError::Joints {
            joints,
            built: "6 and 7",
        }
        .into()),
    }
}

/// Measures the whole laser plan.
///
/// # Errors
/// No plan, or a tracker that fails.
pub fn measure_laser(prepared: &Prepared, tracker: &mut dyn Tracker) -> Result<Vec<LaserShot>, JobError> {
    let plan = laser::plan(&prepared.robot, &prepared.tool, prepared.config.seed)?;
    let mut shots = Vec::new();
    let mut take = |session, purpose: &str, configurations: &[Vec<f64>]| -> Result<(), JobError> {
        for q in configurations {
            let (q, point_m) = tracker.shot(session, q)?;
            shots.push(LaserShot {
                purpose: purpose.to_owned(),
                q,
                point_m,
            });
        }
        Ok(())
    };
    for arc in &plan.base_arcs {
        let purpose = format!("{BASE}{}", arc.joint);
        take(TrackerSession::BaseArcs, &purpose, &arc.configurations)?;
    }
    for arc in &plan.tool_arcs {
        let purpose = format!("{TOOL}{}", arc.joint);
        take(TrackerSession::ToolArcs, &purpose, &arc.configurations)?;
    }
    take(TrackerSession::Measurement, CALIBRATE, &plan.calibration)?;
    take(TrackerSession::Measurement, VALIDATE, &plan.validation)?;
    Ok(shots)
}
