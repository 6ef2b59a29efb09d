//! One arm with a shortened procedure, and one run of it with a plan of faults.

use std::collections::BTreeSet;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::atomic::AtomicBool;

use serde::{Deserialize, Serialize};
use spherecal_shared::protocol::host::{Coupled, FaultReport, Recording};

use super::FaultsError;
use super::judge::{JudgedArm, look};
use super::run_journal::RunJournal;
use spherecal::simulated::{SimulationError, plant, prepare};
use spherecal_campaign::{self as campaign, Assignment, CampaignError, Outcome, Silent, measure_laser};
use spherecal_identify::EvaluateError;
use spherecal_identify::validate::{Prediction, validate};
use spherecal_job::{Choice, Config, JobError, Link, Measurements, PreparedRun, evaluate};
use spherecal_link::{Device, JournalError, LinkError, controller_in_process};
use spherecal_model::LaserShot;
use spherecal_plan::Plan;
use spherecal_sim::inject::{FaultPlan, FaultyCell, FaultyDrive, Happened, HostKilled};

/// What a run's recordings calibrate to.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct CalibratedTrial {
    /// Mean error on the tracker's points, base fitted, in mm. The verdict does not see them.
    pub error_mm: f64,
    /// Upper end of the 95 % interval that the verdict states for it, in mm; `None` if it states none.
    pub stated_at_most_mm: Option<f64>,
    /// Names of the checks by which the job refuses the result; none if it may be used.
    pub refused_by: Vec<String>,
}

impl CalibratedTrial {
    /// Evaluates a run as the job does for a user without a tracker, then measures the error on `shots`.
    ///
    /// # Errors
    /// Recordings from which nothing can be identified.
    fn of(prepared: &PreparedRun, shots: &[LaserShot], trial: &FaultTrial) -> Result<Self, FaultsError> {
        let measured = Measurements {
            recordings: trial.recordings.clone(),
            rejected: trial.rejected.clone(),
            couplings: trial.couplings.clone(),
            faults: trial.faults.clone(),
            simulated_s: trial.robot_s,
            ..Measurements::before(prepared, &Link::Sim)
        };
        let found = evaluate(&measured, &mut |_| {})?;
        let models = [Prediction {
            name: "spheres".to_owned(),
            points_m: shots
                .iter()
                .map(|s| found.calibration.tcp_m(&s.q, None).into())
                .collect(),
            own_base: Some(found.calibration.base),
        }];
        let points: Vec<[f64; 3]> = shots.iter().map(|s| s.point_m).collect();
        let table = validate(&points, &found.calibration.base, &models)
            .map_err(EvaluateError::from)
            .map_err(JobError::from)?;
        let failed = found.verdict.checks.iter().filter(|c| c.refuses && !c.passed);
        Ok(Self {
            error_mm: table.models.first().map_or(f64::NAN, |m| m.best_fit.mean_mm),
            stated_at_most_mm: found.verdict.expected_error_mm.as_ref().map(|e| e.interval[1]),
            refused_by: failed.map(|c| c.name.to_owned()).collect(),
        })
    }
}

/// Why there is no such arm or cell, as the job says it.
fn refused(error: impl Into<SimulationError>) -> JobError {
    error.into().into()
}

/// One arm, its shortened tour, and the result of its undisturbed run.
pub struct Case {
    /// Seed of the arm.
    pub seed: u64,
    prepared: PreparedRun,
    plan: Plan,
    shots: Vec<LaserShot>,
    /// Control periods of the undisturbed run.
    pub ticks: u64,
    /// What it calibrated to; none if that was not requested.
    pub calibrated: Option<CalibratedTrial>,
}

/// How a run ended.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum TrialEnd {
    /// All poses recorded or given up.
    Finished,
    /// A typed stop with a remedy.
    Stopped(String),
    /// A stop that nothing documents.
    Unexplained(String),
    /// A panic.
    Panicked(String),
}

/// What a run came to.
#[derive(Clone, Debug)]
pub struct FaultTrial {
    /// How it ended.
    pub ended: TrialEnd,
    /// Its faults.
    pub faults: Vec<FaultReport>,
    /// The injected faults that began and ended.
    pub happened: Vec<Happened>,
    /// Recordings, as they were stored.
    pub recordings: Vec<Recording>,
    /// Recordings that should have been rejected, and why.
    pub bad: Vec<String>,
    /// Recordings stored twice.
    pub duplicates: usize,
    /// Recordings that the campaign counted but that are missing from the journal.
    pub lost: usize,
    /// Poses given up: sphere, pose.
    pub rejected: BTreeSet<(u32, u32)>,
    /// Couplings, in the order in which they came.
    pub couplings: Vec<Coupled>,
    /// The control period, from 1, in which the controller first moved the motors.
    pub ready_tick: u64,
    /// Times that the host was begun again.
    pub resumed: usize,
    /// Largest kinetic energy, in J.
    pub kinetic_j: f64,
    /// The control period in which it was reached, from 1.
    pub kinetic_tick: usize,
    /// Largest contact force that lasted 10 ms, in N.
    pub contact_n: f64,
    /// Longest time for which the contact force exceeded [`HELD_N`](super::judge::HELD_N), in s.
    pub held_s: f64,
    /// Largest force with which the arm pressed for 0.3 s, less the magnet's, in N.
    pub sustained_n: f64,
    /// The control period in which it was reached, from 1.
    pub sustained_tick: usize,
    /// Largest force with which the arm pressed for 10 ms, less the magnet's, in N.
    pub pressed_n: f64,
    /// The control period in which it was reached, from 1.
    pub pressed_tick: usize,
    /// Robot time, in s.
    pub robot_s: f64,
}

/// Preset of the arms on which the limits of the faults' tables were measured.
pub const MEASURED_ON: &str = "typical";
/// Hosts that are begun again at most.
const HOSTS: usize = 8;
/// Control periods until an operator has freed space on a full disk.
const ROOM_TICKS: u32 = 3000;

/// How much a case is to do.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Finish {
    /// A few poses on every sphere, to test the handling of faults.
    Record,
    /// Enough poses to calibrate, and a tracker to judge the result.
    Calibrate,
}

fn shortened(mut config: Config, finish: Finish) -> Config {
    config.plan.choice = Choice::Grid;
    config.plan.poses = match finish {
        Finish::Record => 6,
        Finish::Calibrate => 60,
    };
    config.plan.approach_height_m = 0.035;
    // A whole job also has the couplings that compare a sphere with itself; few poses stay few.
    config.campaign.confirm_seats = finish == Finish::Calibrate;
    config.campaign.second_visits = finish == Finish::Calibrate;
    let p = &mut config.procedure;
    p.couple.hold_s = 1.0;
    p.record.samples = 200;
    p.approach.tare_s = 0.2;
    config
}

impl Case {
    /// The arm of a seed, of the preset on which the limits of the faults' tables were measured. Runs
    /// it once undisturbed.
    ///
    /// # Errors
    /// The undisturbed run does not finish well.
    pub fn new(seed: u64, finish: Finish) -> Result<Self, FaultsError> {
        Self::on_preset(seed, MEASURED_ON, finish)
    }

    /// The arm of a seed with the errors of a preset. Runs it once undisturbed.
    ///
    /// # Errors
    /// An unknown preset, or the undisturbed run does not finish well.
    pub fn on_preset(seed: u64, preset: &str, finish: Finish) -> Result<Self, FaultsError> {
        let config = Config {
            seed,
            ..Config::default().on_preset(preset)
        };
        Self::of(config, finish)
    }

    /// The arm of a configuration, with the poses and the waiting times of a case. Runs it once
    /// undisturbed.
    ///
    /// # Errors
    /// The configuration is refused, or the undisturbed run does not finish well.
    pub fn of(config: Config, finish: Finish) -> Result<Self, FaultsError> {
        let seed = config.seed;
        let prepared = prepare(&shortened(config, finish))?;
        let mut case = Self {
            seed,
            plan: prepared.plan.clone(),
            shots: Vec::new(),
            ticks: 0,
            calibrated: None,
            prepared,
        };
        let clean = case.run(&FaultPlan::default())?;
        let faultless =
            clean.ended == TrialEnd::Finished && clean.bad.is_empty() && clean.recordings.len() == case.plan.recorded();
        if !faultless {
            return Err(FaultsError::Clean {
                seed,
                why: format!(
                    "{:?}, {} recordings, {:?}",
                    clean.ended,
                    clean.recordings.len(),
                    clean.bad
                ),
            });
        }
        case.ticks = (clean.robot_s * 1e3) as u64;
        if finish == Finish::Calibrate {
            let PreparedRun { robot, tool, .. } = &case.prepared;
            let mut tracker = case.prepared.simulator.tracker(&case.prepared)?;
            case.shots = measure_laser(robot, tool, seed, tracker.as_mut()).map_err(JobError::from)?;
            case.shots.retain(|s| s.purpose == LaserShot::VALIDATE);
            case.calibrated = Some(case.judge(&clean)?);
        }
        Ok(case)
    }

    /// Runs with a plan of faults.
    ///
    /// # Errors
    /// A plant, a controller or a plan that cannot be created.
    pub fn run(&self, plan: &FaultPlan) -> Result<FaultTrial, FaultsError> {
        match self.prepared.robot.dof() {
            6 => self.run_with::<6>(plan),
            _ => self.run_with::<7>(plan),
        }
    }

    fn run_with<const N: usize>(&self, plan: &FaultPlan) -> Result<FaultTrial, FaultsError> {
        let (robot, tool) = (&self.prepared.robot, &self.prepared.tool);
        let home: &[f64; N] = self.plan.home.joints.as_slice().try_into().map_err(|_| {
            JobError::from(LinkError::OtherRobot {
                drive: N,
                robot: self.plan.home.joints.len(),
            })
        })?;
        let plant = plant(&self.prepared.config).map_err(JobError::from)?;
        let (drive, judgement) = JudgedArm::new(robot, tool, &plant, home).map_err(refused)?;
        let drive = FaultyDrive::Simulated(Box::new(drive));
        let controller = controller_in_process(N).map_err(JobError::from)?;
        let restart = Box::new(|| controller_in_process(N));
        let mut device = FaultyCell::new(controller, drive, N, plan, restart).map_err(refused)?;
        let (happened, host_faults) = (device.happened(), device.host_faults());
        let mut records = RunJournal::new(&self.prepared, plan.faults.iter().any(|f| f.what.of_host()))?;
        let procedure = self.prepared.procedure()?;
        let mut outcome = Outcome::default();
        let mut resumed = 0;
        let ended = loop {
            let (done, seated) = (records.done()?, records.couplings()?);
            let assignment = Assignment {
                robot,
                tool,
                procedure: &procedure,
                plan: &self.plan,
                done: &done,
                seated: &seated,
                options: self.prepared.config.campaign.options(),
            };
            let mut journal = records.journal(&host_faults)?;
            let run = || {
                campaign::run(
                    &assignment,
                    &mut device,
                    journal.as_mut(),
                    &mut Silent,
                    &AtomicBool::new(false),
                )
            };
            let result = match catch_unwind(AssertUnwindSafe(run)) {
                Ok((more, result)) => {
                    add(&mut outcome, more);
                    result
                }
                Err(panic) => {
                    let why = panic.downcast_ref::<String>().cloned();
                    let why = why.or_else(|| panic.downcast_ref::<&str>().map(|s| (*s).to_owned()));
                    break TrialEnd::Panicked(why.unwrap_or_default());
                }
            };
            drop(journal);
            match result {
                Ok(()) => break TrialEnd::Finished,
                Err(CampaignError::Link(error)) if resumed < HOSTS && HostKilled::is_cause_of(&error) => {}
                Err(CampaignError::Journal(JournalError::Store(_))) if resumed < HOSTS => {
                    // The arm waits until an operator has freed space.
                    let mut unheard = Vec::new();
                    for _ in 0..ROOM_TICKS {
                        device.step(&[], &mut unheard).map_err(JobError::from)?;
                    }
                    host_faults.fill(false);
                }
                Err(error) => break stop(&error),
            }
            resumed += 1;
            records.reopen()?;
        };
        let judgement = look(&judgement);
        let recordings = records.recordings()?;
        Ok(FaultTrial {
            bad: recordings.iter().filter_map(|r| judgement.of(r)).collect(),
            lost: outcome.recorded.saturating_sub(recordings.len()),
            recordings,
            duplicates: records.duplicates(),
            rejected: outcome.rejected.iter().map(|r| (r.sphere, r.pose)).collect(),
            couplings: records.couplings()?,
            faults: outcome.faults,
            happened: look(&happened).clone(),
            ready_tick: judgement.ready_tick.unwrap_or(0),
            kinetic_j: judgement.kinetic_j,
            kinetic_tick: judgement.kinetic_tick,
            contact_n: judgement.contact_n,
            held_s: judgement.held_s,
            sustained_n: judgement.sustained_n,
            sustained_tick: judgement.sustained_tick,
            pressed_n: judgement.pressed_n,
            pressed_tick: judgement.pressed_tick,
            robot_s: device.now_us() as f64 * 1e-6,
            resumed,
            ended,
        })
    }

    /// What a run's recordings calibrate to.
    ///
    /// # Errors
    /// Recordings from which nothing can be identified.
    pub fn judge(&self, trial: &FaultTrial) -> Result<CalibratedTrial, FaultsError> {
        CalibratedTrial::of(&self.prepared, &self.shots, trial)
    }
}

/// Adds the outcome of another host to the outcomes of earlier ones.
fn add(sum: &mut Outcome, more: Outcome) {
    sum.recorded += more.recorded;
    sum.rejected.extend(more.rejected);
    // A controller that keeps running repeats to a new host what it told the previous one.
    for fault in more.faults {
        if !sum.faults.contains(&fault) {
            sum.faults.push(fault);
        }
    }
}

/// Whether a stop states a remedy.
fn stop(error: &CampaignError) -> TrialEnd {
    let text = error.to_string();
    match error {
        CampaignError::NoContact { .. }
        | CampaignError::GivenUp { .. }
        | CampaignError::Motion { .. }
        | CampaignError::Rejected { .. }
        | CampaignError::Blocked { .. }
        | CampaignError::Lost { .. }
        | CampaignError::Moved { .. }
        | CampaignError::Shifted { .. }
        | CampaignError::Scattered { .. }
        | CampaignError::Gone { .. } => TrialEnd::Stopped(text),
        _ => TrialEnd::Unexplained(text),
    }
}
