//! The paper's study on many drawn robots: is what it says of one robot true of others?

use std::fmt;
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::{ReproduceError, Reproduction, reproduce};
use crate::Estimator;
use crate::shards::{self, ShardError, ShardedStudy};
use crate::worlds::{AlignedErrors, World, record};
use spherecal_identify::Recordings;
use spherecal_identify::validate::Alignment;
use spherecal_model::statistics::quantile;

/// Which robots.
#[derive(Clone, Copy, Debug, Serialize, Deserialize)]
pub struct ManyOptions {
    /// World from which they are drawn.
    pub world: World,
    /// Seed of the first robot; the others have the seeds after it.
    pub first_seed: u64,
    /// Number of robots.
    pub robots: u64,
    /// Whether to show progress on stderr.
    #[serde(skip)]
    pub progress: bool,
}

/// Why a robot's study could not be made.
#[derive(Debug, thiserror::Error)]
#[error("{world} seed {seed}: {reason}")]
pub struct RobotStudyError {
    world: World,
    seed: u64,
    reason: String,
}

/// What the study gives on one robot.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct RobotStudy {
    /// Errors of each model, by name, in mm.
    models: Vec<(String, AlignedErrors)>,
    /// Parameters that start at zero and end at Table 6's frozen value.
    frozen: usize,
    /// The fitness at the simplex's end, divided by the optimum.
    simplex_over_optimum: f64,
    /// Whether the sphere calibration may be used.
    may_be_used: bool,
}

impl RobotStudy {
    fn of(seed: u64, done: &Reproduction) -> Self {
        let models = done.validation.models.iter().map(|model| {
            let errors = AlignedErrors {
                seed,
                arcs: model.arcs,
                best_fit: model.best_fit,
                own: model.own,
            };
            (model.name.clone(), errors)
        });
        Self {
            models: models.collect(),
            frozen: done.frozen,
            simplex_over_optimum: done.simplex_over_optimum,
            may_be_used: done.verdict.may_be_used,
        }
    }

    fn mean_mm(&self, name: &str, alignment: Alignment) -> Option<f64> {
        let (_, errors) = self.models.iter().find(|(own, _)| own == name)?;
        Some(errors.under(alignment).mean_mm)
    }
}

/// Item number k is the robot with the seed `first_seed + k`.
impl ShardedStudy for ManyOptions {
    const NAME: &'static str = "reproduce";
    const COMMAND: &'static str = "reproduce --world W1 --robots 1000";
    const ITEMS: &'static str = "robots";
    type Context = ();
    type Outcome = RobotStudy;
    type Error = RobotStudyError;

    fn items(&self) -> u64 {
        self.robots
    }

    fn prepare(&self, _: Range<u64>) -> Result<(), RobotStudyError> {
        Ok(())
    }

    fn run(&self, (): &(), item: u64) -> Result<RobotStudy, RobotStudyError> {
        let seed = self.first_seed.wrapping_add(item);
        let failed = |reason: String| RobotStudyError {
            world: self.world,
            seed,
            reason,
        };
        let trial = record(self.world, seed).map_err(|e| failed(e.to_string()))?;
        let done = reproduce(&Recordings::from(&trial), seed, &[]);
        let done = done.map_err(|e: ReproduceError| failed(e.to_string()))?;
        Ok(RobotStudy::of(seed, &done))
    }
}

/// A number of every robot: the median, and the range that holds nine of ten robots.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct RobotSpread {
    /// Half of the robots are below.
    pub median: f64,
    /// One in twenty is below.
    pub p5: f64,
    /// One in twenty is above.
    pub p95: f64,
}

impl RobotSpread {
    /// `None` without a number.
    fn of(mut values: Vec<f64>) -> Option<Self> {
        values.sort_by(f64::total_cmp);
        if values.is_empty() {
            return None;
        }
        let at = |share| quantile(&values, share);
        Some(Self {
            median: at(0.5),
            p5: at(0.05),
            p95: at(0.95),
        })
    }
}

/// A model on all robots.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ModelSpread {
    /// Name of the model.
    pub name: String,
    /// Mean error, in mm, base measured by arcs, as in the paper.
    pub arcs_mm: RobotSpread,
    /// Mean error, in mm, base fitted to the points: the arm's shape alone.
    pub best_fit_mm: RobotSpread,
}

/// The study on many robots.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ManyStudies {
    /// World of the robots.
    pub world: World,
    /// Seed of the first.
    pub first_seed: u64,
    /// Number of robots.
    pub robots: usize,
    /// Every model of Table 5 and those of the program.
    pub models: Vec<ModelSpread>,
    /// Robots on which the paper's estimator on spheres is better than the nominal robot.
    pub simplex_better_than_nominal: usize,
    /// Robots on which this program's sphere calibration is better than the paper's laser calibration.
    pub sphere_better_than_paper_laser: usize,
    /// Robots of which at least one parameter ends at Table 6's frozen value.
    pub with_frozen: usize,
    /// The fitness at the simplex's end, divided by the optimum.
    pub simplex_over_optimum: Option<RobotSpread>,
    /// Robots whose sphere calibration may be used.
    pub may_be_used: usize,
}

fn table(options: &ManyOptions, robots: &[RobotStudy]) -> ManyStudies {
    let names: Vec<&String> = robots
        .first()
        .map(|r| r.models.iter().map(|(name, _)| name).collect())
        .unwrap_or_default();
    let spread =
        |name: &str, alignment| RobotSpread::of(robots.iter().filter_map(|r| r.mean_mm(name, alignment)).collect());
    let models = names.iter().filter_map(|name| {
        Some(ModelSpread {
            name: (*name).clone(),
            arcs_mm: spread(name, Alignment::Arcs)?,
            best_fit_mm: spread(name, Alignment::BestFit)?,
        })
    });
    let better = |a: Estimator, b: Estimator| {
        let is = |r: &&RobotStudy| {
            let error = |e: Estimator| r.mean_mm(e.name(), Alignment::Arcs);
            error(a).zip(error(b)).is_some_and(|(a, b)| a < b)
        };
        robots.iter().filter(is).count()
    };
    ManyStudies {
        world: options.world,
        first_seed: options.first_seed,
        robots: robots.len(),
        models: models.collect(),
        simplex_better_than_nominal: better(Estimator::PaperNelderMead, Estimator::Nominal),
        sphere_better_than_paper_laser: better(Estimator::Sphere, Estimator::LaserNelderMead),
        with_frozen: robots.iter().filter(|r| r.frozen > 0).count(),
        simplex_over_optimum: RobotSpread::of(robots.iter().map(|r| r.simplex_over_optimum).collect()),
        may_be_used: robots.iter().filter(|r| r.may_be_used).count(),
    }
}

/// Makes the study on every robot, on all cores.
///
/// # Errors
/// The first robot whose study fails.
pub fn reproduce_many(options: &ManyOptions) -> Result<ManyStudies, RobotStudyError> {
    Ok(table(options, &shards::whole(options, options.progress)?))
}

/// The study of all shards in a folder.
///
/// # Errors
/// See [`ShardError`].
pub fn merge_many(folder: &Path) -> Result<ManyStudies, ShardError> {
    let (options, robots) = shards::merged::<ManyOptions>(folder)?;
    Ok(table(&options, &robots))
}

impl fmt::Display for ManyStudies {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "The study of Nadeau, Bonev and Joubair (Robotics 2019, 8, 33) on {} robots of world {}, seeds from {}\n",
            self.robots, self.world, self.first_seed
        )?;
        writeln!(
            f,
            "{:18}  {:^28}  {:^28}",
            "mean error (mm)", "base by arcs, as in the paper", "base fitted to the points"
        )?;
        let range = |s: &RobotSpread| format!("{:.3} ({:.3} to {:.3})", s.median, s.p5, s.p95);
        for model in &self.models {
            writeln!(
                f,
                "{:18}  {:^28}  {:^28}",
                model.name,
                range(&model.arcs_mm),
                range(&model.best_fit_mm)
            )?;
        }
        writeln!(f, "\nMedian, and the range that holds nine of ten robots.\n")?;
        let n = self.robots;
        let lines = [
            (
                self.simplex_better_than_nominal,
                "the paper's estimator on spheres is better than the nominal robot",
            ),
            (
                self.sphere_better_than_paper_laser,
                "this calibration by spheres is better than the paper's by laser",
            ),
            (
                self.with_frozen,
                "the paper's simplex leaves parameters at the frozen value of its Table 6",
            ),
            (
                self.may_be_used,
                "the verdict is that this calibration by spheres may be used",
            ),
        ];
        for (count, what) in lines {
            writeln!(f, "- on {count} of {n} robots {what}")?;
        }
        if let Some(ratio) = &self.simplex_over_optimum {
            writeln!(
                f,
                "- the paper's simplex ends at {:.1} times the optimum ({:.1} to {:.1})",
                ratio.median, ratio.p5, ratio.p95
            )?;
        }
        Ok(())
    }
}
