//! Errors of rows that the fit has not seen, as tables and figures show them: the same for a table of poses and for a run
//! that no laser tracker judged.

use super::input::{ErrorSeries, ErrorTable, ModelRow, PredictedAccuracy, WorkspacePoint};
use spherecal_identify::Recordings;
use spherecal_identify::evaluate::{Evaluation, Judge, Judged, JudgedModel};

/// Most points in a figure: more would not be visible, and would make the page large.
pub(super) const DRAWN: usize = 5000;

/// Most points of predicted against actual errors: each takes a covariance of the whole model.
const PREDICTED: usize = 400;

/// At most [`DRAWN`] items, evenly spread.
pub(super) fn thinned<T>(items: &[T]) -> Vec<&T> {
    items.iter().step_by(items.len().div_ceil(DRAWN).max(1)).collect()
}

fn rows(judged: &Judged) -> Vec<ModelRow> {
    judged
        .models
        .iter()
        .map(|m| {
            let e = m.errors();
            ModelRow {
                name: m.name.clone(),
                mean_mm: e.mean_mm,
                std_mm: e.std_mm,
                min_mm: e.min_mm,
                max_mm: e.max_mm,
            }
        })
        .collect()
}

/// Errors of every model on the rows that judge, and on those that a hold-out left out.
pub fn tables(evaluation: &Evaluation) -> Vec<ErrorTable> {
    let mut tables: Vec<ErrorTable> = evaluation
        .judged
        .iter()
        .map(|judged| ErrorTable {
            title: format!(
                "Position errors on {} samples",
                judged.model("calibrated").map_or(0, |m| m.errors().n)
            ),
            caption: format!(
                "Judged by {}. \"URDF only\" is what a URDF can hold: links without compliance and encoder errors.",
                judged.by
            ),
            rows: rows(judged),
        })
        .collect();
    if let Some(holdout) = &evaluation.holdout {
        tables.push(ErrorTable {
            title: format!("Held out by {}", holdout.column),
            caption: holdout.pooled.by.clone(),
            rows: rows(&holdout.pooled),
        });
        tables.extend(holdout.folds.iter().map(|fold| ErrorTable {
            title: format!("{} {}", holdout.column, fold.value),
            caption: String::new(),
            rows: rows(&fold.judged),
        }));
    }
    tables
}

/// The errors of every model, for the histograms.
pub fn series(judged: &Judged) -> Vec<ErrorSeries> {
    judged
        .models
        .iter()
        .filter(|m| m.name != "calibrated_table_only")
        .map(|m| ErrorSeries {
            name: m.name.clone(),
            errors_mm: m.samples.iter().map(|s| s.distance_mm).collect(),
        })
        .collect()
}

/// Errors of both models where the robot stood.
pub fn workspace(judged: &Judged) -> Vec<WorkspacePoint> {
    let (Some(nominal), Some(calibrated)) = (judged.model("nominal"), judged.model("calibrated")) else {
        return Vec::new();
    };
    let pairs: Vec<_> = nominal.samples.iter().zip(&calibrated.samples).collect();
    thinned(&pairs)
        .into_iter()
        .map(|&(n, c)| WorkspacePoint {
            at_m: c.at_m,
            nominal_mm: n.distance_mm,
            calibrated_mm: c.distance_mm,
        })
        .collect()
}

/// Predicted against actual errors of the rows that judge.
pub fn prediction(evaluation: &Evaluation, recordings: &Recordings) -> Option<PredictedAccuracy> {
    let judged = evaluation.judged.as_ref()?;
    let found = judged
        .model("calibrated")
        .map_or(&[][..], |m: &JudgedModel| m.samples.as_slice());
    let judges: Vec<Judge<'_>> = recordings.judges(evaluation.cross_validated).collect();
    let pairs_mm = found
        .iter()
        .step_by(found.len().div_ceil(PREDICTED).max(1))
        .filter_map(|s| {
            let q = &judges.get(s.index)?.observation.q;
            let sigma = evaluation.predicted_sigma_mm(q);
            sigma.is_finite().then_some((sigma, s.distance_mm))
        })
        .collect();
    Some(PredictedAccuracy {
        mean_mm: evaluation.predicted_mm.0,
        max_mm: evaluation.predicted_mm.1,
        pairs_mm,
        frame: format!("The actual errors are those of {}.", judged.by),
        axis: String::new(),
    })
}
