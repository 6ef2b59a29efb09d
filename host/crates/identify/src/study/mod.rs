//! A calibration from files, end to end: any robot, any table of poses.
//!
//! What stands behind `spherecal identify`; knows neither plant nor link nor
//! database.
//!
//! ```text
//! Request ─ load ────▶ Recordings ─ evaluate ─▶ Study
//! Sources ─ assemble ─┘
//! ```

mod anonymous;
mod checks;
mod load;
mod sources;
mod torques;

pub use anonymous::anonymous_csv;
pub use load::{Loaded, StudyRequest, assemble, load, sources};
pub use sources::{PAPER_PLATE, Sources, TableSource};

use spherecal_model::chain::Chain;
use spherecal_model::input::{InputError, ReadingProgress};
use spherecal_model::robots::{RobotFileError, RobotModel};
use spherecal_model::{DataError, WorkBox};

use crate::evaluate::{self, EvaluateError, EvaluateOptions, Evaluation, evaluate, millimetres};
use crate::{IdentifyError, Recordings, WORKSPACE};

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
    /// The data could not be evaluated.
    #[error(transparent)]
    Evaluate(EvaluateError),
}

impl From<DataError> for StudyError {
    fn from(error: DataError) -> Self {
        IdentifyError::from(error).into()
    }
}

impl StudyError {
    /// Whether the user's input is at fault (exit code 2) and not the job (1).
    pub fn is_input(&self) -> bool {
        let input = |e: &IdentifyError| !matches!(e, IdentifyError::Singular { .. } | IdentifyError::Diverged { .. });
        match self {
            Self::Robot(_) | Self::Input(_) => true,
            Self::Identify(e) | Self::Evaluate(EvaluateError::Identify(e)) => input(e),
            Self::Evaluate(_) => true,
        }
    }

    /// Of an evaluation of the rows of a file.
    fn of(error: EvaluateError, file: &str) -> Self {
        match error {
            EvaluateError::Identify(error) => error.into(),
            EvaluateError::NotThisRobot { field, value, remedy } => InputError::Field {
                file: file.to_owned(),
                field: field.to_owned(),
                value,
                remedy,
            }
            .into(),
            EvaluateError::Holdout { column, what, remedy } => InputError::Columns {
                file: file.to_owned(),
                what: format!("--holdout {column}: {what}"),
                remedy,
            }
            .into(),
            error => Self::Evaluate(error),
        }
    }
}

/// How far a study has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum StudyStep {
    /// A table is being read.
    Reading(ReadingProgress),
    /// Its rows are evaluated.
    Evaluating(evaluate::EvaluationStep),
}

/// A calibration from files with everything that is known about it.
#[derive(Clone, Debug)]
pub struct Study {
    /// The robot with its files' frames.
    pub model: RobotModel,
    /// The rows of the files.
    pub recordings: Recordings,
    /// The calibration and its verdict.
    pub evaluation: Evaluation,
    /// What the user should know.
    pub notes: Vec<String>,
    /// Time taken, in s.
    pub wall_s: f64,
}

/// Runs a study from files.
///
/// # Errors
/// Input that cannot be used, or no convergence.
pub fn study(request: &StudyRequest, progress: &mut dyn FnMut(StudyStep)) -> Result<Study, StudyError> {
    let loaded = load(request, &mut |read| progress(StudyStep::Reading(read)))?;
    study_from(request, loaded, progress)
}

/// Runs a study of what a caller has in memory; see [`Sources`].
///
/// # Errors
/// As [`study`].
pub fn study_of(
    request: &StudyRequest,
    sources: Sources<'_>,
    progress: &mut dyn FnMut(StudyStep),
) -> Result<Study, StudyError> {
    let loaded = assemble(request, sources, &mut |read| progress(StudyStep::Reading(read)))?;
    study_from(request, loaded, progress)
}

/// The postures of a work region that was asked for, in rad.
fn postures_of(work: &WorkBox, recordings: &Recordings) -> Result<Vec<Vec<f64>>, InputError> {
    let chain = Chain::unchecked(&recordings.experiment.robot, &recordings.experiment.tool);
    work.configurations(&chain, WORKSPACE)
        .map_err(|remedy| InputError::Field {
            file: "command line".to_owned(),
            field: "--work-mm".to_owned(),
            value: work
                .0
                .map(|side| format!("{:.0}:{:.0}", side[0] * 1e3, side[1] * 1e3))
                .join(","),
            remedy: remedy.to_owned(),
        })
}

/// Runs a study of what was [loaded](load).
///
/// # Errors
/// As [`study`].
pub fn study_from(
    request: &StudyRequest,
    loaded: Loaded,
    progress: &mut dyn FnMut(StudyStep),
) -> Result<Study, StudyError> {
    let Loaded {
        model,
        recordings,
        mut notes,
        begun,
    } = loaded;
    let mut identify = request.options.clone();
    identify.parameters.expect_tolerances(&model.tolerances);
    let options = EvaluateOptions {
        identify,
        accuracy_mm: request.accuracy_mm,
        work: request.work.map(|work| postures_of(&work, &recordings)).transpose()?,
        ..EvaluateOptions::default()
    };
    let evaluation = evaluate(&recordings, &options, &mut |step| progress(StudyStep::Evaluating(step)))
        .map_err(|error| StudyError::of(error, &recordings.file))?;
    if let Some(given) = evaluation.given_tcp_m {
        let found = model.tcp_in_flange(evaluation.nominal.tcp_m.into());
        notes.push(format!(
            "the tool is not where it was said: the data put the TCP at {} mm in the flange frame, {:.1} mm from the \
             nominal {} mm; it was taken from the data",
            millimetres(&found),
            (evaluation.nominal.tcp_m - given).norm() * 1e3,
            millimetres(&model.tool.tcp_m),
        ));
    }
    notes.extend(evaluation.notes.iter().cloned());
    Ok(Study {
        model,
        recordings,
        evaluation,
        notes,
        wall_s: begun.elapsed().as_secs_f64(),
    })
}

#[cfg(test)]
mod targets_tests;
#[cfg(test)]
mod tests;
