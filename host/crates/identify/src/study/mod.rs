//! A calibration from files, end to end: any robot, any table of poses.
//!
//! What stands behind `spherecal identify`; knows neither plant nor link nor
//! database.
//!
//! ```text
//! Request ─ load ─ align ─ identify ─ judge ─ verdict ─ Study
//! ```
//!
//! Vocabulary: a *sample* is one row of the user's table; a *frame* is where
//! targets are given in (the tracker's, or the plate's in one of its *places*);
//! to *align* is to find where frames and tool stand, with the robot's nominal
//! geometry, before anything is identified; to *judge* is to predict samples
//! that the fit has not seen.

mod align;
mod judge;
mod load;
mod plate;
mod run;
mod tune;
mod verdict;

pub use align::{Alignment, align};
pub use judge::{Errors, Judge, Judged, ModelErrors, Predictor, SampleError, Tcp, judge};
pub use load::{Loaded, Request, Rows, Sample, load};
pub use run::{Fold, Holdout, Step, Study, millimetres, study};
pub use verdict::{Verdict, verdict};

use spherecal_model::DataError;
use spherecal_model::input::InputError;
use spherecal_model::robots::RobotFileError;

use crate::IdentifyError;

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
}

impl From<DataError> for StudyError {
    fn from(error: DataError) -> Self {
        IdentifyError::from(error).into()
    }
}

impl StudyError {
    /// Whether the user's input is at fault (exit code 2) and not the job (1).
    pub fn is_input(&self) -> bool {
        match self {
            Self::Robot(_) | Self::Input(_) => true,
            Self::Identify(e) => !matches!(e, IdentifyError::Singular { .. } | IdentifyError::Diverged { .. }),
        }
    }
}

#[cfg(test)]
mod tests;
