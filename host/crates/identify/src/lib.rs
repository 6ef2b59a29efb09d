//! Identification of a robot from plain data: joint angles, and where the TCP was.
//!
//! Knows no plant, no link and no database, so that it serves any robot's CSV.
//! Data in: [`Experiment`]. Result out: [`Calibration`], by [`identify`].
//!
//! ```text
//! Experiment ─ check ─ register ─ geometry ─ structured effects ─ Calibration
//!              (data)  (chain)   (map · normal · solve)          (calibration)
//! ```
//!
//! [`parameters`] is the one table of names, [`priors`] and reasons; [`algorithm1`]
//! and [`identifiability`] say what the data can tell.

pub mod algorithm1;
pub mod arcs;
mod calibration;
mod chain;
mod choice;
pub mod diagnosis;
mod distance;
mod effects;
mod error;
mod holdout;
pub mod identifiability;
mod map;
mod noise_scale;
mod normal;
mod options;
pub mod paper;
pub mod parameters;
pub mod priors;
mod rows;
mod search;
pub mod simplex;
mod solve;
pub mod study;
pub mod validate;

pub use calibration::{Calibration, FramePose, GroupFit, Outlier, ParameterEstimate, Residual, ResidualRow};
pub use choice::{Refusal, choose_model};
pub use distance::{DistanceProblem, halton_configurations};
pub use error::IdentifyError;
pub use holdout::{Holdout, Part, Split, holdout, possible_splits};
pub use identifiability::{Identifiability, Observability};
pub use options::{Method, Model, Noise, Options, Pairs, Torque, UnknownName};
pub use parameters::{Kind, Override, Overrides, Reference, Unit};
pub use rows::DesignModel;
pub use spherecal_model::{DataError, Experiment, Observation, Pose, Set, Sphere, Target, paper_plate};

/// Identifies a robot from an experiment's calibration set.
///
/// # Errors
/// Data or options that cannot be used, with row, field, value and remedy; or
/// no convergence.
pub fn identify(experiment: &Experiment, options: &Options) -> Result<Calibration, IdentifyError> {
    experiment.check()?;
    options.check()?;
    match options.method {
        Method::Map => {
            let fit = map::fit(experiment, options, options.model, |_| true)?;
            Ok(calibration::finish(experiment, options, options.model, fit))
        }
        Method::Geometry => {
            let fit = map::fit(experiment, options, Model::Geometry, |_| true)?;
            Ok(calibration::finish(experiment, options, Model::Geometry, fit))
        }
        Method::Lm | Method::GaussNewton => distance::identify(experiment, options),
        Method::NelderMead | Method::NelderMeadScaled => paper::identify(experiment, options),
    }
}
