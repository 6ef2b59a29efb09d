//! The simulation that this program offers to the job: the arm, the tracker and the injected faults of `spherecal-sim`.
//!
//! `[plant]` of the configuration describes the arm ([`plant`]), `[host_link]` the quality of the host link.

mod connect;

use std::sync::Arc;

use spherecal_campaign::{Operator, Tracker, TrackerError};
use spherecal_job::{
    self as job, Config, ConnectedDevice, Connection, DEFAULT_PRESET, JobError, PreparedRun, Simulator,
};
use spherecal_link::{Drive, LinkError};
use spherecal_model::TrackerSession;
use spherecal_sim::inject::{FaultPlan, FaultyCellError, InjectError};
use spherecal_sim::plant::{PRESETS, PlantConfig, PlantError};
use spherecal_sim::{
    OperatorCall, RobotArm, SimulatedArmError, SimulatedTracker, UrArm, hand_guided_arm, simulated_arm, with_ur_motors,
};
use toml::{Table, Value};

pub use connect::file_lock;

/// Why nothing can be simulated as asked.
#[derive(Debug, thiserror::Error)]
pub enum SimulationError {
    /// The section `[plant]` does not fit together.
    #[error("plant: {0}")]
    Section(String),
    /// The arm is impossible.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A fault cannot be injected.
    #[error(transparent)]
    Inject(#[from] InjectError),
    /// Drive or controller were refused.
    #[error(transparent)]
    Link(#[from] LinkError),
}

impl From<SimulationError> for JobError {
    fn from(error: SimulationError) -> Self {
        match error {
            SimulationError::Link(error) => error.into(),
            refused => Self::Simulation(Box::new(refused)),
        }
    }
}

impl From<SimulatedArmError> for SimulationError {
    fn from(error: SimulatedArmError) -> Self {
        match error {
            SimulatedArmError::Plant(error) => error.into(),
            SimulatedArmError::Link(error) => error.into(),
        }
    }
}

impl From<FaultyCellError> for SimulationError {
    fn from(error: FaultyCellError) -> Self {
        match error {
            FaultyCellError::Inject(error) => error.into(),
            FaultyCellError::Link(error) => error.into(),
        }
    }
}

/// The simulated cell, with the faults that are injected into it.
#[derive(Clone, Debug, Default)]
pub struct SimulatedCell {
    /// Faults to inject; `None` by default.
    pub inject: Option<FaultPlan>,
}

impl SimulatedCell {
    /// A cell without faults, for [`job::prepare`].
    pub fn sound() -> Arc<dyn Simulator> {
        Arc::new(Self::default())
    }
}

impl Simulator for SimulatedCell {
    fn check(&self, config: &Config) -> Result<(), JobError> {
        plant(config)?;
        Ok(())
    }

    fn arm(&self, prepared: &PreparedRun) -> Result<Box<dyn Drive>, JobError> {
        let plant = plant(&prepared.config)?;
        let arm = simulated_arm(&prepared.robot, &prepared.tool, &plant, &prepared.plan.home.joints);
        Ok(arm.map_err(SimulationError::from)?)
    }

    fn guided_arm(&self, prepared: &PreparedRun) -> Result<(Box<dyn Drive>, Box<dyn Operator>), JobError> {
        let plant = plant(&prepared.config)?;
        let height_m = prepared.config.plan.approach_height_m;
        let home = &prepared.plan.home.joints;
        let arm = hand_guided_arm(&prepared.robot, &prepared.tool, &plant, home, height_m);
        let (drive, call) = arm.map_err(SimulationError::from)?;
        Ok((drive, Box::new(SimulatedOperator(call))))
    }

    fn tracker(&self, prepared: &PreparedRun) -> Result<Box<dyn Tracker + Send>, JobError> {
        let plant = plant(&prepared.config)?;
        let tracker = SimulatedTracker::new(&prepared.robot, &prepared.tool, &plant);
        Ok(Box::new(TrackerBeside(tracker.map_err(SimulationError::from)?)))
    }

    fn connect(&self, prepared: &PreparedRun, connection: Connection<'_>) -> Result<ConnectedDevice, JobError> {
        connect::connect(self.inject.as_ref(), prepared, connection)
    }
}

/// The operator beside the simulated arm.
struct SimulatedOperator(OperatorCall);

impl Operator for SimulatedOperator {
    fn lead(&mut self, sphere: u32) {
        // Ids count from 1, the plate's spheres from 0.
        self.0.lead_to(sphere.saturating_sub(1) as usize);
    }

    fn is_there(&mut self) -> bool {
        self.0.is_there()
    }

    fn let_go(&mut self) {
        self.0.let_go();
    }
}

struct TrackerBeside(SimulatedTracker);

impl Tracker for TrackerBeside {
    fn shot(&mut self, session: TrackerSession, q: &[f64]) -> Result<(Vec<f64>, [f64; 3]), TrackerError> {
        Ok(self.0.shot(session, q)?)
    }
}

/// Checks the configuration, also what it says of the simulated arm.
///
/// # Errors
/// The first value that cannot be used.
pub fn check(config: &Config) -> Result<(), JobError> {
    config.check()?;
    plant(config)?;
    Ok(())
}

/// [`job::prepare`] with a simulated cell without faults.
///
/// # Errors
/// Any error in the input.
pub fn prepare(config: &Config) -> Result<PreparedRun, JobError> {
    job::prepare(config, SimulatedCell::sound())
}

/// The simulated arm that a run with this configuration calibrates, at rest at its home frame.
///
/// # Errors
/// Any error in the input.
pub fn drive(config: &Config) -> Result<Box<dyn Drive>, JobError> {
    let plant = plant(config)?;
    let (model, tool, home) = job::at_home(config)?;
    Ok(simulated_arm(&model.robot, &tool, &plant, &home).map_err(SimulationError::from)?)
}

/// The same arm behind a robot's own interface, for a simulated Franka robot or KUKA cabinet.
/// `impedance`: stiffness (N m/rad) and damping (N m s/rad) that the cabinet's application sets.
///
/// # Errors
/// Any error in the input; a robot with another number of joints than 7.
pub fn robot(config: &Config, impedance: (f64, f64)) -> Result<RobotArm, JobError> {
    let plant = plant(config)?;
    let (model, _, home) = job::at_home(config)?;
    Ok(RobotArm::new(&model, &plant, &home, impedance).map_err(SimulationError::from)?)
}

/// The simulated arm of a configuration, behind the interfaces of Universal Robots. Its motors show.
///
/// # Errors
/// The configuration cannot be used, or its robot has not six joints.
pub fn ur_robot(config: &Config) -> Result<UrArm, JobError> {
    let plant = with_ur_motors(&plant(config)?);
    let (model, _, home) = job::at_home(config)?;
    Ok(UrArm::new(&model, &plant, &home).map_err(SimulationError::from)?)
}

/// The simulated arm of a configuration: the preset with the changed errors, the job's seed, and the cell.
///
/// # Errors
/// An unknown preset or field, or a number out of range.
pub fn plant(config: &Config) -> Result<PlantConfig, SimulationError> {
    let section = SimulationError::Section;
    let mut table = config.plant.clone();
    let preset = match table.remove("preset") {
        None => DEFAULT_PRESET.to_owned(),
        Some(Value::String(name)) => name,
        Some(other) => {
            return Err(section(format!(
                "preset is {other}: give one of {}",
                PRESETS.join(", ")
            )));
        }
    };
    let mut whole = Table::try_from(PlantConfig::preset(&preset)?).map_err(|e| section(e.to_string()))?;
    merge(&mut whole, table);
    let mut plant: PlantConfig = whole
        .try_into()
        .map_err(|e: toml::de::Error| section(e.to_string().trim_end().to_owned()))?;
    if !config.plant.contains_key("seed") {
        plant.seed = config.seed;
    }
    plant.cell = config.cell.nominal();
    plant.check()?;
    Ok(plant)
}

/// Writes `over` into `base`, table by table.
fn merge(base: &mut Table, over: Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(Value::Table(inner)), Value::Table(new)) => merge(inner, new),
            // A whole number in the place of a float is read as a float.
            (Some(slot @ Value::Float(_)), Value::Integer(whole)) => {
                *slot = Value::Float(whole as f64);
            }
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}
