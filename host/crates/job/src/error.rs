//! Why the main job stopped.

use spherecal_campaign::{CampaignError, LaserMeasurementError};
use spherecal_identify::EvaluateError;
use spherecal_link::LinkError;
use spherecal_link::qemu::QemuError;
use spherecal_model::ChainError;
use spherecal_model::robots::RobotFileError;
use spherecal_plan::PlanError;
use spherecal_report::ChartError;
use spherecal_results::WriteError;
use spherecal_services::ServiceError;
use spherecal_store::StoreError;

use super::ConfigError;

impl From<WriteError> for JobError {
    fn from(WriteError { path, source }: WriteError) -> Self {
        Self::Write { path, source }
    }
}

/// What can end the main job.
#[derive(Debug, thiserror::Error)]
pub enum JobError {
    /// The configuration was refused.
    #[error(transparent)]
    Config(#[from] ConfigError),
    /// The robot was refused.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// No plan could be made.
    #[error(transparent)]
    Plan(#[from] PlanError),
    /// No pose of the plan can be visited.
    #[error("none of the {planned} poses is within reach: move the plate, or relax the limits in [plan.rules]")]
    NoPose {
        /// Poses considered.
        planned: usize,
    },
    /// The arm has not the torque to leave a sphere against the magnet.
    #[error(
        "a magnet of {magnet_n} N (procedure.decouple.magnet_n) needs {needed_nm:.0} N m of joint {joint} to leave sphere {sphere}, and the \
         joint gives {limit_nm:.0} N m: take a weaker magnet, or move the plate nearer to the robot"
    )]
    Magnet {
        /// Holding force, in N.
        magnet_n: f64,
        /// Id of the sphere.
        sphere: u32,
        /// Joint, from 1.
        joint: usize,
        /// Torque against gravity and magnet, in N m.
        needed_nm: f64,
        /// The joint's limit, in N m.
        limit_nm: f64,
    },
    /// What is to be simulated or injected was refused.
    #[error(transparent)]
    Simulation(Box<dyn std::error::Error + Send + Sync>),
    /// The plate is out of the arm's reach; suggests a reachable placement.
    #[error(
        "{source}. With these lines in the configuration (--config) the arm reaches the whole plate:\n\n\
         [[cell.placements]]\norigin_m = {origin_m:?}\nrpy_rad = {rpy_rad:?}\n"
    )]
    PlateOutOfReach {
        /// What is out of reach.
        source: PlanError,
        /// Place of sphere 1 in F0, in m.
        origin_m: [f64; 3],
        /// Roll, pitch and yaw of the plate in F0, in rad.
        rpy_rad: [f64; 3],
    },
    /// The link was refused or failed.
    #[error(transparent)]
    Link(#[from] LinkError),
    /// The controller in QEMU cannot be used.
    #[error(transparent)]
    Qemu(#[from] QemuError),
    /// Another number of motors than of joints.
    #[error(
        "cell.drive.motor_kg_m2 has {found} values, but the robot has {joints} joints: give one inertia for each joint, \
         base to flange, or leave the field out"
    )]
    Motors {
        /// Values given.
        found: usize,
        /// Joints of the robot.
        joints: usize,
    },
    /// Nothing can be injected over this link.
    #[error("link \"{link}\": {remedy}")]
    NoInjection {
        /// As given.
        link: String,
        /// What to give instead.
        remedy: String,
    },
    /// The link does not lead to a robot's own interface.
    #[error("link \"{link}\" is no robot's own interface: give franka:HOST or fri:PORT")]
    NoRobot {
        /// As given.
        link: String,
    },
    /// The link leads to no robot that can be commissioned.
    #[error(
        "link \"{link}\": a robot is commissioned where it is connected: give franka:HOST, fri:PORT, ur:HOST or tcp:HOST:PORT \
         (or sim, to try it)"
    )]
    NotCommissioned {
        /// As given.
        link: String,
    },
    /// The robot behind the link is not the configured one.
    #[error(
        "link \"{link}\": the robot there is a {found}, but the configuration has robot = \"{configured}\": correct it"
    )]
    OtherRobot {
        /// The link.
        link: String,
        /// What the robot says it is.
        found: &'static str,
        /// What the configuration says.
        configured: String,
    },
    /// The campaign stopped.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A service could not be offered or reached.
    #[error(transparent)]
    Service(#[from] ServiceError),
    /// The store refused or failed.
    #[error(transparent)]
    Store(#[from] StoreError),
    /// There is nothing to go on with.
    #[error("{what}: {remedy}")]
    Resume {
        /// What does not fit.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// Waypoints that cannot be used.
    #[error("{what}: {remedy}")]
    Waypoints {
        /// What is wrong.
        what: String,
        /// What to do.
        remedy: &'static str,
    },
    /// The laser tracker did not measure.
    #[error(transparent)]
    LaserMeasurement(#[from] LaserMeasurementError),
    /// The recordings could not be evaluated.
    #[error(transparent)]
    Evaluate(#[from] EvaluateError),
    /// A file could not be written.
    #[error("{path}: {source}: check the folder, its permissions and its free space")]
    Write {
        /// File.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// Something could not be encoded.
    #[error("{what} cannot be written: {message}")]
    Encode {
        /// What.
        what: &'static str,
        /// Why.
        message: String,
    },
    /// The report could not be made.
    #[error("the report could not be made: {0}")]
    Report(#[from] ChartError),
    /// This program was built without the requested feature.
    #[error(
        "{what} needs the feature `{feature}`, which this program was built without: build it with --features {feature}"
    )]
    Feature {
        /// What is asked for.
        what: &'static str,
        /// Which feature brings it.
        feature: &'static str,
    },
}

impl From<ChainError> for JobError {
    fn from(error: ChainError) -> Self {
        Self::Plan(error.into())
    }
}

impl JobError {
    /// Whether the user's input is the cause (exit code 2), not the job (1).
    pub fn is_input(&self) -> bool {
        match self {
            Self::Config(_)
            | Self::Robot(_)
            | Self::Plan(_)
            | Self::PlateOutOfReach { .. }
            | Self::NoPose { .. }
            | Self::Magnet { .. }
            | Self::Motors { .. }
            | Self::Simulation(_)
            | Self::NoInjection { .. }
            | Self::NoRobot { .. }
            | Self::NotCommissioned { .. }
            | Self::OtherRobot { .. }
            | Self::Resume { .. }
            | Self::Waypoints { .. }
            | Self::Feature { .. }
            | Self::LaserMeasurement(LaserMeasurementError::Plan(_)) => true,
            Self::Store(e) => e.is_input(),
            Self::Service(e) => e.is_input(),
            Self::Link(e) => e.is_input(),
            Self::LaserMeasurement(LaserMeasurementError::Tracker(e)) => e.is_input(),
            Self::Qemu(QemuError::NoQemu | QemuError::NoImage { .. } | QemuError::LogPath { .. }) => true,
            Self::Qemu(_)
            | Self::Campaign(_)
            | Self::Evaluate(_)
            | Self::Write { .. }
            | Self::Encode { .. }
            | Self::Report(_) => false,
        }
    }
}
