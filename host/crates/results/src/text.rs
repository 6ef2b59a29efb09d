//! The result on the terminal: words first, then the table.

use std::fmt::Write as _;

use spherecal_identify::evaluate::{Errors, Judged, JudgedModel, millimetres, model_title};
use spherecal_identify::study::Study;
use spherecal_report::headline::brief;

fn table(out: &mut String, judged: &Judged) {
    let _ = writeln!(
        out,
        "  {:<24}{:>8}{:>8}{:>8}{:>8}   mm",
        "", "mean", "std", "min", "max"
    );
    for model in &judged.models {
        let e = model.errors();
        let _ = writeln!(
            out,
            "  {:<24}{:>8.3}{:>8.3}{:>8.3}{:>8.3}",
            model_title(&model.name),
            e.mean_mm,
            e.std_mm,
            e.min_mm,
            e.max_mm
        );
    }
    if let Some(model) = judged.model("calibrated")
        && !model.distances_mm.is_empty()
    {
        let _ = writeln!(
            out,
            "  distances between spheres off by {:.3} mm (mean of {})",
            model.mean_distance_error_mm(),
            model.distances_mm.len()
        );
    }
}

/// A study in words.
pub fn summary_text(study: &Study) -> String {
    let mut out = String::new();
    let evaluation = &study.evaluation;
    let judged = evaluation.judged.as_ref();
    let errors = |name: &str| -> Errors {
        let model = judged.and_then(|j| j.model(name));
        model.map(JudgedModel::errors).unwrap_or_default()
    };
    let (nominal, calibrated) = (errors("nominal"), errors("calibrated"));
    let v = &evaluation.verdict;
    let gain = 1.0 - calibrated.mean_mm / nominal.mean_mm.max(1e-12);
    let judged_words = format!(
        "mean error {:.3} mm, nominally {:.3} mm ({} {:.0} %)",
        calibrated.mean_mm,
        nominal.mean_mm,
        if gain >= 0.0 { "better by" } else { "worse by" },
        gain.abs() * 100.0,
    );
    let _ = writeln!(out, "{}", v.headline);
    for reason in &v.reasons {
        let _ = writeln!(out, "  - {}", brief(reason));
    }
    if let Some(judged) = judged {
        let _ = writeln!(
            out,
            "\nValidation on {} samples ({}): {judged_words}",
            calibrated.n, judged.by
        );
        table(&mut out, judged);
    }
    out += &crate::targets::words(study);
    if let Some(holdout) = &evaluation.holdout {
        let _ = writeln!(
            out,
            "\nHeld out by {} ({} values):",
            holdout.column,
            holdout.folds.len()
        );
        table(&mut out, &holdout.pooled);
    }
    let calibration = &evaluation.calibration;
    let id = &calibration.identifiability;
    let free = calibration.parameters.iter().filter(|p| p.free).count();
    let identified = calibration.parameters.iter().filter(|p| p.identified).count();
    let residual = &calibration.residual;
    let _ = writeln!(
        out,
        "\nFit ({}, {} model): {} rows, residual {:.3} mm rms, {} outliers, {} left out",
        calibration.method,
        calibration.model,
        evaluation.used.len(),
        residual.rms_mm,
        residual.outliers.len(),
        evaluation.rejected.len()
    );
    let _ = writeln!(
        out,
        "Identifiability: rank {} of {} geometric columns, condition {:.0}; {identified} of {free} parameters determined \
         by the data",
        id.rank, id.columns, id.condition
    );
    for words in &id.dependencies {
        let _ = writeln!(out, "  - {words}");
    }
    let _ = writeln!(
        out,
        "TCP {} mm in the flange frame (of the files); predicted error of a position {:.3} mm (1 sigma), at most {:.3} mm",
        millimetres(&study.model.tcp_in_flange(evaluation.geometry.tool.tcp_m)),
        evaluation.predicted_mm.0,
        evaluation.predicted_mm.1
    );
    if !study.notes.is_empty() {
        let _ = writeln!(out, "\nNotes:");
        for note in study.notes.iter().take(12) {
            let _ = writeln!(out, "  - {note}");
        }
        if study.notes.len() > 12 {
            let _ = writeln!(out, "  - and {} more in report.html", study.notes.len() - 12);
        }
    }
    let _ = writeln!(out, "\n{}", v.next);
    out
}
