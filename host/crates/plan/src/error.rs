//! Why no plan could be made.

use spherecal_identify::IdentifyError;
use spherecal_model::ChainError;

use super::path::Obstacle;

/// Why no plan could be made: what, its value, and the remedy.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum PlanError {
    /// The robot or its tool was refused.
    #[error(transparent)]
    Chain(#[from] ChainError),
    /// No sphere to touch.
    #[error("spheres is empty: list at least one sphere in the plate file")]
    NoSpheres,
    /// No place for the plate.
    #[error("plates is empty: give at least one placement of the plate")]
    NoPlate,
    /// A number is NaN, infinite or outside its possible range.
    #[error("{field} is {value}: {remedy}")]
    OutOfRange {
        /// Field of the cell or the request.
        field: &'static str,
        /// Its value.
        value: f64,
        /// What to write instead.
        remedy: &'static str,
    },
    /// The model for the predicted accuracy was refused.
    #[error(transparent)]
    Model(#[from] IdentifyError),
    /// No allowed number of poses reaches the requested accuracy.
    #[error(
        "{poses} poses or fewer do not reach a mean TCP error of {wanted_mm} mm (predicted: {best_mm:.3} mm): \
         allow a larger error, move the plate to a second placement ([[cell.placements]]), or allow wider poses (plan.range)"
    )]
    Accuracy {
        /// Mean error that was asked for, in mm.
        wanted_mm: f64,
        /// The most poses that were considered.
        poses: usize,
        /// Their predicted mean error, in mm.
        best_mm: f64,
    },
    /// The arm cannot come to a sphere at all.
    #[error(
        "{} at ({x_mm:.1}, {y_mm:.1}, {z_mm:.1}) mm in the base frame: {obstacle}; move the plate closer to the middle of the arm's reach",
        place(*sphere)
    )]
    SphereOutOfReach {
        /// Id of the sphere; 0 for the home frame above the plate.
        sphere: u32,
        /// Its place in F0, in mm.
        x_mm: f64,
        /// Its place in F0, in mm.
        y_mm: f64,
        /// Its place in F0, in mm.
        z_mm: f64,
        /// The obstacle.
        obstacle: Obstacle,
    },
}

/// What cannot be reached.
fn place(sphere: u32) -> String {
    match sphere {
        0 => "the home frame above the plate".to_owned(),
        id => format!("sphere {id}"),
    }
}
