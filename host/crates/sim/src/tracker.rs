//! The plant's laser tracker, for a robot whose number of joints is known at run time.

use spherecal_link::LinkError;
use spherecal_model::TrackerSession;
use spherecal_shared::robot::{Robot, Tool};

use crate::plant::{Plant, PlantConfig};
use crate::simulated::SimulatedArmError;

/// What the tracker needs of a plant.
trait Shots: Send {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError>;
}

impl<const N: usize> Shots for Plant<N> {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> {
        let q: &[f64; N] = q.try_into().map_err(|_| LinkError::OtherRobot {
            drive: N,
            robot: q.len(),
        })?;
        self.tracker_session(session);
        let shot = self.tracker_shot(q);
        Ok((shot.q_encoder.to_vec(), shot.point_m))
    }
}

/// The simulated tracker of an arm, in its state before the first shot.
pub struct SimulatedTracker(Box<dyn Shots>);

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
        ) -> Result<Box<dyn Shots>, SimulatedArmError> {
            Ok(Box::new(Plant::<N>::new(robot, tool, config, &[0.0; N])?))
        }
        match robot.dof() {
            6 => made::<6>(robot, tool, config).map(Self),
            7 => made::<7>(robot, tool, config).map(Self),
            joints => Err(LinkError::Joints {
                joints,
                built: "6 and 7",
            }
            .into()),
        }
    }

    /// The arm stands at `q` (rad) and the tracker, set up for `session`, measures. Returns the
    /// joint angles that the encoders show, in rad, and the point in the tracker's frame, in m.
    ///
    /// # Errors
    /// The number of angles differs from the number of joints.
    ///
    pub fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), LinkError> {
        self.0.shot(session, q)
    }
}
