//! Compares plans in the worlds: what a number of poses, chosen in some way, costs in robot time
//! and leaves in error. Every plan is made from the nominal robot alone; every drawn robot then
//! records the same poses.

use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::fmt;
use std::ops::Range;
use std::path::Path;

use serde::{Deserialize, Serialize};

use super::compare::{RobotErrors, WorldScore, cells, robot};
use super::record::{ContactPose, WorldError, planned_poses};
use super::seeds;
use crate::Estimator;
use crate::shards::{self, ShardError, ShardedStudy};
use spherecal_identify::validate::Alignment;
use spherecal_plan::{self as plan, DesignRequest, Plan, PlanError};
use spherecal_sim::worlds::World;

/// How the contacts of a row were chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Chosen {
    /// By the error that they leave, so many.
    Optimal(usize),
    /// Spread over the paper's grid, so many.
    Grid(usize),
    /// The reachable part of the paper's whole grid.
    WholeGrid,
}

impl fmt::Display for Chosen {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Self::Optimal(_) => "optimal",
            Self::Grid(_) => "grid",
            Self::WholeGrid => "whole grid",
        })
    }
}

impl Chosen {
    /// The plan, for the nominal cell of the worlds.
    ///
    /// # Errors
    /// See [`plan::design`] and [`plan::plan`].
    pub fn plan(self) -> Result<Plan, PlanError> {
        let cell = plan::Cell::iiwa7();
        match self {
            Self::Optimal(poses) => plan::design(&cell, &DesignRequest::new(poses)),
            Self::Grid(poses) => plan::spread_plan(&cell, poses),
            Self::WholeGrid => plan::paper_plan(&cell),
        }
    }
}

/// What to compare.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlanOptions {
    /// The worlds.
    pub worlds: Vec<World>,
    /// The plans.
    pub plans: Vec<Chosen>,
    /// Seeds of the robots, the same in every world.
    #[serde(with = "seeds")]
    pub seeds: Vec<u64>,
    /// Whether to show progress on stderr.
    #[serde(skip)]
    pub progress: bool,
}

impl Default for PlanOptions {
    fn default() -> Self {
        Self {
            worlds: World::ALL.to_vec(),
            plans: vec![
                Chosen::Optimal(30),
                Chosen::Optimal(60),
                Chosen::Optimal(90),
                Chosen::Optimal(150),
                Chosen::Grid(150),
                Chosen::WholeGrid,
            ],
            seeds: (0..12).collect(),
            progress: false,
        }
    }
}

/// One plan over all worlds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanRow {
    /// How its poses were chosen.
    pub chosen: Chosen,
    /// Poses recorded.
    pub poses: usize,
    /// Contacts made.
    pub contacts: usize,
    /// Robot time that the plan predicts, in s.
    pub robot_s: f64,
    /// Errors of the default estimator, world by world.
    pub cells: Vec<WorldScore>,
}

impl PlanRow {
    /// Median over the robots of the mean error in a world, base fitted to the
    /// points, in mm.
    pub fn median_mm(&self, world: World) -> Option<f64> {
        let cell = self.cells.iter().find(|c| c.world == world)?;
        Some(cell.median_mm(Alignment::BestFit).0)
    }
}

/// The table of plans.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct PlanTable {
    /// Number of robots in each world.
    pub robots: usize,
    /// The worlds, in order.
    pub worlds: Vec<World>,
    /// One row a plan.
    pub rows: Vec<PlanRow>,
}

impl PlanTable {
    /// The row of a plan.
    pub fn row(&self, chosen: Chosen) -> Option<&PlanRow> {
        self.rows.iter().find(|r| r.chosen == chosen)
    }
}

impl fmt::Display for PlanTable {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        writeln!(
            f,
            "Mean TCP error in mm, base fitted to the points, after so many poses: medians of {} robots\n",
            self.robots
        )?;
        write!(
            f,
            "{:>6}  {:10}  {:>8}  {:>11}",
            "poses", "chosen", "contacts", "robot time"
        )?;
        for world in &self.worlds {
            write!(f, "  {world:>6}")?;
        }
        writeln!(f)?;
        for row in &self.rows {
            let (poses, chosen, contacts, s) = (row.poses, row.chosen, row.contacts, row.robot_s);
            write!(f, "{poses:6}  {chosen:10}  {contacts:8}  {s:9.0} s")?;
            for world in &self.worlds {
                match row.median_mm(*world) {
                    Some(mm) => write!(f, "  {mm:6.3}")?,
                    None => write!(f, "  {:>6}", "-")?,
                }
            }
            writeln!(f)?;
        }
        Ok(())
    }
}

/// One robot after one plan.
#[derive(Clone, Debug, Serialize, Deserialize)]
pub struct PlannedRobot {
    /// Contacts that the plan makes.
    contacts: usize,
    /// Robot time that it predicts, in s.
    robot_s: f64,
    /// Poses that it records.
    poses: usize,
    /// What the default estimator left.
    robot: RobotErrors,
}

/// Item number `(seed * plans + plan) * worlds + world` is one robot.
impl ShardedStudy for PlanOptions {
    const NAME: &'static str = "plans";
    const COMMAND: &'static str = "worlds --plan";
    const ITEMS: &'static str = "robots";
    /// The plans, by number, each with the poses that it records.
    type Context = BTreeMap<usize, (Plan, Vec<ContactPose>)>;
    type Outcome = PlannedRobot;
    type Error = WorldError;

    fn items(&self) -> u64 {
        (self.seeds.len() * self.plans.len() * self.worlds.len()) as u64
    }

    fn prepare(&self, items: Range<u64>) -> Result<Self::Context, WorldError> {
        let mut made = Self::Context::new();
        // After so many items every plan has come up.
        for item in items.take(self.plans.len() * self.worlds.len()) {
            let number = self.plan_of(item);
            if let Entry::Vacant(place) = made.entry(number) {
                let plan = self.plans[number].plan();
                let plan = plan.map_err(|e| WorldError::Grid(e.to_string()))?;
                let poses = planned_poses(&plan);
                place.insert((plan, poses));
            }
        }
        Ok(made)
    }

    fn run(&self, plans: &Self::Context, item: u64) -> Result<PlannedRobot, WorldError> {
        let number = self.plan_of(item);
        let Some((plan, poses)) = plans.get(&number) else {
            return Err(WorldError::Grid(format!("plan {number} was not prepared")));
        };
        let world = self.worlds[item as usize % self.worlds.len()];
        let seed = self.seeds[item as usize / (self.worlds.len() * self.plans.len())];
        Ok(PlannedRobot {
            poses: poses.len(),
            contacts: plan.spheres.len(),
            robot_s: plan.robot_s,
            robot: robot(world, seed, poses, &[Estimator::Sphere])?,
        })
    }
}

impl PlanOptions {
    /// Number of the plan that an item uses.
    fn plan_of(&self, item: u64) -> usize {
        item as usize / self.worlds.len() % self.plans.len()
    }
}

/// The table that the robots' errors give, in the order of the items.
fn table(options: &PlanOptions, robots: &[PlannedRobot]) -> PlanTable {
    let worlds = options.worlds.len();
    let rows = options.plans.iter().enumerate().filter_map(|(number, chosen)| {
        let (begin, step) = (number * worlds, options.plans.len() * worlds);
        let first = robots.get(begin)?;
        Some(PlanRow {
            chosen: *chosen,
            poses: first.poses,
            contacts: first.contacts,
            robot_s: first.robot_s,
            cells: cells(&options.worlds, &[Estimator::Sphere], |world| {
                robots.iter().skip(begin + world).step_by(step).map(|r| &r.robot)
            }),
        })
    });
    PlanTable {
        robots: options.seeds.len(),
        worlds: options.worlds.clone(),
        rows: rows.collect(),
    }
}

/// Makes the plans, simulates the recordings of drawn robots, identifies and judges them.
///
/// # Errors
/// A plan that cannot be made; see also [`compare`](super::compare).
pub fn compare_plans(options: &PlanOptions) -> Result<PlanTable, WorldError> {
    Ok(table(options, &shards::whole(options, options.progress)?))
}

/// The table of plans of all shards in a folder.
///
/// # Errors
/// See [`ShardError`].
pub fn merge_plans(folder: &Path) -> Result<PlanTable, ShardError> {
    let (options, robots) = shards::merged::<PlanOptions>(folder)?;
    Ok(table(&options, &robots))
}
