//! Identification of a robot from plain data: joint angles, and where the TCP was.
//!
//! Knows no plant, no link and no database, so that it serves any robot's data.
//! [`identify()`] fits one model to an [`Experiment`]. [`evaluate()`] does everything
//! around it: alignment, gross errors, named causes, comparison, validation,
//! and the verdict whether the result may be used.
//!
//! ```text
//! files ─ study::load ─▶ Recordings ─ evaluate ─▶ Evaluation {Calibration, Verdict}
//!
//! Experiment ─ check ─ register ─ hierarchy ─ causes ─ finish ─ Calibration
//!              (data)  (chain)    (normal · solve)      (calibration)
//! ```
//!
//! ```
//! use spherecal_identify::{Experiment, EvaluateOptions, Observation, Recordings, Set, Target};
//! use spherecal_identify::{evaluate, halton_configurations};
//! use spherecal_model::chain::Chain;
//! use spherecal_shared::robot::{iiwa7, iiwa7_tool};
//!
//! // An arm whose third link is 1 mm longer than its data sheet says, seen by a tracker.
//! let mut real = iiwa7();
//! real.joints[2].mdh.d += 1e-3;
//! let chain = Chain::unchecked(&real, &iiwa7_tool());
//! let observations = halton_configurations(&real, 60).into_iter().map(|q| Observation {
//!     seat: None,
//!     target: Target::Point(chain.tcp_of(&chain.frames(&q)).into()),
//!     q,
//!     tau: None,
//!     set: Set::Calibrate,
//! });
//! let recordings = Recordings::new(Experiment {
//!     robot: iiwa7(),
//!     tool: iiwa7_tool(),
//!     spheres: Vec::new(),
//!     observations: observations.collect(),
//! });
//! let found = evaluate(&recordings, &EvaluateOptions::default(), &mut |_| {})?;
//! assert!(found.verdict.may_be_used);
//! let d3 = found.calibration.parameters.iter().find(|p| p.name == "d3").unwrap();
//! assert!((d3.estimate - d3.nominal - 1e-3).abs() < 1e-4);
//! # Ok::<(), spherecal_identify::EvaluateError>(())
//! ```
//!
//! [`parameters`] is the one table of names, [`priors`] and reasons; [`algorithm1`]
//! and [`identifiability`] say what the data can tell.

pub mod algorithm1;
pub mod arcs;
mod calibration;
pub mod causes;
mod chain;
pub mod check;
mod compensate;
mod course;
mod dense;
mod distance;
mod error;
mod errors;
pub mod evaluate;
mod finish;
mod flange;
mod geometry_only;
mod hierarchy;
mod holdout;
pub mod identifiability;
mod judge;
mod judge_targets;
mod load;
mod noise_scale;
mod normal;
mod options;
pub mod parameter_table;
pub mod parameters;
mod parts;
pub mod priors;
mod recordings;
mod residuals;
mod rows;
mod seen;
mod solve;
mod start_targets;
mod statement;
pub mod study;
mod target_fit;
mod targets;
#[cfg(test)]
mod testing;
pub mod validate;
mod values;
pub mod verdict;
mod workspace;

pub use calibration::{Calibration, FramePose, NoiseFound, ParameterEstimate};
pub use distance::{DistanceProblem, halton_configurations};
pub use error::IdentifyError;
pub use evaluate::{Comparison, EvaluateError, EvaluateOptions, Evaluation, evaluate};
pub use geometry_only::GeometryOnly;
pub use holdout::{Holdout, LeftOutPart, Split, holdout, possible_splits};
pub use identifiability::{Identifiability, Observability};
pub use options::{Method, Model, Noise, Options, Pairs, Torque, UnknownName};
pub use parameters::{Kind, Override, Overrides, Unit};
pub use recordings::{CampaignRecord, Recordings, RowNames, RowSource, TrackerRecordings, ValidationRows};
pub use residuals::{GroupFit, Outlier, Residual, ResidualRow};
pub use rows::DesignModel;
pub use spherecal_model::{DataError, Experiment, Observation, Pose, Set, Sphere, Target, fit_pose, paper_plate};
pub use spherecal_shared::robot::{Robot, Tool};
pub use statement::{BudgetTerm, ErrorBudget, ExpectedError, ExpectedErrors, Source, Statement};
pub use target_fit::{OrientationFit, TargetFit};
pub use targets::Reference;
pub use verdict::{Check, Verdict};
pub use workspace::{WORKSPACE, workspace};

/// Identifies a robot from an experiment's calibration set.
///
/// ```
/// use spherecal_identify::{Experiment, IdentifyError, Options, identify};
/// use spherecal_shared::robot::{iiwa7, iiwa7_tool};
///
/// let nothing = Experiment {
///     robot: iiwa7(),
///     tool: iiwa7_tool(),
///     spheres: Vec::new(),
///     observations: Vec::new(),
/// };
/// let refused = identify(&nothing, &Options::default());
/// assert!(matches!(refused, Err(IdentifyError::TooFewObservations { .. })));
/// ```
///
/// # Errors
/// Data or options that cannot be used, with row, field, value and remedy; or
/// no convergence.
pub fn identify(experiment: &Experiment, options: &Options) -> Result<Calibration, IdentifyError> {
    identify_from(experiment, options, &hierarchy::Before::default())
}

/// The same, with what is known before.
///
/// # Errors
/// As of [`identify`].
fn identify_from(
    experiment: &Experiment,
    options: &Options,
    before: &hierarchy::Before,
) -> Result<Calibration, IdentifyError> {
    experiment.check()?;
    options.check()?;
    match options.method {
        Method::Full => {
            let fit = hierarchy::fit(experiment, options, options.model, before, |_| true)?;
            Ok(finish::finish(experiment, options, options.model, fit))
        }
        Method::Geometry => {
            let fit = hierarchy::fit(experiment, options, Model::Geometry, before, |_| true)?;
            Ok(finish::finish(experiment, options, Model::Geometry, fit))
        }
        Method::Lm | Method::GaussNewton => distance::identify(experiment, options),
    }
}
