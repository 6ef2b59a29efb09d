//! Compares plans in the worlds: what a number of poses, chosen in some way, costs in robot time
//! and leaves in error. Every plan is made from the nominal robot alone; every drawn robot then
//! records the same poses.

use std::fmt;

use serde::{Deserialize, Serialize};

use super::compare::{Cell, CompareOptions, compare};
use super::record::{WorldError, planned_poses};
use spherecal_identify::Estimator;
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
#[derive(Clone, Debug)]
pub struct PlanOptions {
    /// The worlds.
    pub worlds: Vec<World>,
    /// The plans.
    pub plans: Vec<Chosen>,
    /// Seeds of the robots, the same in every world.
    pub seeds: Vec<u64>,
    /// Whether to show progress on stderr.
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
    pub cells: Vec<Cell>,
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

/// Makes the plans, simulates the recordings of drawn robots, identifies and judges them.
///
/// # Errors
/// A plan that cannot be made; see also [`compare`].
pub fn compare_plans(options: &PlanOptions) -> Result<PlanTable, WorldError> {
    let mut rows = Vec::new();
    for chosen in &options.plans {
        let plan = chosen.plan().map_err(|e| WorldError::Grid(e.to_string()))?;
        let compared = compare(&CompareOptions {
            worlds: options.worlds.clone(),
            estimators: vec![Estimator::Sphere],
            seeds: options.seeds.clone(),
            poses: Some(planned_poses(&plan)),
            progress: options.progress,
        })?;
        rows.push(PlanRow {
            chosen: *chosen,
            poses: compared.poses,
            contacts: plan.spheres.len(),
            robot_s: plan.robot_s,
            cells: compared.cells,
        });
    }
    Ok(PlanTable {
        robots: options.seeds.len(),
        worlds: options.worlds.clone(),
        rows,
    })
}
