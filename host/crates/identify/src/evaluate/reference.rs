//! The table that an independent instrument's measurements make of a calibration and of other models.

use nalgebra::Vector3;
use spherecal_model::chain::Chain;
use spherecal_shared::robot::Tool;

use super::comparison::{Compared, Comparison};
use super::error::EvaluateError;
use super::options::EvaluationStep;
use crate::arcs::MeasuredFrames;
use crate::recordings::{Recordings, TrackerRecordings};
use crate::validate::{Prediction, ValidationTable, validate};
use crate::{Calibration, Options, Pose};

/// A calibration to compare with.
#[derive(Clone, Debug)]
pub struct ReferenceModel {
    /// Name of what made it.
    pub name: &'static str,
    /// Whether it was made from the instrument's points.
    pub by_points: bool,
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
    /// The model of this name.
    pub fn model(&self, name: &str) -> Option<&Calibration> {
        let found = self.models.iter().find(|m| m.name == name);
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
    for Comparison { name, by_points, fit } in asked {
        progress(EvaluationStep::Comparing { name });
        match fit(&compared) {
            Ok(calibration) => models.push(ReferenceModel {
                name,
                by_points: *by_points,
                calibration,
            }),
            Err(error) => notes.push(format!("{name} gave no model: {error}")),
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
    let mut predictions = vec![prediction(tracker, "nominal", None, |q| chain.tcp_of(&chain.frames(q)))];
    // A model from contacts stands where the instrument saw the plate.
    let own = |by_points: bool, calibration: &Calibration| {
        if by_points {
            return Some(calibration.base);
        }
        tracker.plate.map(|plate| Pose {
            rotation: plate.rotation * calibration.base.rotation,
            position: plate.point(&calibration.base.position),
        })
    };
    let others = models.iter().map(|m| (m.name, m.by_points, &m.calibration));
    for (name, by_points, calibration) in std::iter::once(("sphere", false, calibration)).chain(others) {
        predictions.push(prediction(tracker, name, own(by_points, calibration), |q| {
            calibration.tcp_m(q, None)
        }));
    }
    let measured: Vec<[f64; 3]> = tracker.validation.iter().map(|m| m.point_m).collect();
    Ok(validate(&measured, &frames.base, &predictions)?)
}

fn prediction(
    tracker: &TrackerRecordings,
    name: &str,
    own_base: Option<Pose>,
    tcp: impl Fn(&[f64]) -> Vector3<f64>,
) -> Prediction {
    Prediction {
        name: name.to_owned(),
        points_m: tracker.validation.iter().map(|m| tcp(&m.q).into()).collect(),
        own_base,
    }
}
