//! What a run is made of: the prepared data, and what the program simulates in its own process. The job knows the trait
//! [`Simulator`] and no simulation: the program chooses one.

use std::borrow::Cow;
use std::fmt::Debug;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use spherecal_shared::procedure::Procedure;
use spherecal_shared::robot::{Robot, Tool};

use spherecal_campaign::{Operator, Tracker};
use spherecal_identify::Sphere;
use spherecal_link::{Device, Drive, Injected, Journal};
use spherecal_model::chain::Chain;
use spherecal_model::robots::RobotModel;
use spherecal_plan::{self as plan, Plan};

use super::{Config, JobError, Link};

/// All data that are known before the first motion.
#[derive(Clone, Debug)]
pub struct PreparedRun {
    /// Configuration.
    pub config: Config,
    /// Robot as the host holds it.
    pub model: RobotModel,
    /// Nominal robot.
    pub robot: Robot,
    /// Nominal tool, in the frame of the robot's table.
    pub tool: Tool,
    /// The plate's certificate.
    pub spheres: Vec<Sphere>,
    /// The plan, with the waypoints as taught, or with the simulated error of teaching.
    pub plan: Plan,
    /// The plan without the simulated error of teaching, where `plan` has it.
    pub untaught: Option<Plan>,
    /// What is simulated in this process.
    pub simulator: Arc<dyn Simulator>,
}

impl PreparedRun {
    /// The same for the arm that is there. The simulated error of teaching is for simulated arms alone: the waypoints of
    /// any other arm, or of one of which nobody has said what it is, stay where they were planned.
    pub(super) fn for_arm(&self, simulated: Option<bool>) -> Cow<'_, Self> {
        match &self.untaught {
            Some(plan) if simulated != Some(true) => Cow::Owned(Self {
                plan: plan.clone(),
                untaught: None,
                ..self.clone()
            }),
            _ => Cow::Borrowed(self),
        }
    }

    /// The procedure, with its limits narrowed to the space that the plan needs.
    ///
    /// # Errors
    /// No plan can be made for the robot.
    pub fn procedure(&self) -> Result<Procedure, JobError> {
        let mut procedure = self.config.carried_out();
        let chain = Chain::new(&self.robot, &self.tool)?;
        if let Some(bounds) = plan::Bounds::of(&self.plan, &chain) {
            let section = &self.config.plan;
            bounds.narrow(
                &mut procedure.limits,
                section.workspace_margin_m,
                section.plate_margin_m,
            );
        }
        Ok(procedure)
    }
}

/// The arm, the laser tracker and the faults that a program simulates in its own process.
pub trait Simulator: Debug + Send + Sync {
    /// Checks the sections of the configuration that describe what is simulated.
    ///
    /// # Errors
    /// The first section that cannot be used.
    fn check(&self, config: &Config) -> Result<(), JobError>;

    /// The arm, at rest at the home frame of the plan.
    ///
    /// # Errors
    /// An arm that cannot be simulated.
    fn arm(&self, prepared: &PreparedRun) -> Result<Box<dyn Drive>, JobError>;

    /// The same arm, and the operator who leads it by hand.
    ///
    /// # Errors
    /// An arm that cannot be simulated.
    fn guided_arm(&self, prepared: &PreparedRun) -> Result<(Box<dyn Drive>, Box<dyn Operator>), JobError>;

    /// The laser tracker beside the arm, before its first shot.
    ///
    /// # Errors
    /// An arm that cannot be simulated.
    fn tracker(&self, prepared: &PreparedRun) -> Result<Box<dyn Tracker + Send>, JobError>;

    /// The device of a run, with all faults that are injected into it.
    ///
    /// # Errors
    /// The link cannot be used, nothing answers there, another robot does, or a fault cannot be injected there.
    fn connect(&self, prepared: &PreparedRun, connection: Connection<'_>) -> Result<ConnectedDevice, JobError>;
}

/// How a run reaches its device.
pub struct Connection<'a> {
    /// The link.
    pub link: &'a Link,
    /// Folder for logs of the controller; it exists.
    pub folder: &'a Path,
    /// The device that [`connect_early`](crate::connect_early) has connected.
    pub early: Option<Box<dyn Device>>,
    /// Whether the run repeats one that was stopped.
    pub repeated: bool,
    /// Whether the store is a file on this computer.
    pub in_file: bool,
}

/// Puts the faults of this computer around a journal whose file is at the path.
pub type FaultyJournal = Box<dyn for<'j> Fn(&'j mut dyn Journal, PathBuf) -> Box<dyn Journal + 'j>>;

/// A device, with what is injected around it.
pub struct ConnectedDevice {
    /// The device.
    pub device: Box<dyn Device>,
    /// Faults of this computer; `None` if none are injected.
    pub journal: Option<FaultyJournal>,
    /// What was done to frames of the host link so far.
    pub injected: Box<dyn Fn() -> Injected>,
}
