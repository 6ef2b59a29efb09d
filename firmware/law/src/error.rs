//! What the loop refuses.

use spherecal_shared::procedure::ProcedureError;
use spherecal_shared::robot::RobotError;

/// Why a loop is not made, or a setting not taken.
#[derive(Clone, Copy, Debug, PartialEq, thiserror::Error)]
pub enum LawError {
    /// Robot or tool are not possible, or have another number of joints.
    #[error(transparent)]
    Robot(#[from] RobotError),
    /// A number of the law is out of its range.
    #[error(transparent)]
    Law(#[from] ProcedureError),
    /// A stiffness is not a number, not symmetric, negative in some direction, or too large.
    #[error("{field}: give a symmetric stiffness from 0 to {most}")]
    Stiffness {
        /// The part of [`Stiffness`](crate::Stiffness).
        field: &'static str,
        /// Largest value, in N/m or N m/rad.
        most: f64,
    },
    /// A number of [`EnergyLimit`](crate::EnergyLimit) is negative or not finite.
    #[error("{field}: give a number from 0")]
    Energy {
        /// The field.
        field: &'static str,
    },
}
