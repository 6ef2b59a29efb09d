//! Compares estimators on many drawn robots of each world, in one table.

use std::fmt;

use indicatif::{ProgressBar, ProgressStyle};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::estimators::judge;
use super::record::{ContactPose, WorldError, paper_poses, record_poses};
use spherecal_identify::Estimator;
use spherecal_identify::validate::{Alignment, Statistics};
use spherecal_sim::worlds::World;

/// What to compare.
#[derive(Clone, Debug)]
pub struct CompareOptions {
    /// The worlds.
    pub worlds: Vec<World>,
    /// The estimators.
    pub estimators: Vec<Estimator>,
    /// Seeds of the robots, the same in every world.
    pub seeds: Vec<u64>,
    /// Poses of the contacts; the paper's grid if none.
    pub poses: Option<Vec<ContactPose>>,
    /// Whether to show progress on stderr.
    pub progress: bool,
}

impl Default for CompareOptions {
    fn default() -> Self {
        Self {
            worlds: World::ALL.to_vec(),
            estimators: Estimator::ALL.to_vec(),
            seeds: (0..12).collect(),
            poses: None,
            progress: false,
        }
    }
}

/// Errors of one estimator on one robot, in mm, by alignment.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Errors {
    /// Seed of the robot.
    pub seed: u64,
    /// V1: base measured by arcs.
    pub arcs: Statistics,
    /// V2: base fitted to the points.
    pub best_fit: Statistics,
    /// V3: the model's own base.
    pub own: Statistics,
}

impl Errors {
    fn under(&self, alignment: Alignment) -> &Statistics {
        match alignment {
            Alignment::Arcs => &self.arcs,
            Alignment::BestFit => &self.best_fit,
            Alignment::Own => &self.own,
        }
    }
}

/// One estimator in one world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Cell {
    /// The world.
    pub world: World,
    /// The estimator.
    pub estimator: Estimator,
    /// Every robot's errors, by seed.
    pub robots: Vec<Errors>,
}

impl Cell {
    /// Medians over the robots of mean and maximum error, in mm.
    pub fn median_mm(&self, alignment: Alignment) -> (f64, f64) {
        let of = |f: &dyn Fn(&Statistics) -> f64| median(self.robots.iter().map(|r| f(r.under(alignment))).collect());
        (of(&|s| s.mean_mm), of(&|s| s.max_mm))
    }

    /// Largest mean error of all robots, in mm.
    pub fn worst_mm(&self, alignment: Alignment) -> f64 {
        self.robots
            .iter()
            .map(|r| r.under(alignment).mean_mm)
            .fold(0.0, f64::max)
    }
}

/// The median: the mean of the middle two for an even number; 0 for an empty list.
fn median(mut values: Vec<f64>) -> f64 {
    values.sort_by(f64::total_cmp);
    let n = values.len();
    match n {
        0 => 0.0,
        _ if n % 2 == 1 => values[n / 2],
        _ => f64::midpoint(values[n / 2 - 1], values[n / 2]),
    }
}

/// The whole comparison.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Comparison {
    /// Number of robots in each world.
    pub robots: usize,
    /// Number of contacts of each robot.
    pub poses: usize,
    /// The cells, world by world.
    pub cells: Vec<Cell>,
}

impl Comparison {
    /// One cell.
    pub fn cell(&self, world: World, estimator: Estimator) -> Option<&Cell> {
        self.cells.iter().find(|c| c.world == world && c.estimator == estimator)
    }

    /// Worlds and estimators in the order of the cells.
    fn axes(&self) -> (Vec<World>, Vec<Estimator>) {
        let (mut worlds, mut estimators) = (Vec::new(), Vec::new());
        for cell in &self.cells {
            if !worlds.contains(&cell.world) {
                worlds.push(cell.world);
            }
            if !estimators.contains(&cell.estimator) {
                estimators.push(cell.estimator);
            }
        }
        estimators.sort();
        (worlds, estimators)
    }

    /// The table under one alignment: estimators in rows, worlds in columns, `median mean / median
    /// max` in mm.
    pub fn block(&self, alignment: Alignment) -> String {
        let (worlds, estimators) = self.axes();
        let cell = |world: &World, estimator: &Estimator| match self.cell(*world, *estimator) {
            Some(cell) => {
                let (mean, max) = cell.median_mm(alignment);
                format!("{mean:.3}/{max:.2}")
            }
            None => "-".to_owned(),
        };
        let line = |name: &str, cells: Vec<String>| {
            let mut text = format!("{name:18}");
            for cell in cells {
                text.push_str("  ");
                text.push_str(&" ".repeat(11usize.saturating_sub(cell.len())));
                text.push_str(&cell);
            }
            text.push('\n');
            text
        };
        let heading = line("mean/max (mm)", worlds.iter().map(World::to_string).collect());
        let rows = estimators
            .iter()
            .map(|e| line(e.name(), worlds.iter().map(|w| cell(w, e)).collect()));
        std::iter::once(heading).chain(rows).collect()
    }
}

impl fmt::Display for Comparison {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(f, "Medians of {} robots, {} contacts each", self.robots, self.poses)?;
        for alignment in [Alignment::BestFit, Alignment::Arcs] {
            writeln!(f, "\n{}", alignment.title())?;
            write!(f, "{}", self.block(alignment))?;
        }
        Ok(())
    }
}

/// Draws robots, simulates their recordings, identifies and judges them, on all cores.
///
/// # Errors
/// The first trial or estimator that fails.
pub fn compare(options: &CompareOptions) -> Result<Comparison, WorldError> {
    let poses = match &options.poses {
        Some(poses) => poses.as_slice(),
        None => paper_poses()?,
    };
    let jobs: Vec<(World, u64)> = options
        .worlds
        .iter()
        .flat_map(|w| options.seeds.iter().map(|s| (*w, *s)))
        .collect();
    let bar = if options.progress {
        ProgressBar::new(jobs.len() as u64)
    } else {
        ProgressBar::hidden()
    };
    if let Ok(style) = ProgressStyle::with_template("{bar:30} {pos}/{len} robots, {elapsed} elapsed, {eta} left") {
        bar.set_style(style);
    }
    let judged: Vec<_> = jobs
        .par_iter()
        .map(|(world, seed)| {
            let trial = record_poses(*world, *seed, poses)?;
            let judged = judge(&trial, &options.estimators);
            bar.inc(1);
            judged
        })
        .collect::<Result<_, _>>()?;
    bar.finish_and_clear();
    let mut cells = Vec::new();
    for world in &options.worlds {
        for estimator in &options.estimators {
            let robots: Vec<Errors> = jobs
                .iter()
                .zip(&judged)
                .filter(|((w, _), _)| w == world)
                .filter_map(|((_, seed), table)| {
                    table.model(estimator.name()).map(|m| Errors {
                        seed: *seed,
                        arcs: m.arcs,
                        best_fit: m.best_fit,
                        own: m.own,
                    })
                })
                .collect();
            if !robots.is_empty() {
                cells.push(Cell {
                    world: *world,
                    estimator: *estimator,
                    robots,
                });
            }
        }
    }
    Ok(Comparison {
        robots: options.seeds.len(),
        poses: poses.len(),
        cells,
    })
}
