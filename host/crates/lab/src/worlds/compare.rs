//! Compares estimators on many drawn robots of each world, in one table.

use std::fmt;
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::estimators::judge;
use super::record::{ContactPose, WorldError, paper_poses, record_poses};
use super::seeds;
use crate::Estimator;
use crate::shards::{self, ShardError, ShardedStudy};
use spherecal_export::ExportTable;
use spherecal_identify::validate::{Alignment, ErrorStatistics};
use spherecal_model::statistics::median;
use spherecal_sim::worlds::World;

/// What to compare.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct CompareOptions {
    /// The worlds.
    pub worlds: Vec<World>,
    /// The estimators.
    pub estimators: Vec<Estimator>,
    /// Seeds of the robots, the same in every world.
    #[serde(with = "seeds")]
    pub seeds: Vec<u64>,
    /// Poses of the contacts; the paper's grid if none.
    pub poses: Option<Vec<ContactPose>>,
    /// Whether to show progress on stderr.
    #[serde(skip)]
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
pub struct AlignedErrors {
    /// Seed of the robot.
    pub seed: u64,
    /// V1: base measured by arcs.
    pub arcs: ErrorStatistics,
    /// V2: base fitted to the points.
    pub best_fit: ErrorStatistics,
    /// V3: the model's own base.
    pub own: ErrorStatistics,
}

impl AlignedErrors {
    pub(crate) fn under(&self, alignment: Alignment) -> &ErrorStatistics {
        match alignment {
            Alignment::Arcs => &self.arcs,
            Alignment::BestFit => &self.best_fit,
            Alignment::Own => &self.own,
        }
    }
}

/// One estimator in one world.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct WorldScore {
    /// The world.
    pub world: World,
    /// The estimator.
    pub estimator: Estimator,
    /// Every robot's errors, by seed.
    pub robots: Vec<AlignedErrors>,
}

impl WorldScore {
    /// Medians over the robots of mean and maximum error, in mm.
    pub fn median_mm(&self, alignment: Alignment) -> (f64, f64) {
        let of =
            |f: &dyn Fn(&ErrorStatistics) -> f64| median(self.robots.iter().map(|r| f(r.under(alignment))).collect());
        (of(&|s| s.mean_mm), of(&|s| s.max_mm))
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
    pub cells: Vec<WorldScore>,
}

impl Comparison {
    /// One cell.
    pub fn cell(&self, world: World, estimator: Estimator) -> Option<&WorldScore> {
        self.cells.iter().find(|c| c.world == world && c.estimator == estimator)
    }

    /// One row for each robot and estimator: world, estimator, seed, and the errors under each
    /// alignment, in mm.
    pub fn rows(&self) -> ExportTable {
        let rows: Vec<(&WorldScore, &AlignedErrors)> = self
            .cells
            .iter()
            .flat_map(|c| c.robots.iter().map(move |r| (c, r)))
            .collect();
        let mut table = ExportTable::new("worlds");
        table.text("world", rows.iter().map(|(cell, _)| cell.world.name().to_owned()));
        table.text(
            "estimator",
            rows.iter().map(|(cell, _)| cell.estimator.name().to_owned()),
        );
        table.whole("seed", rows.iter().map(|(_, errors)| errors.seed));
        for (name, alignment) in [
            ("arcs", Alignment::Arcs),
            ("best_fit", Alignment::BestFit),
            ("own", Alignment::Own),
        ] {
            let mut column = |what: &str, value: fn(&ErrorStatistics) -> f64| {
                let values = rows.iter().map(|(_, errors)| value(errors.under(alignment)));
                table.real(format!("{name}_{what}_mm"), values);
            };
            column("mean", |s| s.mean_mm);
            column("std", |s| s.std_mm);
            column("min", |s| s.min_mm);
            column("max", |s| s.max_mm);
        }
        table
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

/// One robot of a world, as every estimator left it.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct RobotErrors {
    /// Number of contacts.
    contacts: usize,
    /// Errors by estimator. Estimators without a meaning in the world are left out.
    errors: Vec<(Estimator, AlignedErrors)>,
}

/// Draws a robot, simulates its recordings, identifies and judges it.
pub(super) fn robot(
    world: World,
    seed: u64,
    poses: &[ContactPose],
    estimators: &[Estimator],
) -> Result<RobotErrors, WorldError> {
    let table = judge(&record_poses(world, seed, poses)?, estimators)?;
    let errors = estimators.iter().filter_map(|estimator| {
        let model = table.model(estimator.name())?;
        let errors = AlignedErrors {
            seed,
            arcs: model.arcs,
            best_fit: model.best_fit,
            own: model.own,
        };
        Some((*estimator, errors))
    });
    Ok(RobotErrors {
        contacts: poses.len(),
        errors: errors.collect(),
    })
}

/// The cells of the worlds; `of_world` gives the robots of the world with this number.
pub(super) fn cells<'a, I: Iterator<Item = &'a RobotErrors>>(
    worlds: &[World],
    estimators: &[Estimator],
    of_world: impl Fn(usize) -> I,
) -> Vec<WorldScore> {
    let mut cells = Vec::new();
    for (number, world) in worlds.iter().enumerate() {
        for estimator in estimators {
            let robots: Vec<AlignedErrors> = of_world(number)
                .flat_map(|robot| robot.errors.iter().filter(|(e, _)| e == estimator))
                .map(|(_, errors)| *errors)
                .collect();
            if !robots.is_empty() {
                cells.push(WorldScore {
                    world: *world,
                    estimator: *estimator,
                    robots,
                });
            }
        }
    }
    cells
}

/// Item number `seed * worlds + world` is one robot.
impl ShardedStudy for CompareOptions {
    const NAME: &'static str = "worlds";
    const COMMAND: &'static str = "worlds";
    const ITEMS: &'static str = "robots";
    type Context = Vec<ContactPose>;
    type Outcome = RobotErrors;
    type Error = WorldError;

    fn items(&self) -> u64 {
        (self.worlds.len() * self.seeds.len()) as u64
    }

    fn prepare(&self, _: Range<u64>) -> Result<Self::Context, WorldError> {
        match &self.poses {
            Some(poses) => Ok(poses.clone()),
            None => paper_poses().map(<[_]>::to_vec),
        }
    }

    fn run(&self, poses: &Self::Context, item: u64) -> Result<RobotErrors, WorldError> {
        let (seed, world) = (item as usize / self.worlds.len(), item as usize % self.worlds.len());
        robot(self.worlds[world], self.seeds[seed], poses, &self.estimators)
    }
}

/// The comparison that the robots' errors give, in the order of the items.
fn comparison(options: &CompareOptions, robots: &[RobotErrors]) -> Comparison {
    let worlds = options.worlds.len();
    Comparison {
        robots: options.seeds.len(),
        poses: robots.first().map_or(0, |robot| robot.contacts),
        cells: cells(&options.worlds, &options.estimators, |world| {
            robots.iter().skip(world).step_by(worlds)
        }),
    }
}

/// Draws robots, simulates their recordings, identifies and judges them, on all cores.
///
/// # Errors
/// The first trial or estimator that fails.
pub fn compare(options: &CompareOptions) -> Result<Comparison, WorldError> {
    Ok(comparison(options, &shards::whole(options, options.progress)?))
}

/// The comparison of all shards in a folder.
///
/// # Errors
/// See [`ShardError`].
pub fn merge_comparison(folder: &Path) -> Result<Comparison, ShardError> {
    let (options, robots) = shards::merged::<CompareOptions>(folder)?;
    Ok(comparison(&options, &robots))
}
