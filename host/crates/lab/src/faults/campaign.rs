//! Many runs with one to four random faults each.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::case::{CalibratedTrial, FaultTrial, Finish, TrialEnd};
use super::judge::{CONTACT_N, HELD_N, HELD_S, KINETIC_J};
use super::{Cases, FaultsError};
use crate::shards::{self, ShardError, ShardedStudy};
use spherecal_sim::inject::{FaultPlan, PRESETS, PlannedFault, When};

/// Largest accepted ratio of the error with faults to the undisturbed error.
const WORSE: f64 = 1.2;
/// Faults of a run at most.
const MOST: usize = 4;

/// How many runs on how many arms.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CampaignOptions {
    /// Runs.
    pub runs: u64,
    /// Arms.
    pub seeds: u64,
    /// Preset of the arms' errors.
    pub preset: String,
    /// Only the run with this number, to inspect it again.
    pub only: Option<u64>,
    /// Whether a bar is shown.
    #[serde(skip)]
    pub progress: bool,
}

/// What became of the runs.
#[derive(Clone, Debug, Default, Serialize)]
pub struct CampaignTable {
    /// Runs.
    pub runs: usize,
    /// Faults that were injected.
    pub injected: usize,
    /// Times that a host was begun again.
    pub resumed: usize,
    /// Faults that controllers reported.
    pub told: usize,
    /// Runs that ended with every pose recorded or given up, and whose result the job accepts.
    pub calibrated: usize,
    /// Poses given up in runs that ended, accepted or not.
    pub rejected: usize,
    /// Runs that ended, and whose result the job refuses.
    pub refused: usize,
    /// Those of them whose error is at most 1.2 times the undisturbed one.
    pub refused_though_good: usize,
    /// How often each check refused.
    pub refused_by: BTreeMap<String, usize>,
    /// Stops, by the beginning of their message.
    pub stopped: BTreeMap<String, usize>,
    /// Error of the accepted results over the undisturbed one of the same arm: median and worst.
    pub ratio: [f64; 2],
    /// Accepted results whose error exceeds 1.2 times the undisturbed one. They are wrong where it is also more than stated.
    pub worse: usize,
    /// Recordings accepted from an unseated or moving nest.
    pub bad: usize,
    /// Acknowledged recordings lost.
    pub lost: usize,
    /// Recordings stored twice.
    pub duplicates: usize,
    /// Largest kinetic energy, in J.
    pub kinetic_j: f64,
    /// Largest contact force that lasted 10 ms, in N.
    pub contact_n: f64,
    /// Undisturbed errors of the arms that had a run, in mm.
    pub clean_mm: Vec<f64>,
    /// What should not have been.
    pub broken: Vec<String>,
}

impl CampaignTable {
    /// Whether every run ended as it should.
    pub fn holds(&self) -> bool {
        self.broken.is_empty()
    }

    fn add(&mut self, disturbed: &Disturbed) {
        let label = &disturbed.label;
        self.runs += 1;
        self.injected += disturbed.injected;
        self.told += disturbed.told;
        self.resumed += disturbed.resumed;
        self.bad += disturbed.bad.len();
        self.lost += disturbed.lost;
        self.duplicates += disturbed.duplicates;
        self.kinetic_j = self.kinetic_j.max(disturbed.kinetic_j);
        self.contact_n = self.contact_n.max(disturbed.contact_n);
        match &disturbed.ended {
            TrialEnd::Finished => {
                self.rejected += disturbed.rejected;
            }
            TrialEnd::Stopped(why) => {
                let short = why.split([',', ':', '(']).next().unwrap_or(why);
                *self.stopped.entry(short.trim().to_owned()).or_default() += 1;
            }
            TrialEnd::Unexplained(why) | TrialEnd::Panicked(why) => self.broken.push(format!("{label}: {why}")),
        }
        for why in &disturbed.bad {
            self.broken.push(format!("{label}: {why}"));
        }
        if disturbed.lost + disturbed.duplicates > 0 {
            self.broken.push(format!(
                "{label}: {} lost, {} twice",
                disturbed.lost, disturbed.duplicates
            ));
        }
        if disturbed.kinetic_j > KINETIC_J || disturbed.contact_n > CONTACT_N {
            self.broken.push(format!(
                "{label}: {:.1} J at tick {}, {:.0} N",
                disturbed.kinetic_j, disturbed.kinetic_tick, disturbed.contact_n
            ));
        }
        if disturbed.held_s > HELD_S {
            self.broken
                .push(format!("{label}: more than {HELD_N} N for {:.2} s", disturbed.held_s));
        }
    }
}

/// What became of one run.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct Disturbed {
    /// Number of the run, and its faults.
    label: String,
    /// Faults that were injected.
    injected: usize,
    /// Faults that the controller reported.
    told: usize,
    ended: TrialEnd,
    resumed: usize,
    rejected: usize,
    bad: Vec<String>,
    lost: usize,
    duplicates: usize,
    kinetic_j: f64,
    kinetic_tick: usize,
    contact_n: f64,
    held_s: f64,
    /// Undisturbed error of the arm, in mm.
    clean_mm: f64,
    /// What it calibrated to, or why to nothing; `None` if the run did not finish.
    calibrated: Option<Result<CalibratedTrial, String>>,
}

/// A plan of one to four random faults within `ticks`.
fn random_plan(seed: u64, ticks: u64) -> FaultPlan {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = rng.random_range(1..=MOST);
    let faults = (0..count).map(|_| PlannedFault {
        what: PRESETS[rng.random_range(0..PRESETS.len())].what,
        when: When::Tick(rng.random_range(500..ticks.max(501))),
        for_s: None,
    });
    FaultPlan {
        faults: faults.collect(),
        seed,
        host_link: None,
    }
}

/// Item number is number of the run.
impl ShardedStudy for CampaignOptions {
    const NAME: &'static str = "campaign";
    const COMMAND: &'static str = "faults --campaign 1000";
    const ITEMS: &'static str = "runs";
    type Context = Cases;
    type Outcome = Disturbed;
    type Error = FaultsError;

    fn items(&self) -> u64 {
        self.only.map_or(self.runs, |_| 1)
    }

    fn prepare(&self, items: Range<u64>) -> Result<Cases, FaultsError> {
        // After so many runs every arm has had its turn.
        let most = usize::try_from(self.seeds).unwrap_or(usize::MAX);
        let seeds = items.take(most).map(|item| self.seed_of(self.number_of(item)));
        Cases::new(seeds.collect(), &self.preset, Finish::Calibrate)
    }

    fn run(&self, cases: &Cases, item: u64) -> Result<Disturbed, FaultsError> {
        let number = self.number_of(item);
        let case = cases.get(self.seed_of(number))?;
        let plan = random_plan(number, case.ticks);
        let trial: FaultTrial = case.run(&plan)?;
        let finished = trial.ended == TrialEnd::Finished;
        let calibrated = finished.then(|| match case.judge(&trial) {
            Ok(calibrated) if calibrated.error_mm.is_finite() => Ok(calibrated),
            Ok(_) => Err("the error after calibration is not a number".to_owned()),
            Err(error) => Err(error.to_string()),
        });
        let names: Vec<_> = plan.faults.iter().map(|f| f.what.name()).collect();
        Ok(Disturbed {
            label: format!("run {number} ({})", names.join(", ")),
            injected: trial.happened.iter().filter(|h| h.begins).count(),
            told: trial.faults.len(),
            ended: trial.ended,
            resumed: trial.resumed,
            rejected: trial.rejected.len(),
            bad: trial.bad,
            lost: trial.lost,
            duplicates: trial.duplicates,
            kinetic_j: trial.kinetic_j,
            kinetic_tick: trial.kinetic_tick,
            contact_n: trial.contact_n,
            held_s: trial.held_s,
            clean_mm: case.calibrated.as_ref().map_or(f64::NAN, |clean| clean.error_mm),
            calibrated,
        })
    }
}

impl CampaignOptions {
    /// Number of an item's run.
    fn number_of(&self, item: u64) -> u64 {
        self.only.unwrap_or(item)
    }

    /// Seed of a run's arm.
    fn seed_of(&self, number: u64) -> u64 {
        1 + number % self.seeds
    }
}

/// Runs the whole campaign.
///
/// # Errors
/// The undisturbed run of an arm fails.
pub fn run(options: &CampaignOptions) -> Result<CampaignTable, FaultsError> {
    Ok(table(options, &shards::whole(options, options.progress)?))
}

/// The campaign of all shards in a folder.
///
/// # Errors
/// See [`ShardError`].
pub fn merge(folder: &Path) -> Result<CampaignTable, ShardError> {
    let (options, runs) = shards::merged::<CampaignOptions>(folder)?;
    Ok(table(&options, &runs))
}

/// The table that the runs give, in the order of their numbers.
fn table(options: &CampaignOptions, runs: &[Disturbed]) -> CampaignTable {
    let arms = usize::try_from(options.seeds).unwrap_or(usize::MAX);
    let mut table = CampaignTable {
        clean_mm: runs.iter().take(arms).map(|run| run.clean_mm).collect(),
        ..CampaignTable::default()
    };
    let mut ratios = Vec::new();
    for run in runs {
        let label = &run.label;
        table.add(run);
        let calibrated = match &run.calibrated {
            Some(Ok(calibrated)) => calibrated,
            Some(Err(why)) => {
                table.broken.push(format!("{label}: {why}"));
                continue;
            }
            None => continue,
        };
        let ratio = calibrated.error_mm / run.clean_mm;
        // Another set of recordings of the same arm has another error by chance.
        let stated = calibrated
            .stated_at_most_mm
            .is_some_and(|most| calibrated.error_mm <= most);
        let good = ratio <= WORSE;
        if calibrated.refused_by.is_empty() {
            table.calibrated += 1;
            ratios.push(ratio);
            table.worse += usize::from(!good);
            if !good && !stated {
                table.broken.push(format!(
                    "{label}: accepted with {ratio:.2} times the undisturbed error, more than it states"
                ));
            }
        } else {
            table.refused += 1;
            table.refused_though_good += usize::from(good);
            for check in &calibrated.refused_by {
                *table.refused_by.entry(check.clone()).or_default() += 1;
            }
        }
    }
    ratios.sort_by(f64::total_cmp);
    let at = |k: usize| ratios.get(k).copied().unwrap_or(f64::NAN);
    table.ratio = [at(ratios.len() / 2), at(ratios.len().saturating_sub(1))];
    table
}

impl fmt::Display for CampaignTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} runs with {} faults injected and {} reported, {} hosts restarted: {} calibrated, {} refused by the verdict; \
             {} poses given up in them",
            self.runs, self.injected, self.told, self.resumed, self.calibrated, self.refused, self.rejected
        )?;
        for (why, count) in &self.stopped {
            writeln!(f, "  {count:5} stopped: {why}")?;
        }
        for (check, count) in &self.refused_by {
            writeln!(f, "  {count:5} refused by the check {check}")?;
        }
        writeln!(
            f,
            "refused with an error of at most {WORSE} times the undisturbed one: {}",
            self.refused_though_good
        )?;
        writeln!(
            f,
            "error of the accepted results relative to the undisturbed run: median {:.3}, worst {:.3}; {} above {WORSE} (undisturbed: {:.3?} mm)",
            self.ratio[0], self.ratio[1], self.worse, self.clean_mm
        )?;
        writeln!(
            f,
            "{} recordings from an unseated or moving nest, {} lost, {} twice; at most {:.2} J and {:.0} N",
            self.bad, self.lost, self.duplicates, self.kinetic_j, self.contact_n
        )?;
        for line in &self.broken {
            writeln!(f, "  {line}")?;
        }
        Ok(())
    }
}
