//! The result on the terminal: words first, then the table.

use std::fmt::Write as _;

use spherecal_identify::study::{Judged, ModelErrors, Study, millimetres};

/// Name of a model for people.
fn title(name: &str) -> &str {
    match name {
        "nominal" => "nominal",
        "calibrated" => "calibrated",
        "calibrated_table_only" => "calibrated, URDF only",
        other => other,
    }
}

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
            title(&model.name),
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
    let errors = |name: &str| {
        study
            .validation
            .model(name)
            .map(ModelErrors::errors)
            .unwrap_or_default()
    };
    let (nominal, calibrated) = (errors("nominal"), errors("calibrated"));
    let v = &study.verdict;
    let _ = writeln!(
        out,
        "{}: mean error {:.3} mm, with the nominal model {:.3} mm ({} {:.0} %). {}",
        study.loaded.model.robot.name,
        calibrated.mean_mm,
        nominal.mean_mm,
        if v.improvement >= 0.0 { "better by" } else { "worse by" },
        v.improvement.abs() * 100.0,
        if v.trusted {
            "The result may be used."
        } else {
            "DO NOT USE this result."
        }
    );
    for reason in &v.reasons {
        let _ = writeln!(out, "  - {reason}");
    }
    let n = calibrated.n;
    let _ = writeln!(out, "\nValidation on {n} samples ({}):", study.validation.by);
    table(&mut out, &study.validation);
    if let Some(holdout) = &study.holdout {
        let _ = writeln!(
            out,
            "\nHeld out by {} ({} values):",
            holdout.column,
            holdout.folds.len()
        );
        table(&mut out, &holdout.pooled);
    }
    let calibration = &study.calibration;
    let id = &calibration.identifiability;
    let free = calibration.parameters.iter().filter(|p| p.free).count();
    let identified = calibration.parameters.iter().filter(|p| p.identified).count();
    let residual = &calibration.residual;
    let _ = writeln!(
        out,
        "\nFit ({}, {} model): {} rows, residual {:.3} mm rms, {} outliers, {} left out",
        calibration.method,
        calibration.model,
        study.used.len(),
        residual.rms_mm,
        residual.outliers.len(),
        study.rejected.len()
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
        "TCP {} mm in the flange frame; predicted error of a position {:.3} mm (1 sigma), at most {:.3} mm",
        millimetres(&study.loaded.model.tcp_in_flange(calibration.tool.tcp_m)),
        study.predicted_mm.0,
        study.predicted_mm.1
    );
    if !study.notes.is_empty() {
        let _ = writeln!(out, "\nNotes:");
        for note in study.notes.iter().take(12) {
            let _ = writeln!(out, "  - {note}");
        }
        if study.notes.len() > 12 {
            let _ = writeln!(out, "  - and {} more in summary.json", study.notes.len() - 12);
        }
    }
    let _ = writeln!(out, "\n{}", v.next);
    out
}
