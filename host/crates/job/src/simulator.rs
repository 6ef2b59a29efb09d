//! What a program simulates in its own process. The job knows this trait and no simulation: the program chooses one.

use std::fmt::Debug;
use std::path::{Path, PathBuf};

use spherecal_campaign::{Operator, Tracker};
use spherecal_identify::Options;
use spherecal_link::{Device, Drive, Injected, Journal};

use super::{Config, JobError, Link, PreparedRun};

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

    /// Options of the comparison estimator that knows the statistical laws of the simulated errors, for an arm with `joints`
    /// joints; `None` without such laws.
    fn known_laws(&self, config: &Config, joints: usize) -> Option<Options>;
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
