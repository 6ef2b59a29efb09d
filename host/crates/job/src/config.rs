//! All user settings, as one TOML tree.
//!
//! A file needs only the fields that it changes. An unknown name is an error.

use std::path::Path;

use schemars::JsonSchema;
use serde::{Deserialize, Serialize};
use spherecal_shared::procedure::Procedure;

use spherecal_campaign::RunOptions;
use spherecal_identify as identify;
use spherecal_link::Lossy;
use spherecal_model::{read_text, read_toml};
use toml::{Table, Value};

mod cell;
mod certificate;
mod error;
mod sections;

pub use cell::{CellSection, DriveSection, ToolSection};
use certificate::is_one_line;

pub use certificate::CertificateSection;
pub use error::ConfigError;
pub use sections::{Choice, LaserSection, PlanSection};

/// Largest configuration file, in bytes.
const MOST_BYTES: u64 = 1 << 20;

/// Preset of the simulated arm where a configuration names none: as hard to calibrate as real arms (world W5).
pub const DEFAULT_PRESET: &str = "as_measured";

/// The whole configuration.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize, JsonSchema)]
#[serde(default, deny_unknown_fields)]
pub struct Config {
    /// Seed of everything that is drawn.
    pub seed: u64,
    /// Robot: a built-in name, or a .toml or .urdf file.
    pub robot: String,
    /// Name of this very arm, such as its serial number. `spherecal history` tells arms apart by it.
    pub arm: String,
    /// Names and numbers of the certificate.
    pub certificate: CertificateSection,
    /// The real cell: tool, plate, placements and waypoints.
    pub cell: CellSection,
    /// Which poses are visited.
    pub plan: PlanSection,
    /// How the campaign behaves.
    pub campaign: RunOptions,
    /// The procedure of Algorithm 2.
    pub procedure: Procedure,
    /// The simulated arm: the name of a `preset` (default: `as_measured`), and the errors that differ from it. A real
    /// arm does not use this section.
    #[serde(skip_serializing_if = "Table::is_empty")]
    #[schemars(skip)]
    pub plant: Table,
    /// The laser tracker's reference.
    pub laser: LaserSection,
    /// Faults that are injected into the host link, for tests.
    pub host_link: Lossy,
    /// How the robot is identified.
    pub identify: identify::Options,
}

impl Default for Config {
    fn default() -> Self {
        Self {
            seed: 1,
            robot: "iiwa7".to_owned(),
            arm: String::new(),
            certificate: CertificateSection::default(),
            cell: CellSection::default(),
            plan: PlanSection::default(),
            campaign: RunOptions::default(),
            procedure: Procedure::default(),
            plant: named(DEFAULT_PRESET),
            laser: LaserSection::default(),
            host_link: Lossy::default(),
            identify: identify::Options::default(),
        }
    }
}

/// A `[plant]` with a preset alone.
fn named(preset: &str) -> Table {
    Table::from_iter([("preset".to_owned(), Value::from(preset))])
}

impl Config {
    /// The same configuration with the simulated errors of this preset, except those that its `[plant]` states itself.
    #[must_use]
    pub fn on_preset(mut self, preset: &str) -> Self {
        self.plant.insert("preset".to_owned(), Value::from(preset));
        self
    }

    /// Reads a file. Fields that it leaves out have their defaults.
    ///
    /// # Errors
    /// The file cannot be read, is not TOML or contains an unknown name.
    pub fn read(path: &Path) -> Result<Self, ConfigError> {
        let name = path.display().to_string();
        let text = read_text(path, MOST_BYTES, "a configuration has some kilobytes")?;
        Self::parse(&name, &text)
    }

    /// Like [`read`](Self::read), from a text; `name` appears in messages.
    ///
    /// # Errors
    /// The text is not TOML or contains an unknown name.
    pub fn parse(name: &str, text: &str) -> Result<Self, ConfigError> {
        let mut config: Self = read_toml(text).map_err(|e| ConfigError::Syntax {
            path: name.to_owned(),
            message: e.to_string(),
        })?;
        // Named, so that the stored configuration keeps its meaning when the default changes.
        config
            .plant
            .entry("preset")
            .or_insert_with(|| Value::from(DEFAULT_PRESET));
        Ok(config)
    }

    /// Reads the configuration of a stored run.
    ///
    /// # Errors
    /// The text is not TOML or contains an unknown name.
    pub fn stored(text: &str) -> Result<Self, ConfigError> {
        Self::parse("the stored configuration", text)
    }

    /// The procedure as it is carried out: with the paper's times where the paper's grid is asked for.
    #[must_use]
    pub fn carried_out(&self) -> Procedure {
        if self.plan.paper {
            self.procedure.paper()
        } else {
            self.procedure
        }
    }

    /// Checks every number that has a range, except those of `[plant]`, which the simulator checks.
    ///
    /// # Errors
    /// The first number that is out of its range.
    pub fn check(&self) -> Result<(), ConfigError> {
        self.procedure.check()?;
        self.certificate.check()?;
        if !is_one_line(&self.arm) {
            return Err(ConfigError::Arm {
                value: self.arm.escape_debug().take(60).collect(),
            });
        }
        self.cell.check()?;
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
        if !(self.plan.patience > 0.0) {
            return Err(ConfigError::Range {
                field: "plan.patience",
                value: self.plan.patience,
                remedy: "give a positive number, in units of a recording's time, or leave it out",
            });
        }
        Ok(())
    }

    /// The whole tree as TOML, with every field.
    ///
    /// # Errors
    /// Only if the serialiser fails.
    pub fn to_toml(&self) -> Result<String, ConfigError> {
        toml::to_string(self).map_err(|e| ConfigError::Syntax {
            path: "configuration".to_owned(),
            message: e.to_string(),
        })
    }
}
