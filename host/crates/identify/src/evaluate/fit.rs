//! One fit of some of the rows, with all that is chosen from the data before it.

use std::borrow::Cow;
use std::collections::HashSet;

use super::align::{NominalFrames, align};
use super::thin::{only, thinned};
use super::{EvaluateError, EvaluateOptions, tune};
use crate::residual_map::ResidualMap;
use crate::{Calibration, Experiment, Options, Override, choose_model, identify};

/// A tool further than this (m) from what was said is taken from the data.
const TOOL_FAR_M: f64 = 0.005;
/// Prior (m, 1 sigma) of a tool that was taken from the data.
const FOUND_TOOL_SIGMA_M: f64 = 0.005;
/// Prior (m and rad, 1 sigma) of frames after alignment: wide for what is left to
/// find, finite for what the data leave open (two spheres leave the turn about
/// their line).
const BASE_SIGMA: f64 = 0.05;
/// Rows that the choice of priors and of the model looks at, spread evenly over
/// all; where there are more, the rest does not change the choice.
const CHOOSING: usize = 20_000;

/// A fit of some of the rows.
pub(super) struct ChosenFit {
    /// Options with all that was chosen from the data.
    pub(super) options: Options,
    /// What was chosen from the data, in words.
    pub(super) chosen: Vec<String>,
    /// Rows that the fit used.
    pub(super) used: Vec<usize>,
    /// Rows left out as gross errors, with their distance in mm.
    pub(super) rejected: Vec<(usize, f64)>,
    /// Frames and tool with the nominal geometry.
    pub(super) nominal: NominalFrames,
    /// Whether the tool was taken from the data.
    pub(super) found_tool: bool,
    /// The result.
    pub(super) calibration: Calibration,
    /// The map of its residuals, where one is kept.
    pub(super) map: Option<ResidualMap>,
}

impl ChosenFit {
    /// The experiment that the calibration was identified from, with some of its rows.
    pub(super) fn experiment<'a>(&self, experiment: &'a Experiment, rows: &[usize]) -> Cow<'a, Experiment> {
        let mut own = only(experiment, rows);
        if self.found_tool {
            own.to_mut().tool.tcp_m = self.nominal.tcp_m.into();
        }
        own
    }
}

/// Aligns, leaves gross errors out, chooses priors and model, and identifies, as
/// far as the options ask for it. `choose` is off in the folds of a
/// cross-validation, which take over the choices of the fit of all rows.
pub(super) fn fit(
    experiment: &Experiment,
    asked: &EvaluateOptions,
    options: &Options,
    train: &[usize],
    choose: bool,
) -> Result<ChosenFit, EvaluateError> {
    let mut used = train.to_vec();
    let mut own = only(experiment, &used);
    own.check().map_err(crate::IdentifyError::from)?;
    let nominal = align(&own, &own.robot, true);
    let mut options = options.clone();
    let mut rejected = Vec::new();
    let mut chosen = Vec::new();
    let mut found_tool = false;
    if asked.align {
        let gross = nominal.gross();
        // More than a third of gross errors is no longer a matter of single rows.
        if !gross.is_empty() && 3 * gross.len() <= used.len() {
            rejected.extend(gross.iter().filter_map(|&(k, m)| Some((*used.get(k)?, m * 1e3))));
            let out: HashSet<usize> = rejected.iter().map(|r| r.0).collect();
            used.retain(|i| !out.contains(i));
            own = only(experiment, &used);
        }
        let far = (nominal.tcp_m - own.tool.tcp()).norm() > TOOL_FAR_M;
        found_tool = far && align(&own, &own.robot, false).median_m > 1.3 * nominal.median_m;
        if found_tool {
            own.to_mut().tool.tcp_m = nominal.tcp_m.into();
            options.parameters.0.entry("tool".to_owned()).or_insert(Override {
                prior_sigma: Some(FOUND_TOOL_SIGMA_M),
                ..Override::default()
            });
        }
        options.parameters.0.entry("base".to_owned()).or_insert(Override {
            prior_sigma: Some(BASE_SIGMA),
            ..Override::default()
        });
    }
    if choose && (asked.choose_priors || asked.choose_model) {
        let all: Vec<usize> = (0..own.observations.len()).collect();
        let some = only(&own, &thinned(&own, &all, CHOOSING)).into_owned();
        if asked.choose_priors {
            let wider;
            (options, wider) = tune::choose(&some, &options);
            chosen.extend(wider);
        }
        if asked.choose_model {
            let refusal;
            (options.model, refusal) = choose_model(&some, &options)?;
            chosen.extend(refusal.map(|r| r.to_string()));
        }
    }
    let calibration = identify(&own, &options)?;
    Ok(ChosenFit {
        options,
        chosen,
        used,
        rejected,
        nominal,
        found_tool,
        calibration,
        map: None,
    })
}
