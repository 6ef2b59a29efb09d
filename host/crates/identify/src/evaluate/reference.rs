//! The other estimators that an evaluation can compare with, and the table that an
//! independent instrument's measurements make of all of them.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::Tool;

use super::error::EvaluateError;
use super::estimator::Estimator;
use super::options::EvaluationStep;
use crate::arcs::MeasuredFrames;
use crate::recordings::{Recordings, TrackerRecordings};
use crate::validate::{Prediction, ValidationTable, validate};
use crate::{Calibration, Experiment, IdentifyError, Method, Options, Override, Pose, identify, paper};

/// A calibration to compare with.
#[derive(Clone, Debug)]
pub struct ReferenceModel {
    /// What made it.
    pub estimator: Estimator,
    /// The calibration.
    pub calibration: Calibration,
}

/// What the independent instrument says of the calibration and of other models.
#[derive(Clone, Debug)]
pub struct InstrumentView {
    /// Base and tool as the instrument measured them.
    pub frames: MeasuredFrames,
    /// The other models, in the order asked for.
    pub models: Vec<ReferenceModel>,
    /// All models on the instrument's validation points; none without such points.
    pub table: Option<ValidationTable>,
}

impl InstrumentView {
    /// The model of an estimator.
    pub fn model(&self, estimator: Estimator) -> Option<&Calibration> {
        let found = self.models.iter().find(|m| m.estimator == estimator);
        found.map(|m| &m.calibration)
    }
}

/// Makes the models asked for, and judges all of them by the instrument's points.
/// `options` are those of the calibration after all choices from the data.
pub(super) fn reference(
    recordings: &Recordings,
    tracker: &TrackerRecordings,
    asked: &super::EvaluateOptions,
    options: &Options,
    calibration: &Calibration,
    notes: &mut Vec<String>,
    progress: &mut dyn FnMut(EvaluationStep),
) -> Result<InstrumentView, EvaluateError> {
    let frames = tracker.measured_frames(&recordings.experiment)?;
    let mut models = Vec::new();
    for &estimator in &asked.models {
        if matches!(estimator, Estimator::Nominal | Estimator::Sphere)
            || (estimator == Estimator::KnownLaws && asked.known_laws.is_none())
        {
            continue;
        }
        progress(EvaluationStep::Comparing { estimator });
        match model(recordings, tracker, &frames, asked, options, estimator) {
            Ok(calibration) => models.push(ReferenceModel { estimator, calibration }),
            // The paper's method asks for contacts with several spheres.
            Err(IdentifyError::Method { .. }) if estimator.optional() => {}
            Err(error) if estimator.optional() => notes.push(format!("{estimator} gave no model: {error}")),
            Err(source) => return Err(EvaluateError::Model { estimator, source }),
        }
    }
    let table = if tracker.validation.is_empty() {
        None
    } else {
        Some(table(recordings, tracker, &frames, calibration, &models)?)
    };
    Ok(InstrumentView { frames, models, table })
}

/// Identifies by one of the other estimators.
fn model(
    recordings: &Recordings,
    tracker: &TrackerRecordings,
    frames: &MeasuredFrames,
    asked: &super::EvaluateOptions,
    options: &Options,
    estimator: Estimator,
) -> Result<Calibration, IdentifyError> {
    let with_tool = |experiment: &Experiment| Experiment {
        tool: Tool {
            tcp_m: frames.tool_m,
            ..experiment.tool
        },
        ..experiment.clone()
    };
    let contacts = &recordings.experiment;
    let by = |method: Method| Options {
        method,
        ..options.clone()
    };
    let absolute = |method: Method| Options {
        base: Some(frames.base),
        ..by(method)
    };
    match estimator {
        Estimator::PaperNelderMead => identify(&with_tool(contacts), &by(Method::NelderMead)),
        Estimator::GaussNewton => {
            let contacts = with_tool(contacts);
            let per_sphere = paper::PaperProcedure::default().poses_per_sphere;
            let options = Options {
                subset: Some(paper::subset(&contacts, per_sphere, options.seed)),
                ..by(Method::GaussNewton)
            };
            identify(&contacts, &options)
        }
        Estimator::Geometry => identify(contacts, &by(Method::Geometry)),
        Estimator::TwoHarmonics => {
            let mut options = Options {
                harmonics: 2,
                ..by(Method::Full)
            };
            for name in ["bending", "tilt"] {
                let fixed = Override {
                    free: Some(false),
                    ..Override::default()
                };
                options.parameters.0.insert(name.to_owned(), fixed);
            }
            identify(contacts, &options)
        }
        // The paper holds base and tool at what the arcs gave.
        Estimator::LaserNelderMead => {
            identify(&with_tool(&tracker.experiment(contacts)), &absolute(Method::NelderMead))
        }
        Estimator::Laser => identify(
            &with_tool(&tracker.experiment(contacts)),
            &absolute(Method::GaussNewton),
        ),
        Estimator::LaserFull => identify(&tracker.experiment(contacts), &absolute(Method::Full)),
        Estimator::KnownLaws => identify(contacts, asked.known_laws.as_ref().unwrap_or(options)),
        Estimator::Nominal | Estimator::Sphere => identify(contacts, options),
    }
}

/// Table 5 of the paper. Nominal and paper-like models have base and tool from the
/// arcs, as in the paper; the full models have their own tool.
fn table(
    recordings: &Recordings,
    tracker: &TrackerRecordings,
    frames: &MeasuredFrames,
    calibration: &Calibration,
    models: &[ReferenceModel],
) -> Result<ValidationTable, EvaluateError> {
    let experiment = &recordings.experiment;
    let tool = Tool {
        tcp_m: frames.tool_m,
        ..experiment.tool
    };
    let chain = Chain::unchecked(&experiment.robot, &tool);
    let mut predictions = vec![prediction(tracker, Estimator::Nominal, None, |q| {
        chain.tcp_of(&chain.frames(q))
    })];
    // A model from contacts stands where the instrument saw the plate.
    let own = |estimator: Estimator, calibration: &Calibration| {
        if estimator.by_tracker() {
            return Some(calibration.base);
        }
        tracker.plate.map(|plate| Pose {
            rotation: plate.rotation * calibration.base.rotation,
            position: plate.point(&calibration.base.position),
        })
    };
    let all =
        std::iter::once((Estimator::Sphere, calibration)).chain(models.iter().map(|m| (m.estimator, &m.calibration)));
    for (estimator, calibration) in all {
        predictions.push(prediction(tracker, estimator, own(estimator, calibration), |q| {
            calibration.tcp_m(q, None)
        }));
    }
    let measured: Vec<[f64; 3]> = tracker.validation.iter().map(|m| m.point_m).collect();
    Ok(validate(&measured, &frames.base, &predictions)?)
}

fn prediction(
    tracker: &TrackerRecordings,
    estimator: Estimator,
    own_base: Option<Pose>,
    tcp: impl Fn(&[f64]) -> Vector3<f64>,
) -> Prediction {
    Prediction {
        name: estimator.name().to_owned(),
        points_m: tracker.validation.iter().map(|m| tcp(&m.q).into()).collect(),
        own_base,
    }
}
