//! The first run on a robot as a stage of the job: the five steps, and their reports in the store.
//!
//! A commissioning is a run of the store whose state is [`RunInfo::COMMISSIONED`]: what it measured is a result of that
//! run, protected like every other. It is no calibration: history, trend and `--resume` pass over it.

use std::path::Path;
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use spherecal_campaign::commission::{
    Attendant, CommissioningStep, MovingLimits, ReadOnlyLimits, StepEnd, StepReport, commission_moving,
    commission_read_only,
};
use spherecal_campaign::{Assignment, CampaignObserver};
use spherecal_fci::wire::Version;
use spherecal_link::{DriveReader, FrankaReader, JournalError, KukaReader, StateReader, UrReader};
use spherecal_store::{CalibrationStore, RunInfo};

use super::connect::device;
use super::measure::create_run;
use super::{JobError, Link, PreparedRun, store_error};

/// Name of a commissioning among a run's results.
const COMMISSIONING: &str = "commissioning";

/// What a commissioning found.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub struct Commissioning {
    /// Number of the run in the store; none before the first step has ended.
    pub run: Option<i64>,
    /// When it was begun, UTC, RFC 3339.
    pub created_utc: String,
    /// Link, as on the command line.
    pub link: String,
    /// Robot.
    pub robot: String,
    /// Which one: its serial number or name.
    pub arm: String,
    /// Whether the arm is simulated, as the link or, from step 2 on, the controller tells.
    pub simulated: bool,
    /// The steps that were begun, in order.
    pub steps: Vec<StepReport>,
}

impl Commissioning {
    /// Whether every step has passed.
    pub fn passed(&self) -> bool {
        self.steps.len() == CommissioningStep::ALL.len() && self.steps.iter().all(|s| s.verdict == StepEnd::Passed)
    }
}

/// Passes everything on to the person, and keeps the reports.
struct Keeping<'a> {
    person: &'a mut dyn Attendant,
    store: &'a mut dyn CalibrationStore,
    prepared: &'a PreparedRun,
    link: &'a Link,
    found: Commissioning,
}

impl Keeping<'_> {
    fn keep(&mut self) -> Result<(), JobError> {
        let run = if let Some(run) = self.found.run {
            run
        } else {
            let run = create_run(self.prepared, self.link, self.store)?;
            self.store.set_state(run, RunInfo::COMMISSIONED)?;
            self.found.run = Some(run);
            run
        };
        let json = serde_json::to_string(&self.found).map_err(|e| JobError::Encode {
            what: COMMISSIONING,
            message: e.to_string(),
        })?;
        Ok(self.store.put_result(run, COMMISSIONING, &json)?)
    }
}

impl Attendant for Keeping<'_> {
    fn tell(&mut self, text: &str) {
        self.person.tell(text);
    }

    fn ask(&mut self, question: &str) {
        self.person.ask(question);
    }

    fn answer(&mut self) -> Option<bool> {
        self.person.answer()
    }

    fn simulated(&mut self) {
        self.found.simulated = true;
        self.person.simulated();
    }

    fn done(&mut self, report: &StepReport) -> Result<(), JournalError> {
        let report = StepReport {
            ended_utc: spherecal_store::time::now_utc(),
            ..report.clone()
        };
        self.found.steps.push(report.clone());
        self.keep().map_err(|error| match error {
            JobError::Store(error) => store_error(error),
            other => JournalError::store(other),
        })?;
        self.person.done(&report)
    }
}

/// A reader of the robot behind the link, which commands nothing.
fn reader(prepared: &PreparedRun, link: &Link) -> Result<Box<dyn StateReader>, JobError> {
    Ok(match link {
        Link::Franka { host, port } => {
            let reader = FrankaReader::connect(host, *port)?;
            let found = reader.robot();
            let configured = prepared.config.robot.as_str();
            if Version::ROBOTS.contains(&configured) && configured != found {
                return Err(JobError::OtherRobot {
                    link: link.to_string(),
                    found,
                    configured: configured.to_owned(),
                });
            }
            Box::new(reader)
        }
        Link::Fri(address) => Box::new(KukaReader::listen(*address)?),
        Link::Ur { host, port } => Box::new(UrReader::connect(host, *port)?),
        Link::Tcp(address) => Box::new(DriveReader::connect(address)?),
        Link::Sim => Box::new(DriveReader::new(prepared.simulator.arm(prepared)?)?),
        other => {
            return Err(JobError::NotCommissioned {
                link: other.to_string(),
            });
        }
    })
}

/// Commissions the robot behind the link: reads it, then holds it, moves it and has it touch sphere 1, as far as the steps
/// pass and the person agrees. Each report is in the store before the next step.
///
/// # Errors
/// The link, the store or the input fails, or the user interrupts. A step that fails is no error.
pub fn commission(
    prepared: &PreparedRun,
    link: &Link,
    folder: &Path,
    store: &mut dyn CalibrationStore,
    person: &mut dyn Attendant,
    observer: &mut dyn CampaignObserver,
    interrupt: &AtomicBool,
) -> Result<Commissioning, JobError> {
    let mut keeping = Keeping {
        person,
        store,
        prepared,
        link,
        found: Commissioning {
            created_utc: spherecal_store::time::now_utc(),
            link: link.to_string(),
            robot: prepared.robot.name.to_string(),
            arm: prepared.config.arm.clone(),
            simulated: link.simulated(),
            ..Commissioning::default()
        },
    };
    let first = {
        let mut reader = reader(prepared, link)?;
        commission_read_only(
            reader.as_mut(),
            &prepared.robot,
            &prepared.tool,
            &ReadOnlyLimits::default(),
            &mut keeping,
            interrupt,
        )?
    };
    if first.verdict == StepEnd::Passed {
        let mut device = device(prepared, link, folder)?;
        let prepared = &*prepared.for_arm(device.simulated());
        let done = std::collections::BTreeSet::new();
        let procedure = link.adapt(prepared.config.procedure);
        let assignment = Assignment {
            robot: &prepared.robot,
            tool: &prepared.tool,
            procedure: &procedure,
            plan: &prepared.plan,
            done: &done,
            seated: &[],
            options: prepared.config.campaign.options(),
        };
        let limits = MovingLimits::default();
        commission_moving(&assignment, device.as_mut(), &limits, &mut keeping, observer, interrupt)?;
    }
    Ok(keeping.found)
}

/// The commissionings of one arm, or of all if `arm` is empty; oldest first.
///
/// # Errors
/// When the store fails, or a stored commissioning does not decode.
pub fn commissionings(store: &mut dyn CalibrationStore, arm: &str) -> Result<Vec<Commissioning>, JobError> {
    let mut found = Vec::new();
    for info in store.runs_of(arm)?.into_iter().filter(|info| !info.is_calibration()) {
        let Some(json) = store.result(info.run, COMMISSIONING)? else {
            continue;
        };
        let stored: Commissioning = serde_json::from_str(&json).map_err(|e| JobError::Encode {
            what: "the stored commissioning",
            message: format!("{e}; it was written by another version"),
        })?;
        found.push(Commissioning {
            run: Some(info.run),
            ..stored
        });
    }
    Ok(found)
}
