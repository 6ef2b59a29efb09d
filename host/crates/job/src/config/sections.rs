//! The sections of the configuration about a run: plan, campaign, tracker.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use spherecal_identify as identify;
use spherecal_plan::{
    CONTACTS, Cell, DesignRequest, Grid, PATIENCE, Plan, PlanError, PlanRequest, Range, Rules, design, design_for, plan,
};

/// Predicted mean error of the plan for an asked accuracy, as a share of it. The verdict asks that the mean error is below the
/// accuracy with a probability of 95 %; after 30 poses on `as_measured` the posterior has that probability at 1.6 times its
/// mean, and its mean is 0.9 of the predicted one. A plan without this reserve was accepted in no run.
const PLANNED: f64 = 0.55;

/// How the poses are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// The poses that leave the least TCP error over the workspace.
    #[default]
    Optimal,
    /// Poses spread over the grid. Each sphere is visited once, with small turns between poses.
    Grid,
}

/// Which poses are visited.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSection {
    /// Number of poses over all spheres. 0: every reachable pose of the grid.
    pub poses: usize,
    /// Take the paper's whole grid by the paper's rules, with the paper's 5 s of hold and 1 s of recording, and with
    /// turns of 0.5 rad/s and a soft elbow. The other fields of this section then have no effect on the choice of poses.
    pub paper: bool,
    /// Required mean TCP error after alignment of the base, in mm. The plan then has as few optimal poses as
    /// promise it with the reserve that a sure result needs, whatever `poses` says, and the run ends once its evaluation
    /// accepts it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy_mm: Option<f64>,
    /// How the poses are chosen.
    pub choice: Choice,
    /// Largest number of contacts of an optimal plan. Each sphere has at least one. 0: as many as are worth
    /// their time.
    pub contacts: usize,
    /// Weight of robot time in an optimal plan, as a number of recordings: a pose counts half when the way to it
    /// takes as long as this many recordings. A small value saves robot time, a large one poses.
    pub patience: f64,
    /// How far optimal poses may turn away from the upright pose.
    pub range: Range,
    /// The grid about each sphere.
    pub grid: Grid,
    /// Margins that configurations and moves must keep.
    pub rules: Rules,
    /// Height of the approach waypoints above the sphere centres, in m.
    pub approach_height_m: f64,
    /// Margin around the box that holds the plan's poses and paths, in m. `procedure.limits.workspace` is narrowed
    /// to the box with this margin.
    pub workspace_margin_m: f64,
    /// How far the TCP may go below the centre of the lowest sphere, in m. `procedure.limits.plate` is set from
    /// it, unless that is given.
    pub plate_margin_m: f64,
}

impl Default for PlanSection {
    fn default() -> Self {
        Self {
            poses: 150,
            paper: false,
            accuracy_mm: None,
            choice: Choice::Optimal,
            contacts: CONTACTS,
            patience: PATIENCE,
            range: Range::default(),
            grid: Grid::default(),
            rules: Rules::default(),
            approach_height_m: 0.050,
            workspace_margin_m: 0.150,
            plate_margin_m: 0.030,
        }
    }
}

impl PlanSection {
    /// The plan of a cell; accuracy is predicted with the options of `identify`.
    ///
    /// # Errors
    /// See [`plan`](spherecal_plan::plan) and [`design`](spherecal_plan::design).
    pub fn make(&self, cell: &Cell, identify: &identify::Options) -> Result<Plan, PlanError> {
        if self.paper {
            return plan(cell, &PlanRequest::paper_on_an_arm());
        }
        if self.accuracy_mm.is_none() && (self.choice == Choice::Grid || self.poses == 0) {
            let request = PlanRequest {
                grid: self.grid.clone(),
                rules: self.rules,
                poses: (self.poses > 0).then_some(self.poses),
            };
            return plan(cell, &request);
        }
        let default = DesignRequest::new(match self.accuracy_mm {
            None => self.poses,
            // The number of poses is searched for; this one only sets how many candidates there are.
            Some(_) => Self::default().poses,
        });
        let request = DesignRequest {
            contacts: self.contacts,
            patience: self.patience,
            range: Range {
                candidates: self.range.candidates.min(default.range.candidates),
                ..self.range
            },
            rules: self.rules,
            options: identify.clone(),
            ..default
        };
        match self.accuracy_mm {
            None => design(cell, &request),
            Some(wanted_mm) => design_for(cell, &request, PLANNED * wanted_mm).map_err(|error| match error {
                PlanError::Accuracy { poses, best_mm, .. } => PlanError::Accuracy {
                    wanted_mm,
                    poses,
                    best_mm: best_mm / PLANNED,
                },
                other => other,
            }),
        }
    }
}

/// The laser tracker's reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LaserSection {
    /// Whether the simulated tracker measures the arm, too, as a reference.
    pub enabled: bool,
}

impl Default for LaserSection {
    fn default() -> Self {
        Self { enabled: true }
    }
}
