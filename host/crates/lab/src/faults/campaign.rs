//! Many runs with one to four random faults each.

use std::collections::BTreeMap;
use std::fmt;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;

use super::case::{Case, Ended, Finish, Trial};
use super::judge::{CONTACT_N, HELD_N, HELD_S, KINETIC_J};
use super::{FaultsError, bar};
use spherecal_sim::inject::{Entry, FaultPlan, PRESETS, When};

/// Largest accepted ratio of the error with faults to the undisturbed error.
const WORSE: f64 = 1.2;
/// Faults of a run at most.
const MOST: usize = 4;

/// How many runs on how many arms.
#[derive(Clone, Copy, Debug)]
pub struct CampaignOptions {
    /// Runs.
    pub runs: u64,
    /// Arms.
    pub seeds: u64,
    /// Only the run with this number, to inspect it again.
    pub only: Option<u64>,
    /// Whether a bar is shown.
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
    /// Runs that ended with every pose recorded or given up.
    pub calibrated: usize,
    /// Poses given up in them.
    pub rejected: usize,
    /// Stops, by the beginning of their message.
    pub stopped: BTreeMap<String, usize>,
    /// Error after calibration over the undisturbed one of the same arm: median and worst.
    pub ratio: [f64; 2],
    /// Runs whose error exceeds 1.2 times the undisturbed one.
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
    /// Undisturbed errors of the arms, in mm.
    pub clean_mm: Vec<f64>,
    /// What should not have been.
    pub broken: Vec<String>,
}

impl CampaignTable {
    /// Whether every run ended as it should.
    pub fn holds(&self) -> bool {
        self.broken.is_empty()
    }

    fn add(&mut self, label: &str, trial: &Trial) {
        self.runs += 1;
        self.injected += trial.happened.iter().filter(|h| h.begins).count();
        self.told += trial.faults.len();
        self.resumed += trial.resumed;
        self.bad += trial.bad.len();
        self.lost += trial.lost;
        self.duplicates += trial.duplicates;
        self.kinetic_j = self.kinetic_j.max(trial.kinetic_j);
        self.contact_n = self.contact_n.max(trial.contact_n);
        match &trial.ended {
            Ended::Finished => {
                self.calibrated += 1;
                self.rejected += trial.rejected;
            }
            Ended::Stopped(why) => {
                let short = why.split([',', ':', '(']).next().unwrap_or(why);
                *self.stopped.entry(short.trim().to_owned()).or_default() += 1;
            }
            Ended::Unexplained(why) | Ended::Panicked(why) => self.broken.push(format!("{label}: {why}")),
        }
        for why in &trial.bad {
            self.broken.push(format!("{label}: {why}"));
        }
        if trial.lost + trial.duplicates > 0 {
            self.broken
                .push(format!("{label}: {} lost, {} twice", trial.lost, trial.duplicates));
        }
        if trial.kinetic_j > KINETIC_J || trial.contact_n > CONTACT_N {
            self.broken.push(format!(
                "{label}: {:.1} J at tick {}, {:.0} N",
                trial.kinetic_j, trial.kinetic_tick, trial.contact_n
            ));
        }
        if trial.held_s > HELD_S {
            self.broken
                .push(format!("{label}: more than {HELD_N} N for {:.2} s", trial.held_s));
        }
    }
}

/// A plan of one to four random faults within `ticks`.
fn random_plan(seed: u64, ticks: u64) -> FaultPlan {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let count = rng.random_range(1..=MOST);
    let faults = (0..count).map(|_| Entry {
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

/// Runs the whole campaign.
///
/// # Errors
/// The undisturbed run of an arm fails.
pub fn run(options: &CampaignOptions) -> Result<CampaignTable, FaultsError> {
    let cases = (1..=options.seeds)
        .into_par_iter()
        .map(|seed| Case::new(seed, Finish::Calibrate))
        .collect::<Result<Vec<_>, _>>()?;
    let bar = bar(options.runs, options.progress);
    let numbers = options.only.map_or(0..options.runs, |number| number..number + 1);
    let trials = numbers
        .into_par_iter()
        .map(|number| {
            let case = &cases[(number % options.seeds) as usize];
            let plan = random_plan(number, case.ticks);
            let trial = case.run(&plan)?;
            let error = match trial.ended {
                Ended::Finished => Some(case.judge(&trial).map(|e| e / case.error_mm).map_err(|e| e.to_string())),
                _ => None,
            };
            bar.inc(1);
            let names: Vec<_> = plan.faults.iter().map(|f| f.what.name()).collect();
            Ok((format!("run {number} ({})", names.join(", ")), trial, error))
        })
        .collect::<Result<Vec<_>, FaultsError>>()?;
    bar.finish_and_clear();
    let mut table = CampaignTable {
        clean_mm: cases.iter().map(|c| c.error_mm).collect(),
        ..CampaignTable::default()
    };
    let mut ratios = Vec::new();
    for (label, trial, error) in &trials {
        table.add(label, trial);
        match error {
            Some(Ok(ratio)) => {
                ratios.push(*ratio);
                if !(*ratio <= WORSE) {
                    table.worse += 1;
                    table
                        .broken
                        .push(format!("{label}: {ratio:.2} times the undisturbed error"));
                }
            }
            Some(Err(why)) => table.broken.push(format!("{label}: {why}")),
            None => {}
        }
    }
    ratios.sort_by(f64::total_cmp);
    let at = |k: usize| ratios.get(k).copied().unwrap_or(f64::NAN);
    table.ratio = [at(ratios.len() / 2), at(ratios.len().saturating_sub(1))];
    Ok(table)
}

impl fmt::Display for CampaignTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "{} runs with {} faults injected and {} reported, {} hosts restarted: {} calibrated, {} poses given up in them",
            self.runs, self.injected, self.told, self.resumed, self.calibrated, self.rejected
        )?;
        for (why, count) in &self.stopped {
            writeln!(f, "  {count:5} stopped: {why}")?;
        }
        writeln!(
            f,
            "error relative to the undisturbed run: median {:.3}, worst {:.3}; {} above {WORSE} (undisturbed: {:.3?} mm)",
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
