//! The laser tracker measures what Section 4.3 of the paper measured: 284 configurations to
//! calibrate from, 125 to validate, and the arcs.

use spherecal_link::LinkError;
use spherecal_model::{LaserShot, TrackerSession};
use spherecal_plan::laser::{LaserPlanError, plan};
use spherecal_shared::robot::{Robot, Tool};

/// Why a tracker did not measure.
#[derive(Debug, thiserror::Error)]
pub enum TrackerError {
    /// The robot that shows the reflector failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// A tracker defined outside this crate failed.
    #[error("{source}")]
    Device {
        /// What failed, in its own words.
        source: Box<dyn std::error::Error + Send + Sync>,
        /// Whether the user's input is at fault.
        input: bool,
    },
}

impl TrackerError {
    /// Whether the user's input is at fault (exit code 2), not the tracker.
    pub fn is_input(&self) -> bool {
        match self {
            Self::Link(e) => e.is_input(),
            Self::Device { input, .. } => *input,
        }
    }
}

/// Why the laser plan was not measured.
#[derive(Debug, thiserror::Error)]
pub enum LaserMeasurementError {
    /// There is no plan.
    #[error(transparent)]
    Plan(#[from] LaserPlanError),
    /// The tracker failed.
    #[error(transparent)]
    Tracker(#[from] TrackerError),
}

/// A laser tracker, and the robot that shows it its reflector.
pub trait Tracker {
    /// The robot stands at `q` (rad) and the tracker, set up for `session`, measures. Returns the
    /// joint angles that the encoders show, in rad, and the point in the tracker's frame, in m.
    ///
    /// # Errors
    /// When robot or tracker fail.
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), TrackerError>;
}

/// Measures the whole laser plan of a robot with its nominal tool; `seed` is the seed of the plan.
///
/// # Errors
/// There is no plan, or the tracker fails.
///
pub fn measure_laser(
    robot: &Robot,
    tool: &Tool,
    seed: u64,
    tracker: &mut dyn Tracker,
) -> Result<Vec<LaserShot>, LaserMeasurementError> {
    let plan = plan(robot, tool, seed)?;
    let mut shots = Vec::new();
    let mut take = |session, purpose: &str, configurations: &[Vec<f64>]| -> Result<(), TrackerError> {
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
        let purpose = format!("{}{}", LaserShot::BASE, arc.joint);
        take(TrackerSession::BaseArcs, &purpose, &arc.configurations)?;
    }
    for arc in &plan.tool_arcs {
        let purpose = format!("{}{}", LaserShot::TOOL, arc.joint);
        take(TrackerSession::ToolArcs, &purpose, &arc.configurations)?;
    }
    take(TrackerSession::Measurement, LaserShot::CALIBRATE, &plan.calibration)?;
    take(TrackerSession::Measurement, LaserShot::VALIDATE, &plan.validation)?;
    Ok(shots)
}
