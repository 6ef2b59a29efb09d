//! The Cartesian spring that a host sets.

use postcard_schema::Schema;
use serde::{Deserialize, Serialize};

use crate::procedure::{MAX_STIFFNESS_N_M, MAX_STIFFNESS_NM_RAD};

/// Farthest that the spring may be from where it began to hold, in m along each axis: a step for a person beside the arm.
const MOST_M: f64 = 0.3;
/// Largest turn of the tool from there about each axis, in rad. Together they stay below half a turn, where the way back
/// would be another one.
const MOST_RAD: f64 = 1.0;

/// A Cartesian spring at the TCP. Its rest is told from where the arm was when the spring began to hold it, so that a command that
/// is repeated changes nothing.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize, Schema)]
pub struct ImpedanceCommand {
    /// Translational stiffness along the axes of F0, in N/m.
    pub stiffness_n_m: [f64; 3],
    /// Rotational stiffness about all axes, in N m/rad.
    pub rotation_nm_rad: f64,
    /// Displacement of the rest position, F0, in m.
    pub offset_m: [f64; 3],
    /// Turn of the rest orientation: a rotation vector in F0, in rad.
    pub turn_rad: [f64; 3],
}

/// A number of a command is out of its range.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
#[error("{field} is {value}: give a value from {min} to {max}")]
pub struct OutOfRange {
    /// The field, with its unit.
    pub field: &'static str,
    /// Its value.
    pub value: f64,
    /// Smallest value accepted.
    pub min: f64,
    /// Largest value accepted.
    pub max: f64,
}

impl ImpedanceCommand {
    /// Checks every number against its range. NaN is out of every range.
    ///
    /// # Errors
    /// The first number that is out of its range.
    pub fn check(&self) -> Result<(), OutOfRange> {
        let rotation = [self.rotation_nm_rad];
        let ranges: [(&'static str, &[f64], f64, f64); 4] = [
            ("stiffness_n_m", &self.stiffness_n_m, 0.0, MAX_STIFFNESS_N_M),
            ("rotation_nm_rad", &rotation, 0.0, MAX_STIFFNESS_NM_RAD),
            ("offset_m", &self.offset_m, -MOST_M, MOST_M),
            ("turn_rad", &self.turn_rad, -MOST_RAD, MOST_RAD),
        ];
        for (field, values, min, max) in ranges {
            if let Some(value) = values.iter().find(|value| !(**value >= min && **value <= max)) {
                let value = *value;
                return Err(OutOfRange { field, value, min, max });
            }
        }
        Ok(())
    }
}
