//! The plant's laser tracker, for a robot whose number of joints is known at run time.

use spherecal_link::LinkError;
use spherecal_model::TrackerSession;
use spherecal_shared::robot::{Robot, Tool};

use crate::plant::{Plant, PlantConfig};
use crate::simulated::SimulatedArmError;

/// A shot of a session at joint angles (rad): what the encoders show (rad), and the point (m).
type Shot = dyn FnMut(TrackerSession, &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> + Send;

/// The simulated tracker of an arm, in its state before the first shot.
pub struct SimulatedTracker(Box<Shot>);

impl SimulatedTracker {
    /// The tracker of the arm that is drawn from `config`.
    ///
    /// # Errors
    /// The plant cannot be created, or this program was not built for the number of joints.
    pub fn new(robot: &Robot, tool: &Tool, config: &PlantConfig) -> Result<Self, SimulatedArmError> {
        fn made<const N: usize>(
            robot: &Robot,
            tool: &Tool,
            config: &PlantConfig,
        ) -> Result<SimulatedTracker, SimulatedArmError> {
            let mut plant = Plant::<N>::new(robot, tool, config, &[0.0; N])?;
            Ok(SimulatedTracker(Box::new(move |session, q| {
                let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
                    drive: N,
                    robot: q.len(),
                })?;
                plant.tracker_session(session);
                let shot = plant.tracker_shot(q);
                Ok((shot.q_encoder.to_vec(), shot.point_m))
            })))
        }
        match robot.dof() {
            6 => made::<6>(robot, tool, config),
            7 => made::<7>(robot, tool, config),
            joints => Err(LinkError::Joints { joints }.into()),
        }
    }

    /// The arm stands at `q` (rad) and the tracker, set up for `session`, measures. Returns the
    /// joint angles that the encoders show, in rad, and the point in the tracker's frame, in m.
    ///
    /// # Errors
    /// The number of angles differs from the number of joints.
    pub fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> {
        (self.0)(session, q)
    }
}
