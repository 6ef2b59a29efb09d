//! Which priors fit this robot: a few, chosen by evidence.
//!
//! Joint compliance differs tenfold between robots (5e-6 to 6e-5 rad/(N m);
//! it depends on which side of the gear the encoder sits), machining and
//! mastering perhaps twofold. The fixed candidates here are compared by the
//! Laplace evidence of the whole calibration set; nothing is learned freely.

use rayon::prelude::*;

use crate::identify::{Experiment, Method, Model, Options, Override, identify, parameters};

/// Compliance priors tried, in rad/(N m); the first is the default.
const COMPLIANCE: [f64; 3] = [parameters::COMPLIANCE_SIGMA, 2e-5, 6e-5];
/// Factors on the geometric priors tried; the first is the default.
const GEOMETRY: [f64; 2] = [1.0, 2.0];
/// Evidence (natural logarithm) that a change of the defaults must win by.
const MARGIN: f64 = 3.0;

/// The options with the priors that the data prefer, and what was chosen in words.
pub(super) fn choose(experiment: &Experiment, options: &Options) -> (Options, Option<String>) {
    let touched = |name: &str| options.parameters.0.keys().any(|k| k.starts_with(name));
    let geometry_free = !["a", "d", "alpha", "beta", "theta"].iter().any(|n| touched(n));
    let stiff = options.method == Method::Map && options.model != Model::Geometry && !touched("compliance");
    let mut candidates = Vec::new();
    for &compliance in if stiff { &COMPLIANCE[..] } else { &COMPLIANCE[..1] } {
        for &factor in if geometry_free { &GEOMETRY[..] } else { &GEOMETRY[..1] } {
            candidates.push((compliance, factor));
        }
    }
    if !matches!(options.method, Method::Map | Method::Geometry) || candidates.len() < 2 {
        return (options.clone(), None);
    }
    let tried: Vec<(Options, f64)> = candidates
        .par_iter()
        .filter_map(|&(compliance, factor)| {
            let trial = with(options, compliance, factor);
            let evidence = identify(experiment, &trial).ok()?.log_evidence;
            evidence.is_finite().then_some((trial, evidence))
        })
        .collect();
    let default = with(options, COMPLIANCE[0], GEOMETRY[0]);
    let base = tried.iter().find(|(o, _)| *o == default).map(|t| t.1);
    let best = tried.into_iter().max_by(|a, b| a.1.total_cmp(&b.1));
    match (best, base) {
        (Some((best, evidence)), Some(base)) if evidence > base + MARGIN => {
            let of = |name: &str| best.parameters.0.get(name).and_then(|o| o.prior_sigma);
            let mut words = Vec::new();
            if let Some(c) = of("compliance") {
                words.push(format!("joint compliance within {c:.0e} rad/(N m)"));
            }
            if let Some(a) = of("a") {
                words.push(format!(
                    "link errors within {:.1} mm and {:.1} mrad",
                    a * 1e3,
                    1e3 * of("theta").unwrap_or(0.0)
                ));
            }
            let words = format!(
                "priors chosen by evidence (ln gain {:.0}): {} (1 sigma)",
                evidence - base,
                words.join(", ")
            );
            (best, Some(words))
        }
        (Some((best, _)), None) => (best, None),
        _ => (options.clone(), None),
    }
}

/// The options with a compliance prior and a factor on the geometric ones.
fn with(options: &Options, compliance: f64, factor: f64) -> Options {
    let mut options = options.clone();
    let mut set = |name: &str, sigma: f64| {
        options.parameters.0.insert(
            name.to_owned(),
            Override {
                prior_sigma: Some(sigma),
                ..Override::default()
            },
        );
    };
    if compliance != COMPLIANCE[0] {
        set("compliance", compliance);
    }
    if factor != 1.0 {
        set("a", parameters::LENGTH_SIGMA_M * factor);
        set("d", parameters::LENGTH_SIGMA_M * factor);
        set("alpha", parameters::TWIST_SIGMA_RAD * factor);
        set("theta", parameters::OFFSET_SIGMA_RAD * factor);
    }
    options
}
