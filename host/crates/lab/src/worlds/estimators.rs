//! The estimators on one trial, judged by its validation measurements.

use spherecal_shared::robot::iiwa7;

use super::record::{Trial, WorldError};
use spherecal_identify::arcs::Measured;
use spherecal_identify::validate::ValidationTable;
use spherecal_identify::{
    Estimator, EvaluateOptions, Method, Model, Noise, Options, Override, Recordings, Target, Tracker, evaluate,
};
use spherecal_sim::worlds::{Recipe, World};

/// Options of the oracle: the model, priors and noise that the world was drawn
/// from. `None` for W4, which no such model describes.
pub fn bound_options(world: World, recipe: &Recipe, geometry_scale: f64) -> Option<Options> {
    if matches!(world, World::W4 | World::W4Bad) {
        return None;
    }
    let mut options = Options {
        method: Method::Full,
        model: Model::Full,
        harmonics: if recipe.higher_harmonics_rad > 0.0 { 8 } else { 2 },
        student_t: 0.0,
        noise: Noise {
            joint_rad: recipe.white_rad.hypot(recipe.encoder_rad),
            seating_m: recipe.seating_m,
            point_m: recipe.tracker_m,
            estimate: false,
            inflation: 1.0,
        },
        ..Options::default()
    };
    let parameters = &mut options.parameters.0;
    let mut prior = |name: String, nominal: Option<f64>, sigma: f64| {
        let set = Override {
            nominal,
            prior_sigma: Some(sigma),
            free: None,
        };
        parameters.insert(name, set);
    };
    prior("a".into(), None, recipe.length_m * geometry_scale);
    prior("d".into(), None, recipe.length_m * geometry_scale);
    prior("alpha".into(), None, recipe.alpha_rad * geometry_scale);
    prior("theta".into(), None, recipe.theta_rad * geometry_scale);
    prior(
        "tool".into(),
        None,
        recipe.tool_m.hypot(recipe.length_m * geometry_scale),
    );
    // U(0.7, 1.3) about its mean.
    let spread = 0.3 / 3f64.sqrt();
    prior("compliance".into(), Some(recipe.compliance), recipe.compliance * spread);
    if recipe.bending > 0.0 {
        prior("bending".into(), None, recipe.bending);
        prior("tilt".into(), None, recipe.tilt);
    }
    for joint in 1..=iiwa7().dof() {
        for order in 1..=options.harmonics {
            let sigma = match recipe.harmonics_rad.get(order - 1) {
                Some(h) => h / 2f64.sqrt(),
                None => recipe.higher_harmonics_rad / 6f64.sqrt(),
            };
            for part in ["cos", "sin"] {
                prior(format!("harmonic{joint}_{part}{order}"), None, sigma);
            }
        }
    }
    if recipe.bending == 0.0 {
        for name in ["bending", "tilt"] {
            let fixed = Override {
                free: Some(false),
                ..Override::default()
            };
            options.parameters.0.insert(name.to_owned(), fixed);
        }
    }
    Some(options)
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
            tracker: Some(Tracker {
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
    let bound = bound_options(trial.world, recipe, trial.truth.geometry_scale);
    let has_bound = bound.is_some();
    let options = EvaluateOptions {
        identify: Options {
            seed: trial.seed,
            ..Options::default()
        },
        align: false,
        choose_model: false,
        cross_validate: false,
        models: estimators.to_vec(),
        bound,
    };
    let found = evaluate(&Recordings::from(trial), &options, &mut |_| {})
        .map_err(|e| failed(Estimator::Sphere, e.to_string()))?;
    let table = found.table().cloned();
    let table = table.ok_or_else(|| failed(Estimator::Sphere, "nothing judged it".to_owned()))?;
    for &estimator in estimators {
        let meant = estimator != Estimator::Bound || has_bound;
        if meant && table.model(estimator.name()).is_none() {
            return Err(failed(estimator, found.notes.join("; ")));
        }
    }
    Ok(table)
}
