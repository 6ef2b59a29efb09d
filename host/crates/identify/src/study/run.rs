//! The study itself: align, identify, judge by what the fit has not seen.

use std::borrow::Cow;
use std::collections::{HashMap, HashSet};
use std::time::Instant;

use nalgebra::Vector3;
use rayon::prelude::*;
use spherecal_shared::robot::Robot;

use super::align::reference_of;
use super::align::{Alignment, Flange, align};
use super::judge::{Errors, Judge, Judged, Predictor, judge};
use super::load::{Loaded, Request, load};
use super::verdict::{Verdict, verdict};
use super::{StudyError, plate, tune};
use crate::{Calibration, Experiment, Options, Override, Pose, Reference, Set, Target, choose_model, identify};
use spherecal_model::input::{InputError, Progress};

/// Folds of the cross-validation that stands in where no validation was given.
const FOLDS: usize = 5;
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
/// Rows that each fit of a cross-validation uses, spread evenly over those that it
/// may see. The figure of the result is then that of a fit of fewer rows.
const FOLD_ROWS: usize = 50_000;
/// Most rows that are left out and have a note each.
const NOTED: usize = 20;
/// Most values of a hold-out column: each takes a fit.
const MOST_HELD_OUT: usize = 200;
/// Median distance (m) after alignment beyond which these are not data of this robot.
const HOPELESS_M: f64 = 0.025;

/// One value of the hold-out column.
#[derive(Clone, Debug)]
pub struct Fold {
    /// The value.
    pub value: String,
    /// The samples that have it, judged by a fit without them.
    pub judged: Judged,
}

/// All values of a column, held out one after the other.
#[derive(Clone, Debug)]
pub struct Holdout {
    /// The column.
    pub column: String,
    /// By value.
    pub folds: Vec<Fold>,
    /// All of them together.
    pub pooled: Judged,
}

/// How far a study has come.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Step {
    /// A table is being read.
    Reading(Progress),
    /// The frames are aligned, priors and model chosen and the model fitted.
    Fitting {
        /// Rows of the calibration set.
        rows: usize,
    },
    /// The result is judged.
    Judging {
        /// Fits that are judged.
        fits: usize,
        /// Rows that judge them.
        rows: usize,
    },
}

/// A calibration with everything that is known about it.
#[derive(Clone, Debug)]
pub struct Study {
    /// What it was made from.
    pub loaded: Loaded,
    /// Options that were used.
    pub options: Options,
    /// Samples that the fit used: indices into [`Loaded::samples`], in the order
    /// of the calibration's observations.
    pub used: Vec<usize>,
    /// Samples left out as gross errors, with their distance in mm.
    pub rejected: Vec<(usize, f64)>,
    /// Frames and tool with the nominal geometry.
    pub alignment: Alignment,
    /// The tool (m, last frame of the table) as the user gave it, where the data
    /// said another and it was taken from them.
    pub given_tcp_m: Option<Vector3<f64>>,
    /// The result.
    pub calibration: Calibration,
    /// The judgement.
    pub validation: Judged,
    /// Whether the validation is a cross-validation of the calibration data.
    pub cross_validated: bool,
    /// The hold-out that was asked for.
    pub holdout: Option<Holdout>,
    /// Predicted standard deviation of the TCP (root of the summed variances)
    /// over the judging samples: mean and largest, in mm.
    pub predicted_mm: (f64, f64),
    /// Whether the result may be used, and why.
    pub verdict: Verdict,
    /// What the user should know.
    pub notes: Vec<String>,
    /// Time taken, in s.
    pub wall_s: f64,
}

/// A fit of some of the samples.
struct Fit {
    /// Options with all that was chosen from the data.
    options: Options,
    /// What was chosen from the data, in words.
    chosen: Vec<String>,
    used: Vec<usize>,
    rejected: Vec<(usize, f64)>,
    alignment: Alignment,
    found_tool: bool,
    calibration: Calibration,
}

/// The experiment with only the named rows; the experiment itself where they are all.
fn only<'a>(experiment: &'a Experiment, keep: &[usize]) -> Cow<'a, Experiment> {
    if keep.len() == experiment.observations.len() && keep.iter().enumerate().all(|(k, i)| k == *i) {
        return Cow::Borrowed(experiment);
    }
    let observations = keep.iter().filter_map(|&i| experiment.observations.get(i).cloned());
    Cow::Owned(Experiment {
        robot: experiment.robot.clone(),
        tool: experiment.tool,
        spheres: experiment.spheres.clone(),
        observations: observations.collect(),
    })
}

/// At most `most` of the rows, spread evenly over each sphere and place.
fn thinned(experiment: &Experiment, rows: &[usize], most: usize) -> Vec<usize> {
    let step = rows.len().div_ceil(most).max(1);
    let mut seen: HashMap<(Reference, Option<u32>), usize> = HashMap::new();
    let mut keep = rows.to_vec();
    keep.retain(|&i| {
        let Some(target) = experiment.observations.get(i).map(|o| &o.target) else {
            return false;
        };
        let sphere = match target {
            Target::Sphere { sphere, .. } => Some(*sphere),
            _ => None,
        };
        let count = seen.entry((reference_of(target), sphere)).or_default();
        *count += 1;
        (*count - 1) % step == 0
    });
    keep
}

/// Aligns, leaves gross errors out, chooses priors where asked, identifies.
fn fit(experiment: &Experiment, options: &Options, train: &[usize], tune: bool) -> Result<Fit, StudyError> {
    let mut used = train.to_vec();
    let mut own = only(experiment, &used);
    own.check()?;
    let alignment = align(&own, &own.robot, true);
    let gross = alignment.gross();
    let mut rejected = Vec::new();
    // More than a third of gross errors is no longer a matter of single rows.
    if !gross.is_empty() && 3 * gross.len() <= used.len() {
        rejected.extend(gross.iter().filter_map(|&(k, m)| Some((*used.get(k)?, m * 1e3))));
        let out: HashSet<usize> = rejected.iter().map(|r| r.0).collect();
        used.retain(|i| !out.contains(i));
        own = only(experiment, &used);
    }
    let mut options = options.clone();
    let far = (alignment.tcp_m - own.tool.tcp()).norm() > TOOL_FAR_M;
    let found_tool = far && align(&own, &own.robot, false).median_m > 1.3 * alignment.median_m;
    if found_tool {
        own.to_mut().tool.tcp_m = alignment.tcp_m.into();
        options.parameters.0.entry("tool".to_owned()).or_insert(Override {
            prior_sigma: Some(FOUND_TOOL_SIGMA_M),
            ..Override::default()
        });
    }
    options.parameters.0.entry("base".to_owned()).or_insert(Override {
        prior_sigma: Some(BASE_SIGMA),
        ..Override::default()
    });
    let mut chosen = Vec::new();
    if tune {
        let all: Vec<usize> = (0..own.observations.len()).collect();
        let some = only(&own, &thinned(&own, &all, CHOOSING)).into_owned();
        let wider;
        (options, wider) = tune::choose(&some, &options);
        chosen.extend(wider);
        let refusal;
        (options.model, refusal) = choose_model(&some, &options)?;
        if let Some(refusal) = refusal {
            chosen.push(refusal.to_string());
        }
    }
    let calibration = identify(&own, &options)?;
    Ok(Fit {
        options,
        chosen,
        used,
        rejected,
        alignment,
        found_tool,
        calibration,
    })
}

/// The models that are judged: nominal geometry, calibrated, and the calibrated
/// table alone, as a URDF holds it.
fn predictors<'a>(nominal: &'a Robot, fit: &'a Fit) -> Vec<Predictor<'a>> {
    let frames: Vec<(Reference, Pose)> = fit.calibration.frames.iter().map(|f| (f.reference, f.base)).collect();
    let calibration = &fit.calibration;
    let (given, tcp) = (fit.alignment.tcp_m, calibration.tool.tcp());
    let (before, after) = (Flange::new(nominal), Flange::new(&calibration.robot));
    vec![
        Predictor {
            name: "nominal",
            tcp_m: Box::new(move |q, _| before.at(q).point(&given)),
            frames: fit.alignment.frames.clone(),
        },
        Predictor {
            name: "calibrated",
            tcp_m: Box::new(move |q, tau| calibration.tcp_m(q, tau)),
            frames: frames.clone(),
        },
        Predictor {
            name: "calibrated_table_only",
            tcp_m: Box::new(move |q, _| after.at(q).point(&tcp)),
            frames,
        },
    ]
}

/// Judges rows by a fit.
fn judged(loaded: &Loaded, fit: &Fit, judges: &[Judge<'_>], by: &str) -> Judged {
    judge(
        &predictors(&loaded.experiment.robot, fit),
        judges,
        &loaded.experiment.spheres,
        loaded.closed_loop,
        by,
    )
}

/// Fits without some rows and judges those, fold by fold.
fn folds(
    loaded: &Loaded,
    options: &Options,
    train: &[usize],
    folds: &[(String, Vec<usize>)],
) -> Result<Vec<Fold>, StudyError> {
    folds
        .par_iter()
        .map(|(value, out)| {
            let held: HashSet<usize> = out.iter().copied().collect();
            let rest: Vec<usize> = train.iter().copied().filter(|i| !held.contains(i)).collect();
            let rest = thinned(&loaded.experiment, &rest, FOLD_ROWS);
            let fit = fit(&loaded.experiment, options, &rest, false)?;
            let judges: Vec<Judge<'_>> = out.iter().map(|&i| loaded.judge(i, i)).collect();
            Ok(Fold {
                value: value.clone(),
                judged: judged(loaded, &fit, &judges, value),
            })
        })
        .collect()
}

/// Several folds as one judgement.
fn pool(folds: impl IntoIterator<Item = Judged>, by: &str) -> Judged {
    let mut all = Judged {
        by: by.to_owned(),
        ..Judged::default()
    };
    for fold in folds {
        all.extend(fold);
    }
    for model in &mut all.models {
        model.samples.sort_by_key(|s| s.index);
    }
    all
}

/// The values of the hold-out column with their rows, in the order in which they appear.
fn groups(loaded: &Loaded, used: &[usize]) -> Vec<(String, Vec<usize>)> {
    let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
    let mut numbers: HashMap<u32, usize> = HashMap::new();
    for &i in used {
        let label = loaded.samples[i].label;
        let group = *numbers.entry(label).or_insert_with(|| {
            groups.push((loaded.labels.name(label).to_owned(), Vec::new()));
            groups.len() - 1
        });
        groups[group].1.push(i);
    }
    groups
}

/// Refuses data that no calibration of this robot can explain, with what is
/// probably wrong.
fn plausible(loaded: &Loaded, fit: &Fit) -> Result<(), StudyError> {
    if fit.alignment.median_m <= HOPELESS_M {
        return Ok(());
    }
    let median = format!("{:.1} mm", fit.alignment.median_m * 1e3);
    let contradiction = plate::contradiction(&loaded.experiment, 0.010);
    let (field, remedy) = match contradiction {
        Some(words) => ("the plate".to_owned(), words),
        None => (
            "median distance of the robot's TCP from its targets".to_owned(),
            "these are not data of this robot: check robot, joint order, signs, zero offsets and units".to_owned(),
        ),
    };
    Err(InputError::Field {
        file: loaded.file.clone(),
        field,
        value: median,
        remedy,
    }
    .into())
}

/// Runs a study from files.
///
/// # Errors
/// Input that cannot be used, or no convergence.
pub fn study(request: &Request, progress: &mut dyn FnMut(Step)) -> Result<Study, StudyError> {
    let start = Instant::now();
    let mut loaded = load(request, &mut |read| progress(Step::Reading(read)))?;
    let mut notes = std::mem::take(&mut loaded.notes);
    if loaded.closed_loop && !loaded.plate_given {
        plate::fall_back(&mut loaded.experiment, &mut notes)?;
    }
    let train: Vec<usize> = (0..loaded.samples.len())
        .filter(|&i| loaded.experiment.observations[i].set == Set::Calibrate)
        .collect();
    progress(Step::Fitting { rows: train.len() });
    let fit = fit(&loaded.experiment, &request.options, &train, true)?;
    plausible(&loaded, &fit)?;
    let options = fit.options.clone();
    notes.extend(fit.chosen.clone());
    let given_tcp_m = fit.found_tool.then(|| loaded.experiment.tool.tcp());
    if fit.found_tool {
        let found = loaded.model.tcp_in_flange(fit.alignment.tcp_m.into());
        notes.push(format!(
            "the tool is not where it was said: the data put the TCP at {} mm in the flange frame, {:.1} mm from the \
             nominal {} mm; it was taken from the data",
            millimetres(&found),
            (fit.alignment.tcp_m - loaded.experiment.tool.tcp()).norm() * 1e3,
            millimetres(&loaded.model.tool.tcp_m),
        ));
    }
    for &(i, mm) in fit.rejected.iter().take(NOTED) {
        notes.push(format!(
            "{} line {}: left out, {mm:.1} mm from where any calibration of this robot could bring it",
            loaded.file, loaded.samples[i].line
        ));
    }
    if let Some(more) = fit.rejected.len().checked_sub(NOTED).filter(|more| *more > 0) {
        notes.push(format!("{more} more rows were left out as far off"));
    }

    let aside = loaded.set_aside().count();
    let cross_validated = aside == 0;
    let (fits, rows) = if cross_validated {
        (FOLDS, fit.used.len())
    } else {
        (1, aside)
    };
    progress(Step::Judging { fits, rows });
    let validation =
        if cross_validated {
            let by_place = loaded.closed_loop && loaded.places.len() >= 3;
            let groups: Vec<(String, Vec<usize>)> = if by_place {
                let mut groups: Vec<_> = loaded
                    .places
                    .names()
                    .map(|name| (name.to_owned(), Vec::new()))
                    .collect();
                for &i in &fit.used {
                    groups[loaded.samples[i].place as usize].1.push(i);
                }
                groups
            } else {
                let fold = |k: usize| fit.used.iter().copied().skip(k).step_by(FOLDS).collect();
                (0..FOLDS).map(|k| (format!("fold {}", k + 1), fold(k))).collect()
            };
            let groups: Vec<_> = groups.into_iter().filter(|g| !g.1.is_empty()).collect();
            let mut words = if by_place {
                "cross-validation: each place predicted by a fit of the others".to_owned()
            } else {
                "cross-validation: each fifth of the rows predicted by a fit of the others".to_owned()
            };
            if fit.used.len() > FOLD_ROWS {
                words += &format!(", of which it used {FOLD_ROWS} at most");
            }
            let folds = folds(&loaded, &options, &fit.used, &groups)?;
            pool(folds.into_iter().map(|f| f.judged), &words)
        } else {
            let judges: Vec<Judge<'_>> = loaded.set_aside().collect();
            let words = format!("{} samples that the fit has not seen", judges.len());
            let mut own = judged(&loaded, &fit, &judges, &words);
            if let Some(off) = own.realign_if_elsewhere(&judges) {
                own.by += ", after a best rigid fit of their frame";
                notes.push(format!(
                "the validation points are not in the {} frame: they are {off:.0} mm off as a whole, and fit within a \
                 rigid motion, which was taken out for every model",
                if loaded.closed_loop { "plate's" } else { "calibration data's" }
            ));
            }
            own
        };
    let holdout = match &request.holdout {
        None => None,
        Some(column) => {
            let groups = groups(&loaded, &fit.used);
            if groups.len() < 2 {
                return Err(InputError::Columns {
                    file: request.data.display().to_string(),
                    what: format!("--holdout {column}: the column has one value only"),
                    remedy: "name a column with at least two values, such as place or sphere".to_owned(),
                }
                .into());
            }
            if groups.len() > MOST_HELD_OUT {
                return Err(InputError::Columns {
                    file: loaded.file.clone(),
                    what: format!(
                        "--holdout {column}: the column has {} values, and each takes a fit",
                        groups.len()
                    ),
                    remedy: format!("name a column with at most {MOST_HELD_OUT} values"),
                }
                .into());
            }
            let folds = folds(&loaded, &options, &fit.used, &groups)?;
            let pooled = pool(
                folds.iter().map(|f| f.judged.clone()),
                &format!("each {column} predicted by a fit of the others"),
            );
            Some(Holdout {
                column: column.clone(),
                folds,
                pooled,
            })
        }
    };
    let predicted_mm = predicted(&fit.calibration, &loaded, cross_validated);
    let Fit {
        used,
        rejected,
        alignment,
        calibration,
        ..
    } = fit;
    let mut study = Study {
        loaded,
        options,
        used,
        rejected,
        alignment,
        given_tcp_m,
        calibration,
        validation,
        cross_validated,
        holdout,
        predicted_mm,
        verdict: Verdict::default(),
        notes,
        wall_s: 0.0,
    };
    study.verdict = verdict(&study);
    study.wall_s = start.elapsed().as_secs_f64();
    Ok(study)
}

/// Predicted deviation of the TCP over the judging rows: mean and largest, in mm.
/// Closed loops may leave the plate's turn open (two spheres do): there it is that
/// of the robot's own frame.
fn predicted(calibration: &Calibration, loaded: &Loaded, cross_validated: bool) -> (f64, f64) {
    let judges: Vec<Judge<'_>> = loaded.judges(cross_validated).collect();
    let step = judges.len().div_ceil(200).max(1);
    let sigma: Vec<f64> = judges
        .iter()
        .step_by(step)
        .map(|j| sigma_mm(calibration, &j.observation.q, loaded.closed_loop))
        .collect();
    let e = Errors::of(&sigma);
    (e.mean_mm, e.max_mm)
}

fn sigma_mm(calibration: &Calibration, q: &[f64], closed_loop: bool) -> f64 {
    let covariance = if closed_loop {
        calibration.tcp_covariance_in_base(q)
    } else {
        calibration.tcp_covariance(q)
    };
    covariance.trace().max(0.0).sqrt() * 1e3
}

/// A point in m as mm, for people.
pub fn millimetres(p: &[f64; 3]) -> String {
    format!("({:.2}, {:.2}, {:.2})", p[0] * 1e3, p[1] * 1e3, p[2] * 1e3)
}

impl Study {
    /// Predicted standard deviation of the TCP at joint angles `q`, in mm: the root
    /// of the summed variances; in closed loops that of the robot's own frame.
    pub fn predicted_sigma_mm(&self, q: &[f64]) -> f64 {
        sigma_mm(&self.calibration, q, self.loaded.closed_loop)
    }

    /// The rows that judge the result, in the order of the indices of [`Self::validation`].
    pub fn judges(&self) -> impl Iterator<Item = Judge<'_>> {
        self.loaded.judges(self.cross_validated)
    }
}
