//! Why a configuration was refused: the field, its value and the remedy.

use spherecal_model::{CellError, FileError};
use spherecal_shared::procedure::ProcedureError;
use spherecal_sim::LossyError;
use spherecal_sim::plant::PlantError;

/// Why a configuration was refused.
#[derive(Debug, thiserror::Error)]
pub enum ConfigError {
    /// The file cannot be read.
    #[error(transparent)]
    File(#[from] FileError),
    /// The file is not TOML, or contains an unknown name.
    #[error("{path}: {message}\nremedy: `spherecal config --print` shows every field with its default")]
    Syntax {
        /// File.
        path: String,
        /// What is wrong, and where.
        message: String,
    },
    /// The file has the layout of an older program, which kept the real cell in `[plant]`.
    #[error(
        "{path} was written for an older program: the real cell is now in [cell], and [plant] has only the simulated \
         errors\nremedy: remove {fields}\nand write at the end of the file (instead of [cell], if it has one):\n\n{lines}"
    )]
    OldLayout {
        /// File.
        path: String,
        /// The fields that moved, by their old names.
        fields: String,
        /// The lines that take their place.
        lines: String,
    },
    /// The cell is not possible.
    #[error(transparent)]
    Cell(#[from] CellError),
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
    /// A word of the certificate cannot be printed.
    #[error("certificate.{field} is {value}: {remedy}")]
    Certificate {
        /// Field, as it stands below `[certificate]`.
        field: &'static str,
        /// Its value.
        value: String,
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
