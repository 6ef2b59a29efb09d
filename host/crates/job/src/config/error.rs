//! Why a configuration was refused: the field, its value and the remedy.

use spherecal_link::LossyError;
use spherecal_model::{CellError, FileError};
use spherecal_shared::procedure::ProcedureError;

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
    /// The cell is not possible.
    #[error(transparent)]
    Cell(#[from] CellError),
    /// A number of the procedure is out of range.
    #[error(transparent)]
    Procedure(#[from] ProcedureError),
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
    /// The name of the arm cannot be printed.
    #[error("arm is \"{value}\": give one line of at most 60 characters, such as the serial number")]
    Arm {
        /// Its name, as far as it is printed.
        value: String,
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
}
