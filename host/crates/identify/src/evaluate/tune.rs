//! Which geometric priors fit this robot: twice as wide where the evidence says so.
//!
//! Machining and mastering differ between makers. Two fixed candidates are
//! compared by the Laplace evidence of the whole calibration set; nothing is
//! learned freely. (Compliance and harmonics choose theirs within the estimator.)

use crate::{Experiment, Method, Options, Override, identify, priors};

/// Factor on the geometric priors that is tried.
const WIDER: f64 = 2.0;
/// Evidence (natural logarithm) that it must win by.
const MARGIN: f64 = 3.0;

/// The options with the priors that the data prefer, and what was chosen in words.
pub(super) fn choose(experiment: &Experiment, options: &Options) -> (Options, Option<String>) {
    let wide = [
        ("a", priors::LENGTH_SIGMA_M * WIDER),
        ("d", priors::LENGTH_SIGMA_M * WIDER),
        ("alpha", priors::TWIST_SIGMA_RAD * WIDER),
        ("theta", priors::OFFSET_SIGMA_RAD * WIDER),
    ];
    let touched = |name: &str| options.parameters.0.keys().any(|k| k.starts_with(name));
    let has_priors = matches!(options.method, Method::Full | Method::Geometry);
    if !has_priors || wide.iter().any(|(name, _)| touched(name)) {
        return (options.clone(), None);
    }
    let mut trial = options.clone();
    for (name, sigma) in wide {
        trial.parameters.0.insert(
            name.to_owned(),
            Override {
                prior_sigma: Some(sigma),
                ..Override::default()
            },
        );
    }
    let evidence = |o: &Options| {
        let found = identify(experiment, o).ok()?.log_evidence;
        found.is_finite().then_some(found)
    };
    match rayon::join(|| evidence(options), || evidence(&trial)) {
        (Some(default), Some(wider)) if wider > default + MARGIN => {
            let words = format!(
                "the evidence prefers wider priors of the links (ln gain {:.0}): {:.1} mm and {:.1} mrad (1 sigma)",
                wider - default,
                1e3 * priors::LENGTH_SIGMA_M * WIDER,
                1e3 * priors::OFFSET_SIGMA_RAD * WIDER
            );
            (trial, Some(words))
        }
        (None, Some(_)) => (trial, None),
        _ => (options.clone(), None),
    }
}
