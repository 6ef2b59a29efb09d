//! May the result be used? In words, and as the exit code.

use serde::Serialize;

use super::run::Study;
use crate::Method;

/// Whether a result may be used.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct Verdict {
    /// Exit code 0 instead of 3.
    pub trusted: bool,
    /// Share of the nominal mean error that is gone, from the validation.
    pub improvement: f64,
    /// Why not, or what to keep in mind; most important first.
    pub reasons: Vec<String>,
    /// What to do next.
    pub next: String,
}

/// Judges a study by its validation and by what its data could tell.
pub fn verdict(study: &Study) -> Verdict {
    let errors = |name: &str| {
        study
            .validation
            .model(name)
            .map(super::ModelErrors::errors)
            .unwrap_or_default()
    };
    let (nominal, calibrated) = (errors("nominal"), errors("calibrated"));
    let mut against = Vec::new();
    let mut mind = Vec::new();
    let improvement = if nominal.mean_mm > 0.0 {
        1.0 - calibrated.mean_mm / nominal.mean_mm
    } else {
        0.0
    };
    if calibrated.n == 0 {
        against.push("nothing judged the result: give --validate, or more rows".to_owned());
    } else if improvement <= 0.0 {
        against.push(format!(
            "the calibrated robot is not better than the nominal one: mean {:.3} mm against {:.3} mm",
            calibrated.mean_mm, nominal.mean_mm
        ));
    } else if improvement < 0.05 {
        mind.push(format!(
            "the gain is small: mean {:.3} mm against {:.3} mm",
            calibrated.mean_mm, nominal.mean_mm
        ));
    }
    if improvement > 0.0 && calibrated.max_mm > 1.5 * nominal.max_mm {
        against.push(format!(
            "the worst sample is {:.3} mm off, {:.3} mm nominally",
            calibrated.max_mm, nominal.max_mm
        ));
    }
    if let Some(holdout) = &study.holdout {
        let of = |name: &str| {
            holdout
                .pooled
                .model(name)
                .map(super::ModelErrors::errors)
                .unwrap_or_default()
        };
        let (n, c) = (of("nominal"), of("calibrated"));
        if c.mean_mm >= n.mean_mm {
            against.push(format!(
                "held out by {}, the calibrated robot is not better: mean {:.3} mm against {:.3} mm",
                holdout.column, c.mean_mm, n.mean_mm
            ));
        }
    }
    let rows = study.used.len();
    let calibration = &study.calibration;
    let unidentified: Vec<&str> = calibration
        .parameters
        .iter()
        .filter(|p| p.free && !p.identified && p.sigma > p.prior_sigma)
        .map(|p| p.name.as_str())
        .collect();
    let has_priors = matches!(calibration.method, Method::Map | Method::Geometry);
    if !has_priors {
        let frozen: Vec<&str> = calibration
            .parameters
            .iter()
            .filter(|p| p.free && !p.moved)
            .map(|p| p.name.as_str())
            .collect();
        if !frozen.is_empty() {
            against.push(format!(
                "these parameters were never identified but are used: {}",
                frozen.join(", ")
            ));
        }
    } else if !unidentified.is_empty() {
        mind.push(format!("the data say nothing about {}", unidentified.join(", ")));
    }
    if 3.0 * rows as f64 <= calibration.effective_parameters + 6.0 {
        let list = if study.cross_validated { &mut against } else { &mut mind };
        list.push(format!(
            "{rows} rows are too few for {:.0} parameters: measure more poses",
            calibration.effective_parameters
        ));
    }
    let bad = study.rejected.len() + calibration.residual.outliers.len();
    if 5 * bad > rows {
        against.push(format!(
            "{bad} of {} rows are outliers: find out why",
            rows + study.rejected.len()
        ));
    } else if bad > 0 {
        mind.push(format!("{bad} of {} rows are outliers", rows + study.rejected.len()));
    }
    if study.cross_validated {
        mind.push(
            "no separate validation was given; the errors are from cross-validation and hold where the data are"
                .to_owned(),
        );
    }
    let trusted = against.is_empty();
    let next = if !trusted {
        "Do not load this model. Measure more poses over a wider range of orientations and elbow positions, check the \
         rows named as outliers, and run again."
    } else if study.cross_validated {
        "Load calibrated.urdf or calibrated.toml, and check it on a few points of your own with --validate."
    } else {
        "Load calibrated.urdf or calibrated.toml into your controller or planner."
    };
    against.append(&mut mind);
    Verdict {
        trusted,
        improvement,
        reasons: against,
        next: next.to_owned(),
    }
}
