//! The table that an independent instrument's measurements make of a calibration and of other models.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::Tool;

use super::comparison::{Compared, Comparison};
use super::error::EvaluateError;
use super::estimator::Estimator;
use super::options::EvaluationStep;
use crate::arcs::MeasuredFrames;
use crate::recordings::{Recordings, TrackerRecordings};
use crate::validate::{Prediction, ValidationTable, validate};
use crate::{Calibration, IdentifyError, Options, Pose};

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
    asked: &[Comparison],
    options: &Options,
    calibration: &Calibration,
    notes: &mut Vec<String>,
    progress: &mut dyn FnMut(EvaluationStep),
) -> Result<InstrumentView, EvaluateError> {
    let frames = tracker.measured_frames(&recordings.experiment)?;
    let compared = Compared {
        recordings,
        tracker,
        frames: &frames,
        options,
    };
    let mut models = Vec::new();
    for comparison in asked {
        let estimator = comparison.estimator;
        progress(EvaluationStep::Comparing { estimator });
        match (comparison.fit)(&compared) {
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
