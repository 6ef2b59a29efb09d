//! Several targets and measured orientations: where each target is, its noise and its error.

use std::fmt::Write as _;

use serde_json::{Value, json};
use spherecal_identify::evaluate::{Errors, JudgedModel, millimetres};
use spherecal_identify::study::Study;

fn calibrated(study: &Study) -> Option<&JudgedModel> {
    study.evaluation.judged.as_ref()?.model("calibrated")
}

/// Adds `targets` and `orientation` to the document; nothing where rows have one point each.
pub(super) fn into_summary(study: &Study, document: &mut Value) {
    let calibration = &study.evaluation.calibration;
    if calibration.targets.is_empty() {
        return;
    }
    let judged = calibrated(study);
    let targets: Vec<Value> = calibration
        .targets
        .iter()
        .map(|target| {
            let errors = judged.map(|model| model.target_errors(target.number));
            json!({
                "number": target.number,
                "rows": target.rows,
                "place_mm": study.model.tcp_in_flange(target.place_m).map(|x| x * 1e3),
                "noise_mm": target.noise_mm,
                "depth_noise_mm": target.depth_noise_mm,
                "rms_mm": target.rms_mm,
                "validation": errors.map(|e| json!({
                    "n": e.n, "mean_mm": e.mean_mm, "rms_mm": e.rms_mm, "max_mm": e.max_mm,
                })),
            })
        })
        .collect();
    document["targets"] = Value::Array(targets);
    if let Some(orientation) = &calibration.orientation {
        document["orientation"] = json!({
            "rows": orientation.rows,
            "noise_mrad": orientation.noise_mrad,
            "rms_mrad": orientation.rms_mrad,
            "validation": judged.and_then(JudgedModel::turns),
        });
    }
}

/// A line for each target and one for the orientation; empty where rows have one point each.
pub(super) fn words(study: &Study) -> String {
    let calibration = &study.evaluation.calibration;
    let mut out = String::new();
    if calibration.targets.is_empty() {
        return out;
    }
    let judged = calibrated(study);
    let _ = writeln!(
        out,
        "\n{} on the tool{}; noise of each axis without that of the joints, found from the data:",
        match calibration.targets.len() {
            1 => "1 target".to_owned(),
            n => format!("{n} targets"),
        },
        if calibration.orientation.is_some() {
            ", with its orientation"
        } else {
            ""
        }
    );
    for target in &calibration.targets {
        let e = judged.map_or_else(Errors::default, |model| model.target_errors(target.number));
        let _ = writeln!(
            out,
            "  target {}: {} rows, at {} mm in the flange frame, noise {}{}",
            target.number,
            target.rows,
            millimetres(&study.model.tcp_in_flange(target.place_m)),
            target.noise_words(),
            if e.n > 0 {
                format!(", mean error {:.3} mm on {} validation rows", e.mean_mm, e.n)
            } else {
                String::new()
            }
        );
    }
    if let Some(orientation) = &calibration.orientation {
        let turns = judged.and_then(JudgedModel::turns);
        let _ = writeln!(
            out,
            "  orientation: {} rows, noise {:.3} mrad{}",
            orientation.rows,
            orientation.noise_mrad,
            turns.map_or_else(String::new, |t| format!(
                ", mean error {:.3} mrad on {} validation rows",
                t.mean_mrad, t.n
            ))
        );
    }
    out
}
