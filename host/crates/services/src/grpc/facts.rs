//! The served robot: its description, the function that creates it, its latest telemetry.

use spherecal_link::{Device, LinkError};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::host::Sample;
use spherecal_shared::robot::{Robot, Tool};
use tokio::sync::watch;

/// Makes the robot, at the first client.
pub type DeviceFactory = Box<dyn Fn() -> Result<Box<dyn Device>, LinkError> + Send + Sync>;

/// What is known of the robot without asking it.
#[derive(Clone, Debug)]
pub struct RobotFacts {
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool.
    pub tool: Tool,
    /// Procedure for clients that give orders.
    pub procedure: Procedure,
    /// Home frame, in rad.
    pub home: Vec<f64>,
}

/// Holds the newest telemetry for observers.
pub(super) type Newest = watch::Sender<Option<Sample>>;
