//! Why a plant was refused: the field, its value and the remedy.

use spherecal_model::CellError;
use spherecal_shared::robot::RobotError;

/// A plant that cannot be built.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlantError {
    /// The nominal robot or tool was refused.
    #[error("plant: {0}")]
    Robot(#[from] RobotError),
    /// The cell in which it stands is not possible.
    #[error(transparent)]
    Cell(#[from] CellError),
    /// A number of the configuration is not finite or not possible.
    #[error("plant.{field} is {value}: {remedy}")]
    Field {
        /// Field, as it is written in the file.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// No such preset.
    #[error("plant preset `{name}` is not known: use one of {known}")]
    Preset {
        /// What was asked for.
        name: String,
        /// What there is.
        known: String,
    },
    /// The configuration file could not be read as one.
    #[error("plant configuration: {reason}: correct the file, or start from `PlantConfig::typical()` as TOML")]
    Toml {
        /// The parser's reason, with line and column.
        reason: String,
    },
    /// The mass matrix is singular: a link chain without inertia.
    #[error("the mass matrix is not positive definite at the initial joint angles: give every link a mass and inertia")]
    Massless,
}
