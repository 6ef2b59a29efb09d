//! Everything that a user may set, as one TOML tree.
//!
//! A file names only what it changes; a name that does not exist is an error.

use std::path::Path;

use serde::{Deserialize, Serialize};
use spherecal_shared::procedure::{Procedure, ProcedureError};

use spherecal_campaign as campaign;
use spherecal_identify as identify;
use spherecal_model::{FileError, read_text, read_toml};
use spherecal_plan::{
    CONTACTS, Cell, DesignRequest, Grid, Plan, PlanError, PlanRequest, Range, Rules, design, design_for, plan,
};
use spherecal_sim::plant::{PRESETS, PlantConfig, PlantError};
use spherecal_sim::{Lossy, LossyError};

/// Largest configuration file, in bytes.
const MOST_BYTES: u64 = 1 << 20;

/// The whole configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Robot: a built-in name, or a .toml or .urdf file.
    pub robot: String,
    /// Which arm of that kind this is: its serial number, or whatever names it
    /// in the fleet; `spherecal history` tells arms apart by it.
    pub arm: String,
    /// Nominal TCP in the flange frame, in mm; the robot's own where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tool_mm: Option<[f64; 3]>,
    /// Which poses are visited.
    pub plan: PlanSection,
    /// How the campaign behaves.
    pub campaign: CampaignSection,
    /// The procedure of Algorithm 2.
    pub procedure: Procedure,
    /// The simulated plant: `preset`, and what differs from it.
    pub plant: toml::Table,
    /// The laser tracker's reference.
    pub laser: LaserSection,
    /// What is done to the host link on purpose.
    pub host_link: Lossy,
    /// How the robot is identified.
    pub identify: identify::Options,
}

/// How the poses are chosen.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case")]
pub enum Choice {
    /// By the TCP error that they leave over the workspace.
    #[default]
    Optimal,
    /// Spread over the grid: each sphere is visited once, in small turns.
    Grid,
}

/// Which poses are visited.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct PlanSection {
    /// Poses over all spheres; 0 for every reachable one of the grid.
    pub poses: usize,
    /// The paper's whole grid by the paper's rules, whatever else is said here.
    pub paper: bool,
    /// Mean TCP error that is asked for, in mm, base aligned: as few optimal
    /// poses as promise it, in place of `poses`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub accuracy_mm: Option<f64>,
    /// How the poses are chosen.
    pub choice: Choice,
    /// Contacts of an optimal plan at most, though never less than one of each
    /// sphere; 0 for as many as are worth it.
    pub contacts: usize,
    /// How many recordings' time the way to an optimal pose may take before
    /// half of what it gains is lost: small saves robot time, large poses.
    /// 60 over the number of poses where left out.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub patience: Option<f64>,
    /// How wide optimal poses may lie.
    pub range: Range,
    /// The grid about each sphere.
    pub grid: Grid,
    /// What configurations and moves must keep.
    pub rules: Rules,
    /// Height of the approach frames over the spheres' centres, in m.
    pub approach_height_m: f64,
    /// How far the TCP may leave the box about the plan's places and ways, in m:
    /// procedure.limits.workspace is narrowed to it.
    pub workspace_margin_m: f64,
    /// How far the TCP may come under the centre of the lowest sphere, in m:
    /// procedure.limits.plate is set by it, unless it is given.
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
            // The number is looked for; it sets how long the way to a pose may be.
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
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CampaignSection {
    /// Attempts in vain after which a sphere is given up.
    pub attempts: u32,
    /// Failures after which a single pose is given up.
    pub pose_attempts: u32,
    /// Poses given up, in percent, after which the campaign stops.
    pub rejected_percent: u32,
    /// How long after its cause a command starts, in ms: within it a lossy link
    /// must get an event up and a command down, or recordings depend on it.
    pub lead_ms: u32,
    /// Error of the taught waypoints along each axis, in m, either way: quick
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
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
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

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            robot: "iiwa7".to_owned(),
            arm: String::new(),
            tool_mm: None,
            plan: PlanSection::default(),
            campaign: CampaignSection::default(),
            procedure: Procedure::default(),
            plant: toml::Table::new(),
            laser: LaserSection::default(),
            host_link: Lossy::default(),
            identify: identify::Options::default(),
        }
    }
}

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file is not TOML, or names what does not exist.
    #[error("{path}: {message}\nremedy: `spherecal config --print` shows every field with its default")]
    Syntax {
        /// File.
        path: String,
        /// What is wrong, and where.
        message: String,
    },
    /// A number of the procedure is out of range.
    #[error(transparent)]
    Procedure(#[from] ProcedureError),
    /// The plant is impossible.
    #[error(transparent)]
    Plant(#[from] PlantError),
    /// A bad link that is none.
    #[error("host_link.{0}")]
    HostLink(#[from] LossyError),
    /// Another number is out of range.
    #[error("{field} is {value}: {remedy}")]
    Range {
        /// Field, as in the file.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// The plant's section does not fit together.
    #[error("plant: {message}")]
    PlantSection {
        /// What is wrong.
        message: String,
    },
}

impl Config {
    /// Reads a file; what it does not name has its default.
    ///
    /// # Errors
    /// A file that cannot be read, is not TOML or names what does not exist.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let name = path.display().to_string();
        let text = read_text(path, MOST_BYTES, "a configuration has some kilobytes")?;
        Self::parse(&name, &text)
    }

    /// As [`read`](Self::read), of a text; `name` is for messages.
    ///
    /// # Errors
    /// What is not TOML or names what does not exist.
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        read_toml(text).map_err(|e| ConfigError::Syntax {
            path: name.to_owned(),
            message: e.to_string(),
        })
    }

    /// Checks every number that has a range.
    ///
    /// # Errors
    /// The first that is out of it.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.procedure.check()?;
        self.plant()?;
        self.host_link.check()?;
        if self.campaign.lead_ms > 2000 {
            return Err(ConfigError::Range {
                field: "campaign.lead_ms",
                value: f64::from(self.campaign.lead_ms),
                remedy: "give milliseconds from 0 to 2000",
            });
        }
        let most = 0.05;
        if !(0.0..=most).contains(&self.campaign.taught_error_m) {
            return Err(ConfigError::Range {
                field: "campaign.taught_error_m",
                value: self.campaign.taught_error_m,
                remedy: "give metres from 0 to 0.05 (the procedure finds a sphere within 0.010)",
            });
        }
        for (field, value, least) in [
            ("plan.workspace_margin_m", self.plan.workspace_margin_m, 0.050),
            ("plan.plate_margin_m", self.plan.plate_margin_m, 0.010),
        ] {
            if !(least..=10.0).contains(&value) {
                return Err(ConfigError::Range {
                    field,
                    value,
                    remedy: "give metres, at most 10, no less than 0.050 about the workspace and 0.010 under the spheres",
                });
            }
        }
        if i64::try_from(self.seed).is_err() {
            return Err(ConfigError::Range {
                field: "seed",
                value: self.seed as f64,
                remedy: "give a whole number from 0 to 9223372036854775807",
            });
        }
        if self.plan.poses > 100_000 {
            return Err(ConfigError::Range {
                field: "plan.poses",
                value: self.plan.poses as f64,
                remedy: "give at most 100000 poses",
            });
        }
        if let Some(wanted) = self.plan.accuracy_mm
            && !(wanted > 0.0 && self.plan.choice == Choice::Optimal)
        {
            return Err(ConfigError::Range {
                field: "plan.accuracy_mm",
                value: wanted,
                remedy: "give a positive mean error in mm, with plan.choice = \"optimal\"",
            });
        }
        if let Some(patience) = self.plan.patience
            && !(patience > 0.0)
        {
            return Err(ConfigError::Range {
                field: "plan.patience",
                value: patience,
                remedy: "give a positive number of recordings' time, or leave it out",
            });
        }
        for value in self.tool_mm.iter().flatten() {
            if !(value.abs() <= 2000.0) {
                return Err(ConfigError::Range {
                    field: "tool_mm",
                    value: *value,
                    remedy: "give the TCP in the flange frame in mm, within 2000",
                });
            }
        }
        Ok(())
    }

    /// The plant: the preset with what differs from it, and the job's seed.
    ///
    /// # Errors
    /// An unknown preset or field, or a number out of range.
    pub fn plant(&self) -> Result<PlantConfig, ConfigError> {
        let section = |message: String| ConfigError::PlantSection { message };
        let mut table = self.plant.clone();
        let preset = match table.remove("preset") {
            None => PRESETS.get(1).copied().unwrap_or("typical").to_owned(),
            Some(toml::Value::String(name)) => name,
            Some(other) => {
                return Err(section(format!(
                    "preset is {other}: give one of {}",
                    PRESETS.join(", ")
                )));
            }
        };
        let mut whole = toml::Table::try_from(PlantConfig::preset(&preset)?).map_err(|e| section(e.to_string()))?;
        merge(&mut whole, table);
        let mut config: PlantConfig = whole
            .try_into()
            .map_err(|e: toml::de::Error| section(e.to_string().trim_end().to_owned()))?;
        if !self.plant.contains_key("seed") {
            config.seed = self.seed;
        }
        config.check()?;
        Ok(config)
    }

    /// The whole tree as TOML, every field stated.
    ///
    /// # Errors
    /// Only where the serialiser fails.
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        toml::to_string(self).map_err(|e| ConfigError::Syntax {
            path: "configuration".to_owned(),
            message: e.to_string(),
        })
    }
}

/// Writes `over` into `base`, table by table.
fn merge(base: &mut toml::Table, over: toml::Table) {
    for (key, value) in over {
        match (base.get_mut(&key), value) {
            (Some(toml::Value::Table(inner)), toml::Value::Table(new)) => merge(inner, new),
            // A whole number where a float stands is meant as one.
            (Some(slot @ toml::Value::Float(_)), toml::Value::Integer(whole)) => {
                *slot = toml::Value::Float(whole as f64);
            }
            (_, value) => {
                base.insert(key, value);
            }
        }
    }
}
