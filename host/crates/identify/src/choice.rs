//! Whether a model says more than the data hold: by cross-validation, before the
//! model is fitted to all of them.
//!
//! The evidence chooses priors within a model ([`effects`](super::effects)); what
//! the user allows to be modelled is checked here. A model overfits if it
//! predicts parts of the data that it has not seen worse than a poorer one does.

use rayon::prelude::*;
use serde::Serialize;

use super::error::IdentifyError;
use super::holdout::{Split, holdout, holdout_by_own_weights, possible_splits};
use super::options::{Method, Model, Options};
use spherecal_model::{Experiment, Set};

/// Regions of the joint space that are held out where the plate stood in few places.
const REGIONS: usize = 4;
/// Fewest observations that a comparison means something with.
const FEWEST: usize = 40;
/// Factor by which a poorer model must predict better: held-out regions differ
/// by chance, and the richer model is the better guess where they say little.
const MARGIN: f64 = 1.1;

/// A model that was refused.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RefusedModel {
    /// The model.
    pub model: Model,
    /// Its mean error on what was held out, in mm.
    pub held_out_mm: f64,
    /// The poorer model that predicts better.
    pub better: Model,
    /// That one's, in mm.
    pub better_mm: f64,
}

impl std::fmt::Display for RefusedModel {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        write!(
            f,
            "model `{}` overfits and was refused: poses that it had not seen are {:.3} mm off, and {:.3} mm off by `{}`",
            self.model, self.held_out_mm, self.better_mm, self.better
        )
    }
}

/// How rows are held out to compare models: whole places of the plate, or regions of the joint space.
fn split_of(experiment: &Experiment) -> Split {
    if possible_splits(experiment).contains(&Split::Place) {
        Split::Place
    } else {
        Split::Region(REGIONS)
    }
}

/// Mean error on rows that were held out, in mm; none where the data are too few to tell.
pub(crate) fn held_out_mm(experiment: &Experiment, options: &Options) -> Option<f64> {
    let rows = experiment.observations.iter().filter(|o| o.set == Set::Calibrate);
    if rows.count() < FEWEST {
        return None;
    }
    holdout(experiment, options, &split_of(experiment)).ok()?.figure_mm()
}

/// The richest model up to [`Options::model`] that does not overfit, and what was
/// refused on the way; nothing is refused where the data are too few to tell, or
/// where the method has no models.
///
/// # Errors
/// What [`identify`](super::identify) refuses.
pub fn choose_model(
    experiment: &Experiment,
    options: &Options,
) -> Result<(Model, Option<RefusedModel>), IdentifyError> {
    let rows = experiment.observations.iter().filter(|o| o.set == Set::Calibrate);
    if options.method != Method::Full || options.model == Model::Geometry || rows.count() < FEWEST {
        return Ok((options.model, None));
    }
    let split = split_of(experiment);
    let allowed: Vec<Model> = Model::ALL
        .into_iter()
        .rev()
        .skip_while(|m| *m != options.model)
        .collect();
    let figures = allowed
        .par_iter()
        .map(|&model| {
            let options = Options {
                model,
                ..options.clone()
            };
            Ok((model, holdout_by_own_weights(experiment, &options, &split)?.figure_mm()))
        })
        .collect::<Result<Vec<_>, IdentifyError>>();
    let figures = match figures {
        Ok(figures) => figures,
        // Without a part, the rest may say too little to be fitted at all.
        Err(
            IdentifyError::TooFewObservations { .. }
            | IdentifyError::TooFewOfTarget { .. }
            | IdentifyError::NoVariety
            | IdentifyError::Singular { .. },
        ) => {
            return Ok((options.model, None));
        }
        Err(error) => return Err(error),
    };
    let mut chosen = options.model;
    let mut refusal = None;
    let Some(asked) = figures.first().and_then(|f| f.1) else {
        return Ok((chosen, None));
    };
    let mut figure = asked;
    for &(model, found) in figures.iter().skip(1) {
        if let Some(found) = found
            && figure > MARGIN * found
        {
            (chosen, figure) = (model, found);
            refusal = Some(RefusedModel {
                model: options.model,
                held_out_mm: asked,
                better: model,
                better_mm: found,
            });
        }
    }
    Ok((chosen, refusal))
}
