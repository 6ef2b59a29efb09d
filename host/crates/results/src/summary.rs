//! `summary.json`: the document for other programs.

use serde_json::{Value, json};
use sha2::{Digest, Sha256};

use spherecal_identify::evaluate::{Errors, Judge, Judged};
use spherecal_identify::study::Study;
use spherecal_identify::{Evaluation, Target};
use spherecal_report::Certificate;

use crate::certificate::{CertificateSubject, certificate, hexadecimal};

/// The numbers that an instrument measured, in m; a hidden target is not a number. A contact has none: its recording is
/// that of a run.
fn measured(target: &Target) -> Vec<f64> {
    match target {
        Target::Point(point) => point.to_vec(),
        Target::Points(points) => points.iter().flat_map(|point| point.unwrap_or([f64::NAN; 3])).collect(),
        Target::Frame(pose) => pose.position.iter().chain(pose.rotation.iter()).copied().collect(),
        Target::Sphere { .. } => Vec::new(),
    }
}

/// Hash over the bits of the recordings in order: joint angles, torques, and what an instrument measured.
fn recordings_sha256(study: &Study) -> String {
    let mut hash = Sha256::new();
    for o in &study.recordings.experiment.observations {
        for value in o.q.iter().chain(o.tau.iter().flatten()).chain(&measured(&o.target)) {
            hash.update(value.to_bits().to_le_bytes());
        }
    }
    hexadecimal(&hash.finalize())
}

fn errors_json(errors: &Errors) -> Value {
    json!({
        "mean_mm": errors.mean_mm, "std_mm": errors.std_mm, "min_mm": errors.min_mm, "max_mm": errors.max_mm,
        "rms_mm": errors.rms_mm,
    })
}

/// Errors by model. The calibrated model also appears under the name of its measuring method, as in
/// Table 5 of the paper.
fn models_json(judged: &Judged, closed_loop: bool) -> Value {
    let mut models = serde_json::Map::new();
    for model in &judged.models {
        let value = errors_json(&model.errors());
        if model.name == "calibrated" {
            models.insert(if closed_loop { "sphere" } else { "laser" }.to_owned(), value.clone());
        }
        models.insert(model.name.clone(), value);
    }
    Value::Object(models)
}

fn judged_json(judged: &Judged, closed_loop: bool) -> Value {
    let n = judged.models.first().map_or(0, |m| m.samples.len());
    let mut value = json!({ "n": n, "by": judged.by, "models": models_json(judged, closed_loop) });
    let distances: Vec<Value> = judged
        .models
        .iter()
        .filter(|m| !m.distances_mm.is_empty())
        .map(|m| json!({ "model": m.name, "mean_abs_mm": m.mean_distance_error_mm(), "errors": m.distances_mm }))
        .collect();
    if !distances.is_empty() {
        value["sphere_distances"] = Value::Array(distances);
    }
    value
}

/// The summary of a study, with its certificate.
pub fn summary_json(study: &Study, certificate: &Certificate) -> Value {
    let evaluation = &study.evaluation;
    let recordings = &study.recordings;
    let calibration = &evaluation.calibration;
    let closed_loop = recordings.closed_loop();
    let identifiability = &calibration.identifiability;
    let given = evaluation
        .given_tcp_m
        .unwrap_or_else(|| recordings.experiment.tool.tcp());
    let parameters: Vec<Value> = calibration
        .parameters
        .iter()
        .map(|p| {
            let nominal = match p.name.as_str() {
                "tool_x" => given.x,
                "tool_y" => given.y,
                "tool_z" => given.z,
                _ => p.nominal,
            };
            json!({
                "name": p.name, "unit": p.unit, "nominal": nominal, "estimate": p.estimate, "sigma": p.sigma,
                "identified": p.identified, "free": p.free, "moved": p.moved, "prior_sigma": p.prior_sigma,
                "reason": p.reason,
            })
        })
        .collect();
    let residual = &calibration.residual;
    let outliers: Vec<Value> = residual
        .outliers
        .iter()
        .take(LISTED)
        .filter_map(|o| {
            let row = recordings.describe(*evaluation.used.get(o.index)?);
            Some(json!({ "row": row, "why": o.why }))
        })
        .collect();
    let rejected: Vec<Value> = evaluation
        .rejected
        .iter()
        .take(LISTED)
        .map(|(i, mm)| json!({ "row": recordings.describe(*i), "distance_mm": mm }))
        .collect();
    let planned = recordings.samples.len();
    let names: Vec<&str> = recordings.places.names().collect();
    let frames: Vec<Value> = calibration
        .frames
        .iter()
        .map(|f| {
            json!({
                "frame": f.reference,
                "base_xyz_m": f.base.position.as_slice(),
                "base_rpy_rad": spherecal_model::robots::frames::to_rpy(&f.base.rotation),
            })
        })
        .collect();
    let mut value = json!({
        "command": "identify",
        "version": env!("CARGO_PKG_VERSION"),
        "seed": evaluation.options.seed,
        "robot": study.model.robot.name.as_str(),
        "method": calibration.method,
        "model": calibration.model,
        "closed_loop": closed_loop,
        "poses": { "planned": planned, "reachable": planned, "recorded": evaluation.used.len(), "rejected": evaluation.rejected.len() },
        "simulated_s": Value::Null,
        "wall_s": study.wall_s,
        "real_time_factor": Value::Null,
        "identifiability": {
            "columns": identifiability.columns, "rank": identifiability.rank,
            "condition": finite(identifiability.condition), "redundant": identifiability.redundant,
            "dependencies": identifiability.dependencies,
            "noise_amplification": finite(identifiability.noise_amplification),
        },
        "parameters": parameters,
        "tool_mm": study.model.tcp_in_flange(evaluation.geometry.tool.tcp_m).map(|x| x * 1e3),
        "frames": frames,
        "places": names,
        "residual": {
            "rms_mm": residual.rms_mm, "mean_mm": residual.mean_mm, "max_mm": residual.max_mm,
            "outliers": residual.outliers.len(), "outlier_rows": outliers, "rejected_rows": rejected,
        },
        "noise": calibration.noise,
        "effective_parameters": calibration.effective_parameters,
        "predicted": { "mean_mm": evaluation.predicted_mm.0, "max_mm": evaluation.predicted_mm.1 },
        "validation": evaluation.judged.as_ref().map_or_else(|| json!({ "n": 0, "models": {} }), |j| judged_json(j, closed_loop)),
        "verdict": evaluation.verdict,
        "files": files_json(evaluation),
        "certificate": certificate,
        "notes": study.notes,
        "recordings_sha256": certificate.recordings_sha256,
        "faults": [],
        "link": { "frames": 0, "crc_errors": 0, "lost": 0, "resent": 0, "duplicates": 0 },
    });
    if let Some(judged) = evaluation.judged.as_ref().filter(|_| !evaluation.cross_validated) {
        let judges: Vec<Judge<'_>> = recordings.judges(false).collect();
        let aligned = judged.base_aligned(&judges);
        value["validation"]["models_base_aligned"] = models_json(&aligned, closed_loop);
    }
    crate::targets::into_summary(study, &mut value);
    value["validation"]["cross_validated"] = json!(evaluation.cross_validated);
    if let Some(holdout) = &evaluation.holdout {
        let folds: Vec<Value> = holdout
            .folds
            .iter()
            .map(|f| {
                let mut fold = judged_json(&f.judged, closed_loop);
                fold["value"] = json!(f.value);
                fold
            })
            .collect();
        let mut pooled = judged_json(&holdout.pooled, closed_loop);
        pooled["column"] = json!(holdout.column);
        pooled["folds"] = Value::Array(folds);
        value["holdout"] = pooled;
    }
    value
}

/// Most rows of a kind that the document lists; their total number stands beside.
const LISTED: usize = 1000;

/// A number, or null if it is infinite or not a number (JSON has neither).
fn finite(value: f64) -> Value {
    if value.is_finite() { json!(value) } else { Value::Null }
}

/// The certificate of a study; `state` writes onto it what the user stated. A table of poses does not say when it
/// was measured and whether its arm was simulated.
pub fn study_certificate(study: &Study, state: &dyn Fn(&mut Certificate)) -> Certificate {
    let about = CertificateSubject {
        robot: study.model.robot.name.as_str(),
        arm: "",
        measured: None,
        simulated: false,
        campaign: false,
        configuration: toml::to_string(&study.evaluation.options).ok(),
        recordings_sha256: recordings_sha256(study),
    };
    certificate(state, about, &study.recordings, &study.evaluation)
}

/// The files of a result with the error that each has over the work region, for `summary.json`.
pub fn files_json(evaluation: &Evaluation) -> Value {
    let verdict = &evaluation.verdict;
    let mut files = vec![json!({
        "name": "calibrated.toml with its compensator",
        "expected_error_mm": verdict.expected_error_mm.map(|e| e.work),
        "region": "work",
    })];
    if evaluation.geometry.helps() {
        files.push(json!({
            "name": "calibrated.urdf",
            "expected_error_mm": verdict.file_error_mm.map(|e| e.work),
            "region": "work",
        }));
    }
    files.into()
}
