//! Each fault alone, at random instants.

use std::collections::BTreeMap;
use std::fmt;
use std::ops::Range;
use std::path::Path;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};

use super::case::{FaultTrial, Finish, MEASURED_ON, TrialEnd};
use super::judge::{CONTACT_N, HELD_N, HELD_S, KINETIC_J};
use super::{Cases, FaultsError};
use crate::shards::{self, ShardError, ShardedStudy};
use spherecal_sim::inject::{FaultPlan, PRESETS, Preset, When};

/// Ticks at the beginning and at the end of a run that are left out: handshake and shutdown.
const EDGE_TICKS: u64 = 500;

/// What is to be injected how often.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct MatrixOptions {
    /// Names of the faults; all if the list is empty.
    pub only: Vec<String>,
    /// Random instants for each fault and arm.
    pub instants: u32,
    /// Arms.
    pub seeds: u64,
    /// Preset of the arms' errors.
    pub preset: String,
    /// Whether a bar is shown.
    #[serde(skip)]
    pub progress: bool,
}

impl Default for MatrixOptions {
    fn default() -> Self {
        Self {
            only: Vec::new(),
            instants: 20,
            seeds: 3,
            preset: MEASURED_ON.to_owned(),
            progress: false,
        }
    }
}

/// What became of one fault.
#[derive(Clone, Debug, Default, Serialize)]
pub struct FaultRow {
    /// The fault that was injected.
    pub fault: String,
    /// Runs.
    pub runs: usize,
    /// Runs without a report from the controller: the fault had no effect.
    pub borne: usize,
    /// Runs whose faults are the documented ones, within the documented time.
    pub documented: usize,
    /// Reported faults, with their counts.
    pub told: std::collections::BTreeMap<String, usize>,
    /// Longest time from the injected fault to its first report, in ms.
    pub slowest_ms: u64,
    /// Runs that recorded or gave up every pose.
    pub finished: usize,
    /// Runs that ended with a stop that states the reason.
    pub stopped: usize,
    /// Runs that ended otherwise.
    pub unexplained: usize,
    /// Times that the host was begun again.
    pub resumed: usize,
    /// Panics.
    pub panics: usize,
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
    /// Deviations from the documentation, each with its instant and seed.
    pub broken: Vec<String>,
}

/// The matrix.
#[derive(Clone, Debug, Serialize)]
pub struct MatrixTable {
    /// Random instants for each fault and arm.
    pub instants: u32,
    /// Arms.
    pub seeds: u64,
    /// One row a fault.
    pub rows: Vec<FaultRow>,
}

impl MatrixTable {
    /// Whether everything ended as documented.
    pub fn holds(&self) -> bool {
        self.rows.iter().all(|row| row.broken.is_empty())
    }
}

/// The deviations of a trial, in words; empty if it ended as documented.
fn broken(preset: &Preset, trial: &FaultTrial) -> (Vec<String>, Option<u64>) {
    let mut broken = Vec::new();
    let began = trial.happened.iter().find(|h| h.begins).map(|h| h.tick);
    // A controller without a robot yet keeps the brakes closed and reports nothing.
    let began = began.map(|tick| tick.max(trial.ready_tick));
    let first = trial.faults.first();
    let after_ms = began
        .zip(first)
        .map(|(began, fault)| (fault.tick + 1).saturating_sub(began));
    match (began, first, after_ms) {
        (None, ..) => broken.push("it was not injected".to_owned()),
        (Some(_), None, _) if !preset.borne => broken.push("no fault was told".to_owned()),
        (Some(_), Some(fault), Some(after)) => {
            if !preset.faults.contains(&fault.fault) {
                broken.push(format!("{:?} while {:?} is not documented", fault.fault, fault.phase));
            } else if preset
                .within_ms_in(fault.phase)
                .is_some_and(|within| after > u64::from(within))
            {
                broken.push(format!("{:?} came after {after} ms", fault.fault));
            }
        }
        _ => {}
    }
    match &trial.ended {
        TrialEnd::Unexplained(why) => broken.push(format!("stopped: {why}")),
        TrialEnd::Panicked(why) => broken.push(format!("panicked: {why}")),
        TrialEnd::Finished | TrialEnd::Stopped(_) => {}
    }
    broken.extend(trial.bad.iter().cloned());
    if trial.lost + trial.duplicates > 0 {
        broken.push(format!("{} recordings lost, {} twice", trial.lost, trial.duplicates));
    }
    if trial.kinetic_j > KINETIC_J {
        broken.push(format!("{:.1} J at tick {}", trial.kinetic_j, trial.kinetic_tick));
    }
    if trial.contact_n > CONTACT_N {
        broken.push(format!("{:.0} N", trial.contact_n));
    }
    if trial.held_s > HELD_S {
        broken.push(format!("more than {HELD_N} N for {:.2} s", trial.held_s));
    }
    (broken, after_ms)
}

/// What became of one injected fault.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct InjectionOutcome {
    /// Arm, instant and phase.
    label: String,
    /// Names of the reported faults.
    told: Vec<String>,
    ended: TrialEnd,
    /// Time from the injected fault to its first report, in ms.
    after_ms: Option<u64>,
    resumed: usize,
    bad: usize,
    lost: usize,
    duplicates: usize,
    kinetic_j: f64,
    contact_n: f64,
    /// Deviations from the documentation.
    broken: Vec<String>,
}

impl InjectionOutcome {
    fn of(preset: &Preset, label: String, trial: &FaultTrial) -> Self {
        let (broken, after_ms) = broken(preset, trial);
        Self {
            label,
            told: trial.faults.iter().map(|f| spherecal_model::name_of(f.fault)).collect(),
            ended: trial.ended.clone(),
            after_ms,
            resumed: trial.resumed,
            bad: trial.bad.len(),
            lost: trial.lost,
            duplicates: trial.duplicates,
            kinetic_j: trial.kinetic_j,
            contact_n: trial.contact_n,
            broken,
        }
    }
}

impl FaultRow {
    fn add(&mut self, injected: &InjectionOutcome) {
        self.runs += 1;
        self.borne += usize::from(injected.told.is_empty());
        self.documented += usize::from(injected.broken.is_empty());
        for fault in &injected.told {
            *self.told.entry(fault.clone()).or_default() += 1;
        }
        self.slowest_ms = self.slowest_ms.max(injected.after_ms.unwrap_or(0));
        match &injected.ended {
            TrialEnd::Finished => self.finished += 1,
            TrialEnd::Stopped(_) => self.stopped += 1,
            TrialEnd::Unexplained(_) => self.unexplained += 1,
            TrialEnd::Panicked(_) => self.panics += 1,
        }
        self.resumed += injected.resumed;
        self.bad += injected.bad;
        self.lost += injected.lost;
        self.duplicates += injected.duplicates;
        self.kinetic_j = self.kinetic_j.max(injected.kinetic_j);
        self.contact_n = self.contact_n.max(injected.contact_n);
        if !injected.broken.is_empty() {
            self.broken
                .push(format!("{}: {}", injected.label, injected.broken.join("; ")));
        }
    }
}

/// The presets with those names; all of them for an empty list.
///
/// # Errors
/// A name that no preset has.
pub fn presets(only: &[String]) -> Result<Vec<&'static Preset>, FaultsError> {
    if only.is_empty() {
        return Ok(PRESETS.iter().collect());
    }
    let find = |name: &String| spherecal_sim::inject::preset(name).ok_or(FaultsError::Unknown { name: name.clone() });
    only.iter().map(find).collect()
}

/// Item number `(arm * faults + fault) * instants + instant` is one run.
impl ShardedStudy for MatrixOptions {
    const NAME: &'static str = "faults";
    const COMMAND: &'static str = "faults";
    const ITEMS: &'static str = "runs";
    /// The arms, and the instants by arm and number of the fault.
    type Context = (Cases, BTreeMap<(u64, usize), Vec<u64>>);
    type Outcome = InjectionOutcome;
    type Error = FaultsError;

    fn items(&self) -> u64 {
        let faults = presets(&self.only).map_or(0, |presets| presets.len());
        self.seeds * faults as u64 * u64::from(self.instants)
    }

    fn prepare(&self, items: Range<u64>) -> Result<Self::Context, FaultsError> {
        let faults = presets(&self.only)?.len();
        let each = faults as u64 * u64::from(self.instants);
        let seeds = 1 + items.start / each..=1 + items.end.saturating_sub(1) / each;
        let cases = Cases::new(seeds.clone().collect(), &self.preset, Finish::Record)?;
        let mut ticks = BTreeMap::new();
        for seed in seeds {
            let last = cases.get(seed)?.ticks.saturating_sub(EDGE_TICKS).max(EDGE_TICKS + 1);
            for number in 0..faults {
                let mut rng = ChaCha8Rng::seed_from_u64(seed.wrapping_mul(1000) + number as u64);
                let drawn = (0..self.instants).map(|_| rng.random_range(EDGE_TICKS..last));
                ticks.insert((seed, number), drawn.collect());
            }
        }
        Ok((cases, ticks))
    }

    fn run(&self, (cases, ticks): &Self::Context, item: u64) -> Result<InjectionOutcome, FaultsError> {
        let presets = presets(&self.only)?;
        let (nth, instants) = (item / u64::from(self.instants), u64::from(self.instants));
        let (seed, number) = (1 + nth / presets.len() as u64, nth as usize % presets.len());
        let (case, preset) = (cases.get(seed)?, presets[number]);
        let drawn = ticks
            .get(&(seed, number))
            .and_then(|t| t.get((item % instants) as usize));
        let tick = *drawn.ok_or(FaultsError::NotPrepared { seed })?;
        let plan = FaultPlan {
            seed: tick,
            ..FaultPlan::of(preset.what, When::Tick(tick))
        };
        let trial = case.run(&plan)?;
        let phase = trial.happened.first().map(|h| format!(" ({:?})", h.phase));
        let label = format!("seed {seed}, tick {tick}{}", phase.unwrap_or_default());
        Ok(InjectionOutcome::of(preset, label, &trial))
    }
}

/// The matrix that the runs give, in the order of the items.
fn table(options: &MatrixOptions, runs: &[InjectionOutcome]) -> Result<MatrixTable, FaultsError> {
    let presets = presets(&options.only)?;
    let mut rows: Vec<FaultRow> = presets
        .iter()
        .map(|preset| FaultRow {
            fault: preset.name.to_owned(),
            ..FaultRow::default()
        })
        .collect();
    for (item, run) in runs.iter().enumerate() {
        let number = item / options.instants as usize % presets.len();
        rows[number].add(run);
    }
    Ok(MatrixTable {
        instants: options.instants,
        seeds: options.seeds,
        rows,
    })
}

/// Injects each fault alone.
///
/// # Errors
/// A name that no preset has, or an arm whose undisturbed run fails.
pub fn run(options: &MatrixOptions) -> Result<MatrixTable, FaultsError> {
    presets(&options.only)?;
    table(options, &shards::whole(options, options.progress)?)
}

/// The matrix of all shards in a folder.
///
/// # Errors
/// See [`ShardError`].
pub fn merge(folder: &Path) -> Result<MatrixTable, ShardError> {
    let (options, runs) = shards::merged::<MatrixOptions>(folder)?;
    table(&options, &runs).map_err(|e| ShardError::Study(Box::new(e)))
}

impl fmt::Display for MatrixTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Each fault alone at {} random instants on {} arms; time to the fault in ms, worst kinetic energy (J) and \
             contact force (N)\n",
            self.instants, self.seeds
        )?;
        writeln!(
            f,
            "{:18} {:>5} {:>6} {:>10} {:>8} {:>9} {:>8} {:>7} {:>7} {:>4} {:>5} {:>5} {:>6} {:>6}  told",
            "fault",
            "runs",
            "borne",
            "documented",
            "finished",
            "explained",
            "slowest",
            "resumed",
            "panics",
            "bad",
            "lost",
            "twice",
            "J",
            "N"
        )?;
        for r in &self.rows {
            let told: Vec<String> = r.told.iter().map(|(name, count)| format!("{name} {count}")).collect();
            writeln!(
                f,
                "{:18} {:5} {:6} {:10} {:8} {:9} {:8} {:7} {:7} {:4} {:5} {:5} {:6.2} {:6.0}  {}",
                r.fault,
                r.runs,
                r.borne,
                r.documented,
                r.finished,
                r.stopped,
                r.slowest_ms,
                r.resumed,
                r.panics,
                r.bad,
                r.lost,
                r.duplicates,
                r.kinetic_j,
                r.contact_n,
                told.join(", ")
            )?;
        }
        for r in self.rows.iter().filter(|r| !r.broken.is_empty()) {
            writeln!(f, "\n{}: not as documented", r.fault)?;
            for line in &r.broken {
                writeln!(f, "  {line}")?;
            }
        }
        Ok(())
    }
}
