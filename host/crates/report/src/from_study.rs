//! A report of a calibration from files.

use super::calibration::{correlation, group_table, identifiability_words, parameter_rows};
use super::input::{
    ErrorSeries, ErrorTable, Headline, ModelRow, Prediction, ReportInput, ResidualPoint, WorkspacePoint,
};
use spherecal_identify::Target;
use spherecal_identify::study::{Judged, ModelErrors, Study};

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

fn distances(m: &ModelErrors) -> Vec<f64> {
    m.samples.iter().map(|s| s.distance_mm).collect()
}

/// The report of a study; `created` says when, in words.
pub fn study_report(study: &Study, created: &str) -> ReportInput {
    let calibration = &study.calibration;
    let loaded = &study.loaded;
    let errors = |name: &str| {
        study
            .validation
            .model(name)
            .map(ModelErrors::errors)
            .unwrap_or_default()
    };
    let (nominal, calibrated) = (errors("nominal"), errors("calibrated"));
    let v = &study.verdict;
    let name = loaded.model.robot.name.as_str();
    let sentence = if v.improvement > 0.0 {
        format!(
            "The calibrated {name} is {:.0} % more accurate: its mean position error fell from {:.3} mm to {:.3} mm, \
             the largest from {:.3} mm to {:.3} mm.",
            v.improvement * 100.0,
            nominal.mean_mm,
            calibrated.mean_mm,
            nominal.max_mm,
            calibrated.max_mm
        )
    } else {
        format!(
            "The calibrated {name} is no better than the nominal one: mean position error {:.3} mm, nominally {:.3} mm.",
            calibrated.mean_mm, nominal.mean_mm
        )
    };
    let identified = calibration.parameters.iter().filter(|p| p.identified).count();
    let figures = vec![
        (
            "Mean error".to_owned(),
            format!("{:.3} mm", calibrated.mean_mm),
            format!("nominally {:.3} mm", nominal.mean_mm),
        ),
        (
            "Largest error".to_owned(),
            format!("{:.3} mm", calibrated.max_mm),
            format!("nominally {:.3} mm", nominal.max_mm),
        ),
        (
            "Recordings".to_owned(),
            study.used.len().to_string(),
            format!(
                "{} left out, {} outliers",
                study.rejected.len(),
                calibration.residual.outliers.len()
            ),
        ),
        (
            "Parameters".to_owned(),
            identified.to_string(),
            "determined by the data".to_owned(),
        ),
    ];
    let mut error_tables = vec![ErrorTable {
        title: format!("Position errors on {} samples", calibrated.n),
        caption: format!(
            "Judged by {}. \"Table only\" is what a URDF can hold: links without compliance and encoder errors.",
            study.validation.by
        ),
        rows: rows(&study.validation),
    }];
    if let Some(holdout) = &study.holdout {
        error_tables.push(ErrorTable {
            title: format!("Held out by {}", holdout.column),
            caption: holdout.pooled.by.clone(),
            rows: rows(&holdout.pooled),
        });
        for fold in &holdout.folds {
            error_tables.push(ErrorTable {
                title: format!("{} {}", holdout.column, fold.value),
                caption: String::new(),
                rows: rows(&fold.judged),
            });
        }
    }
    let errors = study
        .validation
        .models
        .iter()
        .filter(|m| m.name != "calibrated_table_only")
        .map(|m| ErrorSeries {
            name: m.name.clone(),
            errors_mm: distances(m),
        })
        .collect();
    let place = |p: u32| loaded.places.name(p).to_owned();
    let outlier = |index: usize| calibration.residual.outliers.iter().any(|o| o.index == index);
    let residuals = calibration
        .residual
        .rows
        .iter()
        .filter_map(|r| {
            let sample = loaded.samples.get(*study.used.get(r.index)?)?;
            let group = match sample.observation.target {
                Target::Point(_) => "tracker".to_owned(),
                Target::Sphere { sphere, place: p } => match place(p) {
                    name if name.is_empty() => format!("sphere {sphere}"),
                    name => format!("sphere {sphere}, {name}"),
                },
            };
            Some(ResidualPoint {
                group,
                distance_mm: r.error_mm.iter().map(|e| e * e).sum::<f64>().sqrt(),
                outlier: outlier(r.index),
            })
        })
        .collect();
    let mut outliers: Vec<(String, String)> = study
        .rejected
        .iter()
        .filter_map(|(i, mm)| {
            let sample = loaded.samples.get(*i)?;
            Some((
                study.describe(sample),
                format!("left out: {mm:.1} mm from where any calibration could bring it"),
            ))
        })
        .collect();
    outliers.extend(calibration.residual.outliers.iter().filter_map(|o| {
        let sample = loaded.samples.get(*study.used.get(o.index)?)?;
        Some((study.describe(sample), o.why.clone()))
    }));
    ReportInput {
        title: format!("{name}: calibration report"),
        subtitle: format!(
            "{created} · {} data, {} recordings · {} joints",
            if loaded.closed_loop { "closed-loop" } else { "absolute" },
            loaded.samples.len(),
            loaded.model.robot.dof()
        ),
        headline: Headline {
            trusted: v.trusted,
            sentence,
            reasons: v.reasons.clone(),
            next: v.next.clone(),
            figures,
        },
        error_tables,
        errors,
        workspace: workspace(&study.validation),
        contacts: Vec::new(),
        triggers: Vec::new(),
        stillness: Vec::new(),
        stillness_tables: Vec::new(),
        parameters: parameter_rows(calibration),
        identifiability: identifiability_words(calibration),
        residuals,
        outliers,
        correlation: correlation(calibration),
        prediction: Some(prediction(study)),
        fit_tables: vec![group_table(&calibration.groups, place)],
        health_tables: Vec::new(),
        notes: study.notes.clone(),
        provenance: provenance(study, created),
    }
}

/// Errors of both models where the robot stood.
fn workspace(judged: &Judged) -> Vec<WorkspacePoint> {
    let (Some(nominal), Some(calibrated)) = (judged.model("nominal"), judged.model("calibrated")) else {
        return Vec::new();
    };
    nominal
        .samples
        .iter()
        .zip(&calibrated.samples)
        .map(|(n, c)| WorkspacePoint {
            at_m: c.at_m,
            nominal_mm: n.distance_mm,
            calibrated_mm: c.distance_mm,
        })
        .collect()
}

fn prediction(study: &Study) -> Prediction {
    let found = study
        .validation
        .model("calibrated")
        .map(|m| m.samples.as_slice())
        .unwrap_or_default();
    let pairs_mm = found
        .iter()
        .filter_map(|s| {
            let q = &study.judges.get(s.index)?.observation.q;
            let sigma = study.predicted_sigma_mm(q);
            sigma.is_finite().then_some((sigma, s.distance_mm))
        })
        .collect();
    Prediction {
        mean_mm: study.predicted_mm.0,
        max_mm: study.predicted_mm.1,
        pairs_mm,
    }
}

fn provenance(study: &Study, created: &str) -> Vec<(String, String)> {
    let loaded = &study.loaded;
    let file = |samples: &[spherecal_identify::study::Sample]| {
        samples.first().map(|s| {
            s.source
                .rsplit_once(" line")
                .map_or(s.source.clone(), |x| x.0.to_owned())
        })
    };
    let mut out = vec![
        ("program".to_owned(), format!("spherecal {}", env!("CARGO_PKG_VERSION"))),
        ("written".to_owned(), created.to_owned()),
        (
            "robot".to_owned(),
            format!("{} ({} joints)", loaded.model.robot.name, loaded.model.robot.dof()),
        ),
        (
            "frames".to_owned(),
            format!(
                "root {}, flange {}",
                loaded.model.frame_names.0, loaded.model.frame_names.1
            ),
        ),
        ("data".to_owned(), file(&loaded.samples).unwrap_or_default()),
        ("judged by".to_owned(), study.validation.by.clone()),
        (
            "estimator".to_owned(),
            format!("{}, {} model", study.calibration.method, study.calibration.model),
        ),
        (
            "noise found".to_owned(),
            format!("{:.2} times the assumed", study.calibration.noise_scale),
        ),
        ("time taken".to_owned(), format!("{:.2} s", study.wall_s)),
    ];
    if let Ok(options) = toml::to_string(&study.options) {
        let words: Vec<&str> = options.lines().filter(|l| !l.trim().is_empty()).collect();
        out.push(("options".to_owned(), words.join("; ")));
    }
    out
}
