//! Why recordings could not be evaluated.

use crate::IdentifyError;
use crate::arcs::LaserError;
use crate::validate::ValidateError;

/// Why recordings could not be evaluated.
#[derive(Clone, Debug, thiserror::Error)]
pub enum EvaluateError {
    /// The calibration failed.
    #[error(transparent)]
    Identify(#[from] IdentifyError),
    /// The arcs gave no frames.
    #[error(transparent)]
    Arcs(#[from] LaserError),
    /// The models could not be validated.
    #[error(transparent)]
    Validate(#[from] ValidateError),
    /// No calibration of this robot explains the data.
    #[error("{field} is {value}: {remedy}")]
    NotThisRobot {
        /// What is wrong.
        field: &'static str,
        /// How far, with its unit.
        value: String,
        /// What to check.
        remedy: String,
    },
    /// The measured orientations do not turn with the robot's flange.
    #[error(
        "the measured orientation is {median_deg:.0} degrees from the flange's in the median row, also after the best \
         fit: give the orientation of the tool in the frame of the measuring device (not the inverse), as a \
         quaternion with w first, or leave it out with --ignore-columns"
    )]
    NotThisOrientation {
        /// Median angle after the best fit, in degrees.
        median_deg: f64,
    },
    /// Rows that are to judge the result are rows that it is made from.
    #[error(
        "{copies} of {judges} validation rows are copies of calibration rows (the first: {first}): they judge nothing; \
         give rows that were measured apart"
    )]
    Seen {
        /// How many.
        copies: usize,
        /// Validation rows in all.
        judges: usize,
        /// The first of them.
        first: String,
    },
    /// The hold-out cannot be made.
    #[error("hold-out by {column}: {what}: {remedy}")]
    Holdout {
        /// The column.
        column: String,
        /// Why not.
        what: String,
        /// What to do.
        remedy: String,
    },
}
