//! Why data were refused, or why no model could be fitted to them.

use spherecal_shared::robot::RobotError;

/// Refusal of an identification: what is wrong, where, and the remedy.
///
/// Rows count the observations from 1, as the lines of a CSV under its header.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum IdentifyError {
    /// The nominal robot or tool is not usable.
    #[error("the nominal robot: {0}")]
    Robot(#[from] RobotError),
    /// Too few observations to fit anything.
    #[error(
        "{found} usable observations in the calibration set, at least {needed} are needed: measure more poses, \
         or mark fewer as `validate`"
    )]
    TooFewObservations {
        /// Observations there are.
        found: usize,
        /// Observations needed.
        needed: usize,
    },
    /// A row has another number of joints than the robot.
    #[error("row {row}: {found} joint values, the robot has {expected} joints: give q1..q{expected}")]
    JointCount {
        /// Row, from 1.
        row: usize,
        /// Values found (angles or torques).
        found: usize,
        /// Joints of the robot.
        expected: usize,
    },
    /// A number is NaN or infinite.
    #[error("row {row}: {field} is {value}: give a finite number or leave the row out")]
    NotFinite {
        /// Row, from 1.
        row: usize,
        /// Column of the data.
        field: String,
        /// Its value.
        value: f64,
    },
    /// A number is far outside what the field can hold: almost surely a wrong unit.
    #[error("row {row}: {field} is {value}: {remedy}")]
    OutOfRange {
        /// Row, from 1.
        row: usize,
        /// Column of the data.
        field: String,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// A row names a sphere that the plate does not have.
    #[error("row {row}: sphere {sphere} is not on the plate, which has {known}: correct the id or the plate file")]
    UnknownSphere {
        /// Row, from 1.
        row: usize,
        /// The id.
        sphere: u32,
        /// Ids of the plate.
        known: String,
    },
    /// The plate's certificate is not usable.
    #[error("sphere {sphere}: {field} is {value}: {remedy}")]
    Plate {
        /// Id of the sphere.
        sphere: u32,
        /// Field.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
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
    #[error("the data do not determine the model ({free} unknowns): give priors to what is free, or more varied poses")]
    Singular {
        /// Unknowns of the model.
        free: usize,
    },
    /// The iteration ran away.
    #[error("the fit did not converge (residual {rms_mm} mm): check joint units and signs, robot, tool and sphere ids")]
    Diverged {
        /// Root mean square of the residual where it stopped, in mm.
        rms_mm: f64,
    },
    /// Nothing moves the residual: no pose differs from another.
    #[error("all poses are the same configuration: vary the joints")]
    NoVariety,
}
