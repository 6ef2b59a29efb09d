//! The sections of the configuration about a run: plan, campaign, tracker.

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};

use spherecal_campaign as campaign;
use spherecal_identify as identify;
use spherecal_plan::{
    CONTACTS, Cell, DesignRequest, Grid, Plan, PlanError, PlanRequest, Range, Rules, design, design_for, plan,
};

/// How the poses are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// By the predicted TCP error over the workspace.
    #[default]
    Optimal,
    /// Spread over the grid: each sphere is visited once, in small turns.
    Grid,
}

/// Which poses are visited.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSection {
    /// Number of poses over all spheres; 0 for every reachable one of the grid.
    pub poses: usize,
    /// Use the paper's whole grid by the paper's rules. Overrides the other fields of this section.
    pub paper: bool,
    /// Wanted mean TCP error, in mm, base aligned. The planner uses the fewest optimal poses that
    /// are predicted to reach it, instead of `poses`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy_mm: Option<f64>,
    /// How the poses are chosen.
    pub choice: Choice,
    /// Largest number of contacts of an optimal plan, but at least one per sphere; 0 for as many as
    /// are worthwhile.
    pub contacts: usize,
    /// Travel time to an optimal pose, in units of a recording's time, at which half of the pose's
    /// gain is discounted. A small value saves robot time, a large one saves poses. Default: 60
    /// divided by the number of poses.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patience: Option<f64>,
    /// How wide optimal poses may lie.
    pub range: Range,
    /// The grid about each sphere.
    pub grid: Grid,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Height of the approach frames above the spheres' centres, in m.
    pub approach_height_m: f64,
    /// Margin of the TCP around the box of the plan's positions and paths, in m;
    /// procedure.limits.workspace is narrowed to it.
    pub workspace_margin_m: f64,
    /// How far the TCP may go below the centre of the lowest sphere, in m; sets
    /// procedure.limits.plate, unless that is given.
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
            patience: None,
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
            return plan(cell, &PlanRequest::paper());
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
            // The number of poses is searched for; this one only sets the default patience.
            Some(_) => Self::default().poses,
        });
        let request = DesignRequest {
            contacts: self.contacts,
            patience: self.patience.unwrap_or(default.patience),
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
            Some(wanted_mm) => design_for(cell, &request, wanted_mm),
        }
    }
}

/// How the campaign behaves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct CampaignSection {
    /// Failed attempts after which a sphere is given up.
    pub attempts: u32,
    /// Failures after which a single pose is given up.
    pub pose_attempts: u32,
    /// Poses given up, in percent, after which the campaign stops.
    pub rejected_percent: u32,
    /// Delay from a command's cause to its start, in ms. A lossy link must deliver an event and a
    /// command within this time, or recordings depend on it.
    pub lead_ms: u32,
    /// Largest error of the taught waypoints along each axis, in m, in both directions: quick
    /// hand-guiding (the paper's, Section 4.2).
    pub taught_error_m: f64,
}

impl Default for CampaignSection {
    fn default() -> Self {
        let options = campaign::Options::default();
        Self {
            attempts: options.attempts,
            pose_attempts: options.pose_attempts,
            rejected_percent: options.rejected_percent,
            lead_ms: options.lead_ms,
            taught_error_m: 0.010,
        }
    }
}

impl CampaignSection {
    /// As the campaign takes it.
    pub fn options(&self) -> campaign::Options {
        campaign::Options {
            attempts: self.attempts.max(1),
            pose_attempts: self.pose_attempts.max(1),
            rejected_percent: self.rejected_percent,
            lead_ms: self.lead_ms,
        }
    }
}

/// The laser tracker's reference.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct LaserSection {
    /// Whether it is measured (in simulation).
    pub enabled: bool,
}

impl Default for LaserSection {
    fn default() -> Self {
        Self { enabled: true }
    }
}
