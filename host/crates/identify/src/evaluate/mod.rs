//! One evaluation of one robot's recordings: align, identify, compare, judge.
//!
//! ```text
//! Recordings ─ fit (align · gross errors · priors · model · identify) ─▶ Calibration
//!            ├ reference (other estimators, an instrument's table)
//!            ├ folds (rows that the fit has not seen, cross-validation, hold-out)
//!            └ verdict ─▶ Evaluation
//! ```
//!
//! Works on plain data. The main job, the calibration from files, the study of the
//! paper and the comparison of estimators all call [`evaluate`]; they differ in what
//! they ask for ([`EvaluateOptions`]).
//!
//! Vocabulary: a *sample* is one row of the data; a *frame* is where targets are
//! given in (the tracker's, or the plate's in one of its *places*); to *align* is to
//! find where frames and tool stand, with the robot's nominal geometry, before
//! anything is identified; to *judge* is to predict samples that the fit has not seen.

mod align;
mod align_targets;
mod certified;
mod comparison;
mod error;
mod evaluation;
mod fit;
mod folds;
mod groups;
mod options;
mod plate;
mod reference;
mod repeats;
mod thin;

pub use crate::errors::{Errors, SampleError};
pub use crate::judge::{Fold, HeldOut, Judged, JudgedModel, Predictor, TcpFunction, judge};
pub use crate::judge_targets::{AngleStatistics, BodyOrientation, Further, TargetTcp, ToolPredictor, Turned};
pub use crate::recordings::Judge;
pub use align::{NominalFrames, align};
pub use certified::{Repeatability, repeatability};
pub use comparison::{Compared, Comparison, model_title};
pub use error::EvaluateError;
pub use evaluation::Evaluation;
pub use options::{EvaluateOptions, EvaluationStep};
pub use reference::{InstrumentView, ReferenceModel};

use crate::recordings::Recordings;
use crate::verdict::{Evidence, verdict};
use nalgebra::Vector3;
use spherecal_model::statistics::median;

use crate::causes::Course;
use crate::hierarchy::Ends;
use crate::hierarchy::constants::{HOPELESS, POSTURES, STRANGE};
use crate::statement::{Statement, judging_rows, measured_rows};
use crate::{GeometryOnly, IdentifyError, Method};
use evaluation::predicted;
use fit::{ChosenFit, fit};

/// Most rows that are left out and have a note each.
const NOTED: usize = 20;
/// Median turn (rad) of the measured orientation against the flange beyond which it is not the tool's.
const HOPELESS_RAD: f64 = 0.2;
/// Distances of the plate that differ by more than this (m) from the data's explain such data.
const WRONG_PLATE_M: f64 = 0.010;

/// Evaluates the recordings of one robot; `progress` is called before each step.
///
/// # Errors
/// Data or options that cannot be used, data of another robot, or no convergence.
pub fn evaluate(
    recordings: &Recordings,
    options: &EvaluateOptions,
    progress: &mut dyn FnMut(EvaluationStep),
) -> Result<Evaluation, EvaluateError> {
    let (train, repeated) = training_rows(recordings)?;
    progress(EvaluationStep::Fitting { rows: train.len() });
    let course = options.diagnose.then(|| course_of(recordings, &train));
    let fit = fit(
        &recordings.experiment,
        options,
        &options.identify,
        &train,
        course.as_ref(),
        &Ends::default(),
    )?;
    if options.align {
        plausible(recordings, &fit)?;
    }
    let statement = statement_of(recordings, options, &fit);
    let postures = match &statement {
        Some(statement) => statement.work_postures(),
        None => &crate::halton_configurations(&recordings.experiment.robot, POSTURES),
    };
    let geometry = geometry_of(recordings, &fit, postures, statement.as_ref())?;
    let mut notes = Vec::new();
    note_rejected(recordings, &fit, &mut notes);
    if let Some((copy, first)) = repeated.first() {
        notes.push(format!(
            "{} rows are copies of others and count once; the first: {} repeats {}",
            repeated.len(),
            recordings.describe(*copy),
            recordings.describe(*first)
        ));
    }
    let reference = match &recordings.tracker {
        Some(tracker) => Some(reference::reference(
            recordings,
            tracker,
            &options.models,
            &fit.options,
            &fit.calibration,
            &mut notes,
            progress,
        )?),
        None => None,
    };
    let table = reference.as_ref().and_then(|r| r.table.as_ref());
    let judges: Vec<Judge<'_>> = recordings.set_aside().collect();
    let cross_validated = judges.is_empty() && table.is_none() && options.cross_validate;
    let mut realigned_mm = None;
    let judged = if cross_validated {
        progress(EvaluationStep::Judging {
            fits: folds::FOLDS,
            rows: fit.used.len(),
        });
        cross_validation(recordings, options, &fit, &mut notes)?
    } else if judges.is_empty() {
        None
    } else {
        progress(EvaluationStep::Judging {
            fits: 1,
            rows: judges.len(),
        });
        let (judged, off) = judged_aside(recordings, (&fit, &geometry), &judges, &mut notes);
        realigned_mm = off;
        Some(judged)
    };
    let holdout = match &recordings.holdout {
        Some(column) => {
            let held = folds::hold_out(recordings, options, &fit, column)?;
            Some(held)
        }
        None => None,
    };
    let closed_loop = recordings.closed_loop();
    let predicted_mm = predicted(recordings, &fit.calibration, cross_validated, closed_loop);
    let verdict = verdict(&Evidence {
        recordings,
        options: &fit.options,
        used: &fit.used,
        rejected: &fit.rejected,
        repeated: &repeated,
        calibration: &fit.calibration,
        judged: judged.as_ref(),
        cross_validated,
        holdout: holdout.as_ref(),
        table,
        causes: &fit.causes,
        statement: statement.as_ref(),
        geometry: &geometry,
        nominal_tcp_m: if fit.found_tool {
            fit.nominal.tcp_m
        } else {
            recordings.experiment.tool.tcp()
        },
        accuracy_mm: options.accuracy_mm,
        realigned_mm,
    });
    Ok(Evaluation {
        causes: fit.causes,
        statement,
        geometry,
        given_tcp_m: fit.found_tool.then(|| recordings.experiment.tool.tcp()),
        options: fit.options,
        used: fit.used,
        rejected: fit.rejected,
        repeated,
        nominal: fit.nominal,
        calibration: fit.calibration,
        reference,
        judged,
        cross_validated,
        holdout,
        predicted_mm,
        verdict,
        notes,
        closed_loop,
    })
}

/// The course of the rows; the last moves are those between the rows of the calibration set.
fn course_of(recordings: &Recordings, train: &[usize]) -> Course {
    let course = match &recordings.course {
        Some(course) => course.clone(),
        None => Course::without_moves(&recordings.experiment),
    };
    course
        .with_moves_of(&recordings.experiment.observations, train)
        .with_places(
            recordings.samples.iter().map(|sample| sample.place).collect(),
            recordings.places.names().map(str::to_owned).collect(),
        )
}

/// What the result is worth; `None` for estimators without a posterior.
fn statement_of(recordings: &Recordings, options: &EvaluateOptions, fit: &ChosenFit) -> Option<Statement> {
    let calibration = &fit.calibration;
    if !options.diagnose || !matches!(calibration.method, Method::Full | Method::Geometry) {
        return None;
    }
    let own = fit.experiment(&recordings.experiment, &fit.used);
    let rows = measured_rows(&own, calibration);
    let judges = judging_rows(recordings, recordings.closed_loop());
    Statement::new(calibration, &rows, &judges, options.work.as_deref())
}

/// The geometry that the files hold: the best over the work region.
fn geometry_of(
    recordings: &Recordings,
    fit: &ChosenFit,
    postures: &[Vec<f64>],
    statement: Option<&Statement>,
) -> Result<GeometryOnly, EvaluateError> {
    let mut nominal = recordings.experiment.clone();
    nominal.observations.clear();
    if fit.found_tool {
        nominal.tool.tcp_m = fit.nominal.tcp_m.into();
    }
    Ok(GeometryOnly::of(&fit.calibration, &nominal, postures, statement)?)
}

/// The rows of the calibration set, each once, and the copies among them with the
/// row that each repeats.
fn training_rows(recordings: &Recordings) -> Result<(Vec<usize>, Vec<(usize, usize)>), EvaluateError> {
    let observations = &recordings.experiment.observations;
    let mut train = recordings.training_rows();
    // Validation rows stand behind all rows of the data.
    let judges: Vec<Judge<'_>> = recordings.set_aside().collect();
    let behind = judges.iter().map(|j| (observations.len() + j.index, j.observation));
    let all: Vec<_> = train.iter().map(|&i| (i, &observations[i])).chain(behind).collect();
    let (repeated, others): (Vec<_>, Vec<_>) = repeats::copies(&all)
        .into_iter()
        .partition(|(copy, _)| *copy < observations.len());
    let seen: Vec<(usize, usize)> = others.into_iter().filter(|(_, of)| *of < observations.len()).collect();
    if let Some((_, of)) = seen.first() {
        return Err(EvaluateError::Seen {
            copies: seen.len(),
            judges: judges.len(),
            first: recordings.describe(*of),
        });
    }
    if !repeated.is_empty() {
        let copies: std::collections::HashSet<usize> = repeated.iter().map(|r| r.0).collect();
        train.retain(|i| !copies.contains(i));
    }
    Ok((train, repeated))
}

/// Names the rows that were left out.
fn note_rejected(recordings: &Recordings, fit: &ChosenFit, notes: &mut Vec<String>) {
    for &(i, mm) in fit.rejected.iter().take(NOTED) {
        notes.push(format!(
            "{}: left out, {mm:.1} mm from where any calibration of this robot could bring it",
            recordings.describe(i)
        ));
    }
    if let Some(more) = fit.rejected.len().checked_sub(NOTED).filter(|more| *more > 0) {
        notes.push(format!("{more} more rows were left out as far off"));
    }
}

/// The cross-validation; none, with a note, where the rows are too few to leave any out.
fn cross_validation(
    recordings: &Recordings,
    options: &EvaluateOptions,
    fit: &ChosenFit,
    notes: &mut Vec<String>,
) -> Result<Option<Judged>, EvaluateError> {
    match folds::cross_validate(recordings, options, fit) {
        Ok(judged) => Ok(Some(judged)),
        Err(EvaluateError::Identify(
            error @ (IdentifyError::TooFewObservations { .. }
            | IdentifyError::TooFewOfTarget { .. }
            | IdentifyError::NoVariety
            | IdentifyError::Singular { .. }),
        )) => {
            notes.push(format!(
                "no cross-validation: with a part of the rows left out, {error}"
            ));
            Ok(None)
        }
        Err(error) => Err(error),
    }
}

/// Judges a fit by the rows that were set aside, in their own frame where they are
/// not in the frame that was said; with how far (mm) they were off as a whole then.
fn judged_aside(
    recordings: &Recordings,
    fit: (&ChosenFit, &GeometryOnly),
    judges: &[Judge<'_>],
    notes: &mut Vec<String>,
) -> (Judged, Option<f64>) {
    let words = format!("{} samples that the fit has not seen", judges.len());
    let mut own = folds::judged(recordings, fit, judges, &words);
    let elsewhere = own.realign_if_elsewhere(judges);
    if let Some(off) = elsewhere {
        own.by += ", after a best rigid fit of their frame";
        notes.push(format!(
            "the validation points are not in the {} frame: they are {off:.0} mm off as a whole, and fit within a \
             rigid motion, which was taken out for every model",
            if recordings.closed_loop() {
                "plate's"
            } else {
                "calibration data's"
            }
        ));
    }
    (own, elsewhere)
}

/// What is wrong with data of another robot: the fit leaves too much, or explains the rows with another shape of the arm.
pub const UNLIKE: [&str; 3] = [DISTANCE, LENGTHS, TWISTS];
const DISTANCE: &str = "median distance of the calibrated robot's TCP from its targets";
const LENGTHS: &str = "size of the errors of the robot's lengths";
const TWISTS: &str = "size of the errors of the robot's twists";

/// Refuses data that no calibration of this robot explains, by what its fit leaves, with what is
/// probably wrong.
fn plausible(recordings: &Recordings, fit: &ChosenFit) -> Result<(), EvaluateError> {
    let left: Vec<f64> = fit
        .calibration
        .residual
        .rows
        .iter()
        .map(|row| Vector3::from(row.error_mm).norm() * 1e-3)
        .collect();
    let median = median(left);
    let arm = &recordings.experiment.robot;
    let reach: f64 = arm
        .joints
        .iter()
        .map(|joint| joint.mdh.a.abs() + joint.mdh.d.abs())
        .sum();
    let strange = fit.calibration.strangeness;
    if median <= HOPELESS * reach && strange.sigmas < STRANGE {
        return match fit.nominal.median_turn_rad {
            Some(turn) if turn > HOPELESS_RAD => Err(EvaluateError::NotThisOrientation {
                median_deg: turn.to_degrees(),
            }),
            _ => Ok(()),
        };
    }
    let distance = format!("{:.1} mm", median * 1e3);
    if let Some(remedy) = plate::contradiction(&recordings.experiment, WRONG_PLATE_M) {
        let field = "the plate";
        return Err(EvaluateError::NotThisRobot {
            field,
            value: distance,
            remedy,
        });
    }
    let (field, value) = if median > HOPELESS * reach {
        (DISTANCE, distance)
    } else if strange.lengths {
        (LENGTHS, format!("{:.0} mm", strange.size * 1e3))
    } else {
        (TWISTS, format!("{:.0} mrad", strange.size * 1e3))
    };
    Err(EvaluateError::NotThisRobot {
        field,
        value,
        remedy: "these are not data of this robot: check robot, joint order, signs, zero offsets and units".to_owned(),
    })
}

/// A point in m as mm, for people.
pub fn millimetres(p: &[f64; 3]) -> String {
    format!("({:.2}, {:.2}, {:.2})", p[0] * 1e3, p[1] * 1e3, p[2] * 1e3)
}
