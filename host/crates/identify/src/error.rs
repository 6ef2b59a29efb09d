//! Why data were refused, or why no model fits them.

use spherecal_model::DataError;

/// An identification that was refused: the cause, its place, and the remedy.
///
/// Rows count the observations from 1, as the lines of a CSV under its header.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// The experiment's numbers are not usable.
    #[error(transparent)]
    Data(#[from] DataError),
    /// Too few observations to fit anything.
    #[error(
        "the calibration set has {found} usable observations, but at least {needed} are needed: measure more poses, \
         or mark fewer as `validate`"
    )]
    TooFewObservations {
        /// Observations there are.
        found: usize,
        /// Observations needed.
        needed: usize,
    },
    /// A target or the orientation is in too few rows to be placed on the tool.
    #[error(
        "{what} is in {found} rows of the calibration set, but at least {needed} are needed: measure it in more poses, or \
         leave its columns out (--ignore-columns)"
    )]
    TooFewOfTarget {
        /// Which, in words.
        what: String,
        /// Rows there are.
        found: usize,
        /// Rows needed.
        needed: usize,
    },
    /// Torques asked for that the data do not have.
    #[error("row {row} has no torques: add tau1..tau{expected}, or take the gravity torque from the model")]
    NoTorque {
        /// Row, from 1.
        row: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// A number among the options is not possible.
    #[error("option {field} is {value}: {remedy}")]
    Option {
        /// Field of the options.
        field: String,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// The override table names a parameter that this model does not have.
    #[error("parameter `{name}` is not in the model: {known}")]
    UnknownParameter {
        /// Name in the table.
        name: String,
        /// Some that there are.
        known: String,
    },
    /// A method cannot work on this kind of data.
    #[error("method {method}: {reason}")]
    Method {
        /// Name of the method.
        method: &'static str,
        /// Why, and what to do.
        reason: String,
    },
    /// The normal equations have no unique solution.
    #[error(
        "the data do not determine the model ({free} unknowns): give priors to the free parameters, or add more varied poses"
    )]
    Singular {
        /// Unknowns of the model.
        free: usize,
    },
    /// The iteration ran away.
    #[error("the fit did not converge (residual {rms_mm} mm): check joint units and signs, robot, tool and sphere ids")]
    Diverged {
        /// Root mean square of the residual at the last step, in mm.
        rms_mm: f64,
    },
    /// The residual does not depend on the poses: all poses are equal.
    #[error("all poses are the same configuration: vary the joints")]
    NoVariety,
}
