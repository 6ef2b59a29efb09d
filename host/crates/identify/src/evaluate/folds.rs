//! Judgement by samples: of a fit by rows that it has not seen, and of folds of
//! the rows by fits of the others.

use std::collections::HashSet;

use nalgebra::Vector3;
use rayon::prelude::*;

use super::fit::{ChosenFit, fit};
use super::groups::{Derived, groups, without_only_contacts};
use super::thin::thinned;
use super::{EvaluateError, EvaluateOptions, geometry_of};
use crate::flange::Flange;
use crate::hierarchy::constants::POSTURES;
use crate::judge::{Fold, HeldOut, Judged, Predictor, judge};
use crate::judge_targets::{BodyOrientation, ToolPredictor};
use crate::recordings::Judge;
use crate::{GeometryOnly, Pose, Recordings, Reference, Target};

/// Folds of the cross-validation that stands in where no validation was given.
pub(super) const FOLDS: usize = 5;
/// Rows that each fit of a cross-validation uses, spread evenly over those that it
/// may see. The figure of the result is then that of a fit of fewer rows.
pub(super) const FOLD_ROWS: usize = 20_000;
/// Most values of a hold-out column: each takes a fit.
const MOST_HELD_OUT: usize = 200;

/// The models that are judged: nominal geometry, calibrated, and the geometry alone that files hold.
fn predictors<'a>(
    flanges: (&'a Flange, &'a Flange),
    fit: &'a ChosenFit,
    geometry: &'a GeometryOnly,
) -> Vec<Predictor<'a>> {
    let frames: Vec<(Reference, Pose)> = fit.calibration.frames.iter().map(|f| (f.reference, f.base)).collect();
    let calibration = &fit.calibration;
    let (given, tcp) = (fit.nominal.tcp_m, geometry.tool.tcp());
    let (before, after) = (flanges.0, flanges.1);
    let in_base = move |q: &[f64], point: &Vector3<f64>| geometry.base.point(&after.at(q).point(point));
    let targets = calibration.targets.len().saturating_sub(1);
    vec![
        Predictor {
            name: "nominal",
            tcp_m: Box::new(move |q, _| before.at(q).point(&given)),
            frames: fit.nominal.frames.clone(),
            tool: ToolPredictor {
                targets: fit.nominal.targets_m.len(),
                target_m: Some(Box::new(move |number, q, _| {
                    let place = fit.nominal.targets_m.get(number - 1).copied();
                    before.at(q).point(&place.unwrap_or_default())
                })),
                body: fit
                    .nominal
                    .body
                    .map(|body| -> BodyOrientation<'a> { Box::new(move |q, _| before.at(q).rotation * body) }),
            },
        },
        Predictor {
            name: "calibrated",
            tcp_m: Box::new(move |q, tau| calibration.tcp_m(q, tau)),
            frames: frames.clone(),
            tool: ToolPredictor {
                targets,
                target_m: Some(Box::new(move |number, q, tau| calibration.target_m(number + 1, q, tau))),
                body: calibration
                    .orientation
                    .map(|_| -> BodyOrientation<'a> { Box::new(move |q, tau| calibration.body_rotation(q, tau)) }),
            },
        },
        Predictor {
            name: "calibrated_table_only",
            tcp_m: Box::new(move |q, _| in_base(q, &tcp)),
            frames,
            tool: ToolPredictor {
                targets,
                target_m: Some(Box::new(move |number, q, _| {
                    let place = calibration.targets.get(number).map(|t| t.place_m);
                    in_base(q, &Vector3::from(place.unwrap_or_default()))
                })),
                body: calibration.orientation.map(|_| -> BodyOrientation<'a> {
                    Box::new(move |q, _| geometry.base.rotation * after.at(q).rotation * calibration.body_in_flange())
                }),
            },
        },
    ]
}

/// Judges rows by a fit.
pub(super) fn judged(
    recordings: &Recordings,
    (fit, geometry): (&ChosenFit, &GeometryOnly),
    judges: &[Judge<'_>],
    by: &str,
) -> Judged {
    let (before, after) = (Flange::new(&recordings.experiment.robot), Flange::new(&geometry.robot));
    judge(
        &predictors((&before, &after), fit, geometry),
        judges,
        &recordings.experiment.spheres,
        recordings.closed_loop(),
        by,
    )
}

/// Fits without some rows of a whole fit and judges those, fold by fold.
fn folds(
    recordings: &Recordings,
    asked: &EvaluateOptions,
    whole: &ChosenFit,
    folds: &[(String, Vec<usize>)],
) -> Result<Vec<Fold>, EvaluateError> {
    let experiment = whole.loaded(&recordings.experiment);
    folds
        .par_iter()
        .map(|(value, out)| {
            let held: HashSet<usize> = out.iter().copied().collect();
            let rest: Vec<usize> = whole.used.iter().copied().filter(|i| !held.contains(i)).collect();
            let rest = thinned(&experiment, &rest, FOLD_ROWS);
            let ends = &whole.calibration.inner.ends;
            let fit = fit(&experiment, asked, &whole.options, &rest, None, ends)?;
            // Where the file of all rows would be the best.
            let of_rows = || {
                let every = rest.len().div_ceil(POSTURES).max(1);
                let row = |i: &usize| recordings.experiment.observations[*i].q.clone();
                rest.iter().step_by(every).map(row).collect()
            };
            let postures: Vec<Vec<f64>> = asked.work.clone().unwrap_or_else(of_rows);
            let geometry = geometry_of(recordings, &fit, &postures, None)?;
            let judges: Vec<Judge<'_>> = out.iter().map(|&i| recordings.judge(i, i)).collect();
            Ok(Fold {
                value: value.clone(),
                judged: judged(recordings, (&fit, &geometry), &judges, value),
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
        model.further.sort_by_key(|f| f.error.index);
        model.turned.sort_by_key(|t| t.index);
    }
    all
}

/// The cross-validation of the rows that a fit used: by place of the plate where
/// there are three or more, else by each fifth of the rows.
pub(super) fn cross_validate(
    recordings: &Recordings,
    asked: &EvaluateOptions,
    whole: &ChosenFit,
) -> Result<Judged, EvaluateError> {
    let used = &whole.used;
    let by_place = recordings.closed_loop() && recordings.places.len() >= 3;
    let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
    if by_place {
        groups.extend(recordings.places.names().map(|name| (name.to_owned(), Vec::new())));
        for &i in used {
            let place = recordings.samples.get(i).map_or(0, |s| s.place);
            if let Some(group) = groups.get_mut(place as usize) {
                group.1.push(i);
            }
        }
    } else {
        let fold = |k: usize| used.iter().copied().skip(k).step_by(FOLDS).collect();
        groups.extend((0..FOLDS).map(|k| (format!("fold {}", k + 1), fold(k))));
    }
    groups.retain(|g| !g.1.is_empty());
    let mut words = if by_place {
        "cross-validation: each place predicted by a fit of the others".to_owned()
    } else {
        "cross-validation: each fifth of the rows predicted by a fit of the others".to_owned()
    };
    if used.len() > FOLD_ROWS {
        words += &format!(", of which it used {FOLD_ROWS} at most");
    }
    let folds = folds(recordings, asked, whole, &groups)?;
    Ok(pool(folds.into_iter().map(|f| f.judged), &words))
}

/// Holds each value of a column out in turn.
pub(super) fn hold_out(
    recordings: &Recordings,
    asked: &EvaluateOptions,
    whole: &ChosenFit,
    column: &str,
) -> Result<HeldOut, EvaluateError> {
    let used = &whole.used;
    let mut groups = groups(recordings, used);
    let mut words = format!("each {column} predicted by a fit of the others");
    if let [(value, _)] = &groups[..]
        && value.is_empty()
        && let Some(derived) = Derived::of(column)
    {
        groups = derived.groups(recordings, used);
        if derived == Derived::Coupling {
            let only = without_only_contacts(recordings, used, &mut groups);
            if groups.len() < 2 {
                return Err(EvaluateError::Holdout {
                    column: column.to_owned(),
                    what:
                        "fewer than two couplings can be left out: each is the only one on its sphere, so that without \
                           it the plate is free to turn"
                            .to_owned(),
                    remedy: "hold out by place or by region; to judge couplings, touch at least one sphere three times"
                        .to_owned(),
                });
            }
            if !only.is_empty() {
                words += &format!(
                    "; not judged, because theirs are the only contacts with a sphere: {}",
                    only.join(", ")
                );
            }
        }
    }
    let refuse = |what: String, remedy: String| EvaluateError::Holdout {
        column: column.to_owned(),
        what,
        remedy,
    };
    if groups.len() < 2 {
        return Err(refuse(
            "the column has one value only".to_owned(),
            "name a column with at least two values, such as place, or hold out by region or coupling".to_owned(),
        ));
    }
    if groups.len() > MOST_HELD_OUT {
        return Err(refuse(
            format!("the column has {} values, and each takes a fit", groups.len()),
            format!("name a column with at most {MOST_HELD_OUT} values"),
        ));
    }
    if let Some(what) = free_frame(recordings, used, &groups) {
        return Err(refuse(
            what,
            "hold out by place, coupling or region, or by a column of your own; by sphere only with at least four spheres on \
             the plate"
                .to_owned(),
        ));
    }
    let folds = folds(recordings, asked, whole, &groups)?;
    let pooled = pool(folds.iter().map(|f| f.judged.clone()), &words);
    Ok(HeldOut {
        column: column.to_owned(),
        folds,
        pooled,
    })
}

/// Why a hold-out would judge the frame and not the robot: a sphere is left out, and
/// one or two others of its place leave the plate's frame free to turn.
fn free_frame(recordings: &Recordings, used: &[usize], groups: &[(String, Vec<usize>)]) -> Option<String> {
    let touched = |i: usize| match recordings.experiment.observations.get(i).map(|o| &o.target) {
        Some(&Target::Sphere { sphere, place }) => Some((place, sphere)),
        _ => None,
    };
    for (value, out) in groups {
        let held: HashSet<usize> = out.iter().copied().collect();
        let rest: HashSet<(u32, u32)> = used
            .iter()
            .filter(|i| !held.contains(i))
            .filter_map(|&i| touched(i))
            .collect();
        for (place, sphere) in out.iter().filter_map(|&i| touched(i)) {
            let others = rest.iter().filter(|(p, _)| *p == place).count();
            if !rest.contains(&(place, sphere)) && (1..3).contains(&others) {
                return Some(format!(
                    "without \"{value}\" only {others} of the spheres near sphere {sphere} are left: they leave the \
                     plate free to turn, so the figure would be that of the plate's turn and not of the robot"
                ));
            }
        }
    }
    None
}
