//! `spherecal-lab faults --worst`: searches for the instants at which a fault does most harm.
//!
//! Random instants miss the rare ones. For each fault the search first covers phases, entries of the
//! phase, times in it, arms and, for a push, its direction, size and duration. Then it varies the
//! worst cases that it has found. Harm is the largest of three ratios to a limit: the force with
//! which the arm presses for 0.3 s, its largest force, and the kinetic energy.

use std::fmt;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::Serialize;
use spherecal_shared::protocol::host::Phase;

use super::case::{Case, FaultTrial, Finish, TrialEnd};
use super::judge::{KINETIC_J, PEAK_N, SUSTAINED_N};
use super::{FaultsError, matrix};
use crate::shards::bar;
use spherecal_sim::inject::{FaultPlan, InjectedFault, PlannedFault, Preset, When};

/// Phases that the search covers.
const PHASES: [Phase; 8] = [
    Phase::Moving,
    Phase::Taring,
    Phase::Approaching,
    Phase::Coupling,
    Phase::Coupled,
    Phase::Turning,
    Phase::Recording,
    Phase::Decoupling,
];
/// Entries of a phase, and time after the entry in s, that the search covers.
const ENTRIES: u32 = 12;
const AFTER_S: f64 = 2.5;
/// A push: smallest and largest force in N, and duration in s.
const PUSH_N: (f64, f64) = (5.0, 50.0);
const PUSH_S: (f64, f64) = (0.2, 2.0);
/// Share of the runs that only cover; the others vary the worst.
const COVER_SHARE: f64 = 0.6;
/// Cases that are kept for each fault.
const KEPT: usize = 3;

/// What is searched.
#[derive(Clone, Debug)]
pub struct WorstOptions {
    /// Names of the faults; all if the list is empty.
    pub only: Vec<String>,
    /// Runs for each fault.
    pub runs: u32,
    /// Arms.
    pub seeds: u64,
    /// Whether a bar is shown.
    pub progress: bool,
}

/// One case and the harm that it did.
#[derive(Clone, Debug, Serialize)]
pub struct WorstCase {
    /// Seed of the arm.
    pub seed: u64,
    /// The case as the text of a file for `--inject`.
    pub file: String,
    /// Largest force that lasted 0.3 s, in N, less the magnet's and without the push itself.
    pub sustained_n: f64,
    /// Largest force that lasted 10 ms, in N, less the magnet's and without the push itself.
    pub peak_n: f64,
    /// Largest kinetic energy, in J.
    pub kinetic_j: f64,
    /// Time from the injected fault to the controller's report, in ms; `None` if none came.
    pub reported_ms: Option<u64>,
    /// How the run ended.
    pub ended: TrialEnd,
    /// Harm: the largest ratio to a limit.
    pub harm: f64,
}

/// What the search found for one fault.
#[derive(Clone, Debug, Serialize)]
pub struct WorstRow {
    /// The fault.
    pub fault: String,
    /// Runs.
    pub runs: usize,
    /// Runs that ended without all poses and without a reason, or in a panic.
    pub unexplained: usize,
    /// The worst cases, worst first.
    pub worst: Vec<WorstCase>,
}

/// Result of the search.
#[derive(Clone, Debug, Serialize)]
pub struct WorstTable {
    /// One row a fault.
    pub rows: Vec<WorstRow>,
}

impl WorstTable {
    /// Whether every run ended with all poses or a reason, within the limits of force and energy.
    pub fn holds(&self) -> bool {
        let bound = |case: &WorstCase| case.harm <= 1.0;
        self.rows
            .iter()
            .all(|row| row.unexplained == 0 && row.worst.iter().all(bound))
    }
}

/// A point of the search.
#[derive(Clone, Copy, Debug)]
struct Point {
    case: usize,
    phase: usize,
    entry: u32,
    after_s: f64,
    force_n: [f64; 3],
    for_s: f64,
}

impl Point {
    fn draw(rng: &mut ChaCha8Rng, number: u32, cases: usize) -> Self {
        let mut direction = [0.0f64; 3];
        let mut norm = 0.0;
        while !(1e-3..=1.0).contains(&norm) {
            direction = core::array::from_fn(|_| rng.random_range(-1.0..1.0));
            norm = direction.iter().map(|x| x * x).sum::<f64>().sqrt();
        }
        let size = rng.random_range(PUSH_N.0..PUSH_N.1);
        Self {
            case: rng.random_range(0..cases),
            // Every phase in turn.
            phase: number as usize % PHASES.len(),
            entry: rng.random_range(1..=ENTRIES),
            after_s: rng.random_range(0.0..AFTER_S),
            force_n: direction.map(|x| x * size / norm),
            for_s: rng.random_range(PUSH_S.0..PUSH_S.1),
        }
    }

    /// A point near this one: with another instant, another entry, or another push.
    fn vary(&self, rng: &mut ChaCha8Rng, number: u32, cases: usize) -> Self {
        let other = Self::draw(rng, number, cases);
        let mut near = *self;
        match number % 4 {
            0 => near.after_s = (self.after_s + rng.random_range(-0.2..0.2)).max(0.0),
            1 => near.entry = other.entry,
            2 => near.force_n = other.force_n,
            _ => {
                near.case = other.case;
                near.for_s = other.for_s;
            }
        }
        near
    }

    fn plan(&self, preset: &Preset) -> FaultPlan {
        let push = matches!(preset.what, InjectedFault::HumanPush { .. });
        FaultPlan {
            seed: 0,
            host_link: None,
            faults: vec![PlannedFault {
                what: if push {
                    InjectedFault::HumanPush { force_n: self.force_n }
                } else {
                    preset.what
                },
                when: When::Phase {
                    name: PHASES[self.phase],
                    entry: self.entry,
                    after_s: self.after_s,
                },
                for_s: push.then_some(self.for_s),
            }],
        }
    }
}

fn judged(case: &Case, plan: &FaultPlan, trial: FaultTrial) -> WorstCase {
    let began = trial.happened.iter().find(|h| h.begins).map(|h| h.tick);
    let reported = began.and_then(|tick| {
        let after = trial.faults.iter().find(|f| f.tick + 1 >= tick)?;
        Some((after.tick + 1).saturating_sub(tick))
    });
    WorstCase {
        seed: case.seed,
        file: plan.to_toml(),
        harm: (trial.sustained_n / SUSTAINED_N)
            .max(trial.pressed_n / PEAK_N)
            .max(trial.kinetic_j / KINETIC_J),
        sustained_n: trial.sustained_n,
        peak_n: trial.pressed_n,
        kinetic_j: trial.kinetic_j,
        reported_ms: reported,
        ended: trial.ended,
    }
}

/// Searches for the worst cases of each fault.
///
/// # Errors
/// A name that no preset has, or an arm whose undisturbed run fails.
pub fn run(options: &WorstOptions) -> Result<WorstTable, FaultsError> {
    let presets = matrix::presets(&options.only)?;
    let cases = (1..=options.seeds)
        .into_par_iter()
        .map(|seed| Case::new(seed, Finish::Record))
        .collect::<Result<Vec<_>, _>>()?;
    let bar = bar(u64::from(options.runs) * presets.len() as u64, "runs", options.progress);
    let mut rows = Vec::new();
    for (number, preset) in (0u64..).zip(presets) {
        let mut rng = ChaCha8Rng::seed_from_u64(0x776f_7273_7400 + number);
        let cover = (f64::from(options.runs) * COVER_SHARE).ceil() as u32;
        let points = (0..cover).map(|k| Point::draw(&mut rng, k, cases.len())).collect();
        let mut found: Vec<(Point, WorstCase)> = Vec::new();
        carry_out(preset, &cases, points, &mut found, &bar)?;
        let mut left = options.runs - cover;
        while left > 0 && !found.is_empty() {
            let count = left.min(8);
            let points = (0..count)
                .map(|k| {
                    found[k as usize % found.len().min(KEPT)]
                        .0
                        .vary(&mut rng, left + k, cases.len())
                })
                .collect();
            carry_out(preset, &cases, points, &mut found, &bar)?;
            left -= count;
        }
        rows.push(WorstRow {
            fault: preset.name.to_owned(),
            runs: found.len(),
            unexplained: found
                .iter()
                .filter(|(_, c)| matches!(c.ended, TrialEnd::Unexplained(_) | TrialEnd::Panicked(_)))
                .count(),
            worst: found.into_iter().map(|(_, case)| case).take(KEPT).collect(),
        });
    }
    bar.finish_and_clear();
    Ok(WorstTable { rows })
}

/// Runs the points and adds them to what was found, worst first.
fn carry_out(
    preset: &Preset,
    cases: &[Case],
    points: Vec<Point>,
    found: &mut Vec<(Point, WorstCase)>,
    bar: &indicatif::ProgressBar,
) -> Result<(), FaultsError> {
    let new = points
        .into_par_iter()
        .map(|point| {
            let plan = point.plan(preset);
            let case = &cases[point.case];
            let trial = case.run(&plan)?;
            bar.inc(1);
            Ok((point, judged(case, &plan, trial)))
        })
        .collect::<Result<Vec<_>, FaultsError>>()?;
    found.extend(new);
    let bad = |case: &WorstCase| matches!(case.ended, TrialEnd::Unexplained(_) | TrialEnd::Panicked(_));
    found.sort_by(|a, b| bad(&b.1).cmp(&bad(&a.1)).then(b.1.harm.total_cmp(&a.1.harm)));
    Ok(())
}

impl fmt::Display for WorstTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "The worst cases found for each fault: force for 0.3 s (limit {SUSTAINED_N:.0} N), largest force for 10 ms \
             (limit {PEAK_N:.0} N), kinetic energy (limit {KINETIC_J:.0} J)"
        )?;
        for row in &self.rows {
            writeln!(
                f,
                "\n{}: {} runs, {} without a reason",
                row.fault, row.runs, row.unexplained
            )?;
            for case in &row.worst {
                let reported = case
                    .reported_ms
                    .map_or("no report".to_owned(), |ms| format!("reported after {ms} ms"));
                writeln!(
                    f,
                    "  seed {}: {:.1} N for 0.3 s, {:.1} N, {:.2} J, {reported}; {:?}",
                    case.seed, case.sustained_n, case.peak_n, case.kinetic_j, case.ended
                )?;
                for line in case.file.lines().filter(|line| !line.is_empty()) {
                    writeln!(f, "      {line}")?;
                }
            }
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the search leaves out a phase, or if a drawn push is not one that a file may name.
    #[test]
    fn the_search_covers_every_phase_with_pushes_in_range() {
        let preset = spherecal_sim::inject::preset("human_push").expect("a preset");
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut phases = std::collections::BTreeSet::new();
        for number in 0..64 {
            let point = Point::draw(&mut rng, number, 3).vary(&mut rng, number, 3);
            phases.insert(point.phase);
            let plan = point.plan(preset);
            plan.check(7).expect("in range");
            assert_eq!(FaultPlan::parse("a", &plan.to_toml()).expect("a file"), plan);
            let size = point.force_n.iter().map(|x| x * x).sum::<f64>().sqrt();
            assert!((PUSH_N.0..=PUSH_N.1).contains(&size), "{size} N");
        }
        assert_eq!(phases.len(), PHASES.len());
    }
}
