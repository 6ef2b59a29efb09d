//! Why the main job stopped.

use crate::campaign::CampaignError;
use crate::identify::IdentifyError;
use crate::inject::{InjectError, UpsettingError};
use crate::laser;
use crate::link::qemu::QemuError;
use crate::link::{LinkError, SimulatedArmError};
use crate::plan::PlanError;
use crate::plant::PlantError;
use crate::robots::RobotFileError;
use crate::rpc::RpcError;
use crate::store::StoreError;
use crate::validate::ValidateError;

use super::ConfigError;

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
    #[error(
        "none of the {planned} poses is within reach: move the plate, or allow more of the arm's range in [plan.rules]"
    )]
    NoPose {
        /// Poses considered.
        planned: usize,
    },
    /// The plant was refused.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// The plate stands where the arm cannot work, and a place where it can.
    #[error(
        "{source}. At this place the arm reaches all of it; write into the configuration (--config):\n\n\
         [plant.plate]\norigin_m = {origin_m:?}\nrpy_rad = {rpy_rad:?}\n"
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
    /// Nothing can be injected over this link.
    #[error("link \"{link}\": {remedy}")]
    NoInjection {
        /// As given.
        link: String,
        /// What to give instead.
        remedy: String,
    },
    /// What was to be injected was refused.
    #[error(transparent)]
    Inject(#[from] InjectError),
    /// The campaign stopped.
    #[error(transparent)]
    Campaign(#[from] CampaignError),
    /// A service could not be offered or reached.
    #[error(transparent)]
    Rpc(#[from] RpcError),
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
    /// No laser plan.
    #[error(transparent)]
    LaserPlan(#[from] laser::PlanError),
    /// The arcs gave no frames.
    #[error(transparent)]
    Laser(#[from] laser::LaserError),
    /// The data could not be identified.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// The models could not be judged.
    #[error(transparent)]
    Validate(#[from] ValidateError),
    /// A file could not be written.
    #[error("{path}: {source}: check the folder, its permissions and the space left")]
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
    Report(String),
}

impl From<SimulatedArmError> for JobError {
    fn from(error: SimulatedArmError) -> Self {
        match error {
            SimulatedArmError::Plant(e) => Self::Plant(e),
            SimulatedArmError::Link(e) => Self::Link(e),
        }
    }
}

impl From<UpsettingError> for JobError {
    fn from(error: UpsettingError) -> Self {
        match error {
            UpsettingError::Inject(e) => Self::Inject(e),
            UpsettingError::Link(e) => Self::Link(e),
        }
    }
}

impl JobError {
    /// Whether the user's input is at fault (exit code 2) and not the job (1).
    pub fn is_input(&self) -> bool {
        match self {
            Self::Config(_)
            | Self::Robot(_)
            | Self::Plan(_)
            | Self::PlateOutOfReach { .. }
            | Self::NoPose { .. }
            | Self::Plant(_)
            | Self::NoInjection { .. }
            | Self::Inject(_)
            | Self::Resume { .. }
            | Self::Waypoints { .. }
            | Self::LaserPlan(_) => true,
            Self::Store(e) => e.is_input(),
            Self::Rpc(e) => e.is_input(),
            Self::Link(LinkError::Joints { .. } | LinkError::Serial { .. } | LinkError::Baud { .. })
            | Self::Qemu(QemuError::NoQemu | QemuError::NoImage { .. } | QemuError::LogPath { .. }) => true,
            Self::Link(_)
            | Self::Qemu(_)
            | Self::Campaign(_)
            | Self::Laser(_)
            | Self::Identify(_)
            | Self::Validate(_)
            | Self::Write { .. }
            | Self::Encode { .. }
            | Self::Report(_) => false,
        }
    }
}
