//! A calibration from files, end to end: any robot, any table of poses.
//!
//! What stands behind `spherecal identify`; knows neither plant nor link nor
//! database.
//!
//! ```text
//! Request ─ load ─ align ─ identify ─ judge ─ verdict ─ Study ─ summary · files · report
//! ```
//!
//! Vocabulary: a *sample* is one row of the user's table; a *frame* is where
//! targets are given in (the tracker's, or the plate's in one of its *places*);
//! to *align* is to find where frames and tool stand, with the robot's nominal
//! geometry, before anything is identified; to *judge* is to predict samples
//! that the fit has not seen.

mod align;
mod files;
mod judge;
mod load;
mod plate;
mod run;
mod summary;
mod text;
mod tune;
mod verdict;

pub use align::{Alignment, align};
pub use files::{OutFiles, write_files};
pub use judge::{Errors, Judged, ModelErrors, Predictor, SampleError, judge};
pub use load::{Loaded, Request, Sample, load};
pub use run::{Fold, Holdout, Study, study};
pub use summary::summary_json;
pub use text::summary_text;
pub use verdict::{Verdict, verdict};

use crate::identify::IdentifyError;
use crate::input::InputError;
use crate::robots::RobotFileError;

/// Why a calibration from files could not be made.
#[derive(Debug, thiserror::Error)]
pub enum StudyError {
    /// The robot could not be loaded.
    #[error(transparent)]
    Robot(#[from] RobotFileError),
    /// The table, the plate or a number could not be used.
    #[error(transparent)]
    Input(#[from] InputError),
    /// The data could not be used, or nothing could be fitted to them.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// A file could not be written.
    #[error("{path}: cannot be written ({source}): check the directory, its permissions and the space left")]
    Write {
        /// File.
        path: String,
        /// What the system said.
        source: std::io::Error,
    },
    /// The report could not be made.
    #[error("the report could not be made: {0}")]
    Report(String),
}

impl StudyError {
    /// Whether the user's input is at fault (exit code 2) and not the job (1).
    pub fn is_input(&self) -> bool {
        match self {
            Self::Robot(_) | Self::Input(_) => true,
            Self::Identify(e) => !matches!(e, IdentifyError::Singular { .. } | IdentifyError::Diverged { .. }),
            Self::Write { .. } | Self::Report(_) => false,
        }
    }
}

#[cfg(test)]
mod tests;
