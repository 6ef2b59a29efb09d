//! The estimators on one trial, judged by its validation measurements.

use spherecal_shared::robot::iiwa7;

use super::record::{Trial, WorldError};
use crate::Estimator;
use crate::estimators::comparison;
use crate::known_laws;
use spherecal_identify::arcs::Measured;
use spherecal_identify::validate::ValidationTable;
use spherecal_identify::{EvaluateOptions, Options, Recordings, Target, TrackerRecordings, evaluate};
use spherecal_sim::worlds::World;

/// Options of the estimator that knows the laws: the model, priors and noise that the trial's
/// robot was drawn from. `None` for W4, which no such model describes.
fn known_laws_options(trial: &Trial) -> Option<Options> {
    if matches!(trial.world, World::W4 | World::W4Bad) {
        return None;
    }
    let mut plant = trial.plant.clone();
    // The drawn geometry was rescaled, so its law was.
    plant.geometry.length_sigma_m *= trial.truth.geometry_scale;
    plant.geometry.alpha_sigma_rad *= trial.truth.geometry_scale;
    plant.geometry.theta_sigma_rad *= trial.truth.geometry_scale;
    Some(known_laws::known_laws_options(&plant, iiwa7().dof()))
}

impl From<&Trial> for Recordings {
    fn from(trial: &Trial) -> Self {
        let calibration = trial.laser.observations.iter().filter_map(|o| match o.target {
            Target::Point(point_m) => Some(Measured {
                q: o.q.clone(),
                point_m,
            }),
            _ => None,
        });
        Self {
            tracker: Some(TrackerRecordings {
                calibration: calibration.collect(),
                base_arcs: trial.base_arcs.clone(),
                tool_arcs: trial.tool_arcs.clone(),
                frames: Some(trial.frames.clone()),
                plate: Some(trial.plate),
                validation: trial.validation.clone(),
            }),
            ..Self::new(trial.spheres.clone())
        }
    }
}

/// Runs the estimators on a trial and judges them on its validation
/// measurements. Those without a meaning in the trial's world are left out.
///
/// # Errors
/// An estimator that fails on this data.
pub fn judge(trial: &Trial, estimators: &[Estimator]) -> Result<ValidationTable, WorldError> {
    let failed = |estimator: Estimator, reason: String| WorldError::Estimator {
        world: trial.world,
        seed: trial.seed,
        estimator: estimator.name(),
        reason,
    };
    let known_laws = known_laws_options(trial);
    let options = EvaluateOptions {
        identify: Options {
            seed: trial.seed,
            ..Options::default()
        },
        align: false,
        cross_validate: false,
        diagnose: false,
        work: None,
        models: estimators
            .iter()
            .filter_map(|e| comparison(*e, known_laws.as_ref()))
            .collect(),
        accuracy_mm: None,
    };
    let found = evaluate(&Recordings::from(trial), &options, &mut |_| {})
        .map_err(|e| failed(Estimator::Sphere, e.to_string()))?;
    let table = found.table().cloned();
    let table = table.ok_or_else(|| failed(Estimator::Sphere, "nothing judged it".to_owned()))?;
    for &estimator in estimators {
        let meant = estimator != Estimator::KnownLaws || known_laws.is_some();
        if meant && table.model(estimator.name()).is_none() {
            return Err(failed(estimator, found.notes.join("; ")));
        }
    }
    Ok(table)
}
