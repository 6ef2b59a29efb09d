//! The report of a run: calibrated from sphere contacts, judged by laser measurements.

use crate::{Evaluation, Measurements, Summary};
use spherecal_campaign::telemetry::ContactTrace;
use spherecal_identify::validate::{Alignment, ModelErrors, ValidationTable};
use spherecal_model::LaserShot;
use spherecal_report::calibration::{
    correlation, group_table, identifiability_words, outliers, parameter_rows, residual_points,
};
use spherecal_report::headline::{Error, compared, files, regions};
use spherecal_report::{
    ErrorSeries, ErrorTable, Headline, HistogramChart, ModelRow, PredictedAccuracy, ReportInput, WorkspacePoint, judged,
};

mod tables;

use tables::{configuration, contacts, health, provenance, seating};

/// The report of a run. `traces` are the forces of its contacts; `created` is the date of the
/// measurement.
pub fn run_report(
    m: &Measurements,
    e: &Evaluation,
    s: &Summary,
    traces: &[ContactTrace],
    created: &str,
) -> ReportInput {
    // Without a tracker, contacts that the fit has not seen judge.
    let judged = e.judged.as_ref();
    let recordings = m.to_recordings();
    ReportInput {
        title: format!(
            "{}{}: calibration report",
            if s.simulated { "SIMULATED: " } else { "" },
            s.robot
        ),
        subtitle: format!(
            "{created} · {} recordings on {} spheres · link {} · seed {}",
            s.poses.recorded,
            m.spheres.len(),
            s.link_name,
            s.seed
        ),
        headline: Headline {
            trusted: s.verdict.may_be_used,
            sentence: s.verdict.headline.clone(),
            reasons: s.verdict.reasons.clone(),
            next: s.verdict.next.clone(),
            files: files(e),
            figures: Vec::new(),
        },
        comparison: comparison(s),
        error_tables: e.table().map_or_else(|| judged::tables(e), error_tables),
        errors: e.table().map(errors).or(judged.map(judged::series)).unwrap_or_default(),
        errors_axis: e
            .table()
            .map(|_| "base fitted to the points")
            .unwrap_or_default()
            .to_owned(),
        workspace: e
            .table()
            .map(|t| workspace(m, e, t))
            .or(judged.map(judged::workspace))
            .unwrap_or_default(),
        contacts: traces.to_vec(),
        contact_threshold_n: m.config.procedure.approach.trigger_n,
        triggers: triggers(m),
        stillness: Vec::new(),
        stillness_tables: Vec::new(),
        parameters: parameter_rows(&e.calibration),
        identifiability: identifiability_words(&e.calibration),
        residuals: residual_points(e, &recordings),
        outliers: outliers(e, &recordings),
        correlation: correlation(&e.calibration),
        regions: regions(e),
        prediction: e
            .table()
            .map(|t| prediction(m, e, t))
            .or_else(|| judged::prediction(e, &recordings)),
        fit_tables: vec![
            group_table(&e.calibration.groups, |p| {
                if p == 0 { String::new() } else { format!("place {p}") }
            }),
            contacts(m),
            seating(m),
        ],
        health_tables: health(m, s),
        notes: s.remarks.clone(),
        provenance: provenance(m, s, created),
        configuration: configuration(&m.config),
    }
}

/// What was compared with what, in sentences.
fn comparison(s: &Summary) -> String {
    let of = |name: &str| {
        s.validation.models.get(name).map(|m| Error {
            mean_mm: m.best_fit.mean_mm,
            max_mm: m.best_fit.max_mm,
        })
    };
    match (of("nominal"), of("sphere")) {
        (Some(n), Some(c)) => {
            let subject = format!("Calibrated by touching spheres, the {}", s.robot);
            compared(&subject, &s.robot, n, c) + &against_the_laser(s)
        }
        _ => "No laser tracker judged the result.".to_owned(),
    }
}

/// Compares the spheres with a laser tracker, once with the paper's model and once with the same
/// full model: which has the smaller error, and by how much.
fn against_the_laser(s: &Summary) -> String {
    let mean = |name: &str| s.validation.models.get(name).map(|m| m.best_fit.mean_mm);
    let Some(sphere) = mean("sphere") else {
        return String::new();
    };
    let ahead = |laser: f64| {
        let difference = (laser - sphere).abs();
        if sphere <= laser {
            format!("is behind by {difference:.3} mm ({laser:.3} mm)")
        } else {
            format!("stays ahead by {difference:.3} mm ({laser:.3} mm)")
        }
    };
    let paper = mean("laser").map(|laser| {
        format!(
            " A laser calibration of the geometry alone, as in the paper, {} in the mean.",
            ahead(laser)
        )
    });
    let equal = mean("laser_full").map(|laser| format!(" A laser calibration with the full model {}.", ahead(laser)));
    [paper, equal].into_iter().flatten().collect()
}

/// The base fitted first: the expected error of the headline is that of the arm's shape, too.
fn error_tables(table: &ValidationTable) -> Vec<ErrorTable> {
    let frames = [
        (
            Alignment::BestFit,
            format!("Position errors on {} laser measurements", table.n),
            "The base was fitted to the points: errors of the arm's shape alone.",
        ),
        (
            Alignment::Arcs,
            "Base measured by arcs".to_owned(),
            "Table 5 of the paper: with the errors that the arcs have of base and tool.",
        ),
        (Alignment::Own, "Each model's own base".to_owned(), ""),
    ];
    let row = |m: &ModelErrors, alignment| {
        let v = m.statistics(alignment);
        ModelRow {
            name: m.name.clone(),
            mean_mm: v.mean_mm,
            std_mm: v.std_mm,
            min_mm: v.min_mm,
            max_mm: v.max_mm,
        }
    };
    frames
        .into_iter()
        .map(|(alignment, title, caption)| ErrorTable {
            title,
            caption: caption.to_owned(),
            rows: table.models.iter().map(|m| row(m, alignment)).collect(),
        })
        .collect()
}

/// Errors of a model with the base fitted to the points, in mm.
fn with_fitted_base(model: &ModelErrors) -> &[f64] {
    &model.errors_mm[1]
}

fn errors(table: &ValidationTable) -> Vec<ErrorSeries> {
    table
        .models
        .iter()
        .filter(|m| ["nominal", "sphere", "laser"].contains(&m.name.as_str()))
        .map(|m| ErrorSeries {
            name: m.name.clone(),
            errors_mm: with_fitted_base(m).to_vec(),
        })
        .collect()
}

fn workspace(m: &Measurements, e: &Evaluation, table: &ValidationTable) -> Vec<WorkspacePoint> {
    let of = |name: &str| table.model(name).map(with_fitted_base);
    let (Some(nominal), Some(sphere)) = (of("nominal"), of("sphere")) else {
        return Vec::new();
    };
    m.shots(LaserShot::VALIDATE)
        .iter()
        .zip(nominal.iter().zip(sphere))
        .map(|(shot, (n, c))| WorkspacePoint {
            at_m: e.calibration.tcp_m(&shot.q, None).into(),
            nominal_mm: *n,
            calibrated_mm: *c,
        })
        .collect()
}

/// Predicted errors against those found with the base aligned.
fn prediction(m: &Measurements, e: &Evaluation, table: &ValidationTable) -> PredictedAccuracy {
    let found = table.model("sphere").map(with_fitted_base);
    let pairs_mm: Vec<(f64, f64)> = m
        .shots(LaserShot::VALIDATE)
        .iter()
        .zip(found.unwrap_or_default())
        .map(|(shot, error)| {
            let variance = e.calibration.tcp_covariance_in_base(&shot.q).trace().max(0.0);
            (variance.sqrt() * 1e3, *error)
        })
        .collect();
    let n = pairs_mm.len().max(1) as f64;
    PredictedAccuracy {
        mean_mm: pairs_mm.iter().map(|p| p.0).sum::<f64>() / n,
        max_mm: pairs_mm.iter().map(|p| p.0).fold(0.0, f64::max),
        pairs_mm,
        frame: "The base was fitted to the points: errors of the arm's shape alone.".to_owned(),
        axis: "base fitted to the points".to_owned(),
    }
}

/// Latency and overshoot of the trigger; empty for a run without contact.
fn triggers(m: &Measurements) -> Vec<HistogramChart> {
    if m.contacts.is_empty() {
        return Vec::new();
    }
    let approach = &m.config.procedure.approach;
    let dwell_ms = approach.dwell_s * 1e3;
    let histogram = |what: &str, step: f64, caption: String, values: Vec<f64>| HistogramChart {
        what: what.to_owned(),
        of: "contacts".to_owned(),
        caption,
        values,
        step,
    };
    vec![
        histogram(
            "latency of the trigger (control periods)",
            1.0,
            format!(
                "Latency of the trigger: control periods from the lasting crossing of {:.1} N to the declaration; \
                 the threshold must be exceeded for {dwell_ms:.0} ms.",
                approach.trigger_n
            ),
            m.contacts.iter().map(|c| f64::from(c.latency_ticks)).collect(),
        ),
        histogram(
            "overshoot of the trigger (N)",
            0.01,
            format!(
                "Overshoot: how far the mean force of 10 ms was above {:.1} N until the declaration, at most; impacts \
                 included.",
                approach.trigger_n
            ),
            m.contacts.iter().map(|c| c.peak_n - approach.trigger_n).collect(),
        ),
    ]
}
