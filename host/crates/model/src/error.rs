//! Why an experiment was refused.

use spherecal_shared::robot::RobotError;

/// What is wrong with an experiment: where, with its value, and the remedy.
///
/// Rows count the observations from 1, as the lines of a CSV under its header.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum DataError {
    /// The nominal robot or tool is not usable.
    #[error("the nominal robot: {0}")]
    Robot(#[from] RobotError),
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
    /// A row says where the tool was in a way that the estimators do not take.
    #[error("row {row}: gives {kind}: {remedy}")]
    TargetKind {
        /// Row, from 1.
        row: usize,
        /// What it gives.
        kind: &'static str,
        /// What to give instead.
        remedy: &'static str,
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
}
