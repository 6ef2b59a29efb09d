//! One fit of some of the rows, with all that is chosen from the data before it.

use std::borrow::Cow;
use std::collections::HashSet;

use spherecal_shared::robot::Tool;

use super::align::{NominalFrames, align};
use super::thin::only;
use super::{EvaluateError, EvaluateOptions};
use crate::causes::{self, Causes, Course};
use crate::hierarchy::constants::{CAUSE_ROUNDS, CAUSE_STAYS, ROWS_PER_SEAT};
use crate::hierarchy::{Before, Ends, Fit, Scale};
use crate::{
    Calibration, Experiment, IdentifyError, Method, Model, Options, Override, Target, finish, hierarchy, identify_from,
};

/// A tool further than this (m) from what was said is taken from the data.
const TOOL_FAR_M: f64 = 0.005;
/// Prior (m, 1 sigma) of a tool that was taken from the data.
const FOUND_TOOL_SIGMA_M: f64 = 0.005;
/// Prior (m and rad, 1 sigma) of frames after alignment: wide, because few rows of a place align it badly; finite for
/// what the data leave open (two spheres leave the turn about their line).
const BASE_SIGMA: f64 = 0.5;
/// A fit of some of the rows.
pub(super) struct ChosenFit {
    /// Options with all that was chosen from the data.
    pub(super) options: Options,
    /// Rows that the fit used.
    pub(super) used: Vec<usize>,
    /// Rows left out as gross errors, with their distance in mm.
    pub(super) rejected: Vec<(usize, f64)>,
    /// Frames and tool with the nominal geometry.
    pub(super) nominal: NominalFrames,
    /// Whether the tool was taken from the data.
    pub(super) found_tool: bool,
    /// The tool that the fit began with, and what hangs there.
    tool: Tool,
    /// The result.
    pub(super) calibration: Calibration,
    /// What its residuals name.
    pub(super) causes: Causes,
}

impl ChosenFit {
    /// The experiment that the calibration was identified from, with some of its rows.
    pub(super) fn experiment<'a>(&self, experiment: &'a Experiment, rows: &[usize]) -> Cow<'a, Experiment> {
        let mut own = only(experiment, rows);
        if self.tool != own.tool {
            own.to_mut().tool = self.tool;
        }
        own
    }

    /// All rows of an experiment with the load that was found.
    pub(super) fn loaded<'a>(&self, experiment: &'a Experiment) -> Cow<'a, Experiment> {
        let mut own = Cow::Borrowed(experiment);
        if self.tool.body != own.tool.body {
            own.to_mut().tool.body = self.tool.body;
        }
        own
    }
}

/// Aligns and identifies, as far as the options ask for it. With the `course` of all rows, what the residuals name is
/// taken into the fit.
pub(super) fn fit(
    experiment: &Experiment,
    asked: &EvaluateOptions,
    options: &Options,
    train: &[usize],
    course: Option<&Course>,
    ends: &Ends,
) -> Result<ChosenFit, EvaluateError> {
    let mut used = train.to_vec();
    let mut own = only(experiment, &used);
    own.check().map_err(IdentifyError::from)?;
    let nominal = align(&own, &own.robot, true);
    let mut options = options.clone();
    let mut rejected = Vec::new();
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
    if let Some(course) = course {
        seated(&mut own, &course.of_rows(&used));
    }
    let model = match options.method {
        Method::Full => Some(options.model),
        Method::Geometry => Some(Model::Geometry),
        Method::Lm | Method::GaussNewton => None,
    };
    let (calibration, causes) = if let (Some(model), Some(course)) = (model, course) {
        let (fit, causes) = explained(&mut own, &options, model, &course.of_rows(&used))?;
        (finish::finish(&own, &options, model, fit), causes)
    } else {
        let before = Before {
            ends: ends.clone(),
            ..Before::default()
        };
        (identify_from(&own, &options, &before)?, Causes::default())
    };
    Ok(ChosenFit {
        options,
        used,
        rejected,
        nominal,
        found_tool,
        tool: own.tool,
        calibration,
        causes,
    })
}

/// A fit with the causes that it names, and the tool with the load that hangs there.
///
/// The sizes of the arm's errors and the noise of the first fit hold what moved in the cell, too: a sphere that moved by 20 mm
/// makes an arm of 10 mm. So it is fitted again to the targets without that, until it stays as it is. A load that is another than
/// stated is a part of the arm that was measured, so it is hung there.
fn explained(
    experiment: &mut Cow<'_, Experiment>,
    options: &Options,
    model: Model,
    course: &Course,
) -> Result<(Fit, Causes), IdentifyError> {
    let stated = experiment.tool;
    let mut causes = Causes::default();
    let mut before = Before {
        scale: Scale::Doubted,
        ..Before::default()
    };
    let mut round = 0;
    loop {
        round += 1;
        let mut fit = hierarchy::fit(experiment, options, model, &before, |_| true)?;
        let mut known = std::mem::take(&mut causes);
        if before.displaced.is_empty() {
            known.forget_displacements();
        }
        causes = causes::explain(&mut fit, experiment, options, course, &known)?;
        let stays = causes.of_inputs().count() == known.of_inputs().count()
            && causes.of_inputs().zip(known.of_inputs()).all(|(now, before)| {
                now.alternative == before.alternative && (now.size - before.size).abs() < CAUSE_STAYS * now.sigma
            });
        if stays || (fit.displaced.is_empty() && causes.load_kg().is_none()) || round == CAUSE_ROUNDS {
            return Ok((fit, causes));
        }
        if let Some(load_kg) = causes.load_kg() {
            let tool = &mut experiment.to_mut().tool;
            *tool = stated;
            causes.hung(causes::hang(tool, load_kg));
        }
        (before.displaced, before.scale) = (fit.displaced, fit.scale);
    }
}

/// Gives every coupling a seat of its own, where there are rows enough to tell it.
fn seated(experiment: &mut Cow<'_, Experiment>, course: &Course) {
    let couplings = course.couplings();
    let contacts = experiment
        .observations
        .iter()
        .filter(|o| matches!(o.target, Target::Sphere { .. }));
    if couplings < 2 || contacts.count() < ROWS_PER_SEAT * couplings {
        return;
    }
    for (observation, coupling) in experiment.to_mut().observations.iter_mut().zip(&course.coupling) {
        observation.seat = u32::try_from(coupling + 1).ok();
    }
}
