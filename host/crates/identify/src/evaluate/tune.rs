//! How far this robot's geometry is from its nominal values: the priors of lengths, twists and offsets.
//!
//! Machining and mastering differ between makers by more than a factor of ten: a KUKA leaves the
//! factory calibrated, a Franka does not. Each group of geometric priors has three candidates, and
//! the Laplace evidence of the calibration set chooses among them, one group at a time. Few fixed
//! candidates are harmless where a free choice is not (`docs/design/identification.md`). What the
//! evidence prefers must also predict rows that a fit has not seen at least as well. (Compliance and
//! harmonics choose theirs within the estimator.)

use rayon::prelude::*;

use super::thin::{only, thinned};
use crate::choice::held_out_mm;
use crate::{Experiment, Method, Options, Override, identify, priors};

/// Factors on the priors of a group. Ten times the default is what public data of arms without a
/// factory calibration ask for ([`priors::UNCALIBRATED`]); three lies between.
const FACTORS: [f64; 3] = [1.0, 3.0, 10.0];
/// Evidence (natural logarithm) that each change must win by.
const MARGIN: f64 = 3.0;
/// Most changes: each group twice.
const CHANGES: usize = 6;
/// Rows that the choice looks at, spread evenly: more would not change it.
const ROWS: usize = 600;

/// Priors that are widened together.
struct PriorGroup {
    /// In words.
    name: &'static str,
    /// Names of the parameters.
    members: &'static [&'static str],
    /// Default prior, in m or rad.
    sigma: f64,
    /// Prior of an arm without a factory calibration: no arm is believed to be further from its description, however
    /// wide the prior that the data choose.
    uncalibrated: f64,
    /// Unit in words: a thousandth of that of `sigma`.
    unit: &'static str,
}

const GROUPS: [PriorGroup; 3] = [
    PriorGroup {
        name: "lengths",
        members: &["a", "d"],
        sigma: priors::LENGTH_SIGMA_M,
        uncalibrated: priors::UNCALIBRATED[0].1,
        unit: "mm",
    },
    PriorGroup {
        name: "twists",
        members: &["alpha", "beta"],
        sigma: priors::TWIST_SIGMA_RAD,
        uncalibrated: priors::UNCALIBRATED[2].1,
        unit: "mrad",
    },
    PriorGroup {
        name: "offsets",
        members: &["theta"],
        sigma: priors::OFFSET_SIGMA_RAD,
        uncalibrated: priors::UNCALIBRATED[3].1,
        unit: "mrad",
    },
];

/// The factor of each group.
type PriorWidths = [f64; GROUPS.len()];

const DEFAULT: PriorWidths = [1.0; GROUPS.len()];

impl PriorGroup {
    /// Whether the user set a prior, a value or a freedom of this group, or of a parameter in it.
    fn is_set(&self, options: &Options) -> bool {
        let of = |key: &String, member: &&str| {
            key.strip_prefix(*member)
                .is_some_and(|rest| rest.chars().all(|c| c.is_ascii_digit()))
        };
        options
            .parameters
            .0
            .keys()
            .any(|key| self.members.iter().any(|member| of(key, member)))
    }
}

/// The options with priors of these widths.
fn widened(options: &Options, parallel_axes: bool, widths: &PriorWidths) -> Options {
    let mut wide = options.clone();
    for (group, factor) in GROUPS.iter().zip(widths).filter(|(_, factor)| **factor > 1.0) {
        for member in group.members.iter().filter(|m| parallel_axes || **m != "beta") {
            let prior = Override {
                prior_sigma: Some(group.sigma * factor),
                stated_sigma: Some((group.sigma * factor).min(group.uncalibrated)),
                ..Override::default()
            };
            wide.parameters.0.insert((*member).to_owned(), prior);
        }
    }
    wide
}

/// The options with the priors that the data prefer, and what was chosen in words.
pub(super) fn choose(experiment: &Experiment, options: &Options) -> (Options, Option<String>) {
    let has_priors = matches!(options.method, Method::Full | Method::Geometry);
    let open: Vec<usize> = (0..GROUPS.len()).filter(|g| !GROUPS[*g].is_set(options)).collect();
    if !has_priors || open.is_empty() {
        return (options.clone(), None);
    }
    let rows: Vec<usize> = (0..experiment.observations.len()).collect();
    let some = only(experiment, &thinned(experiment, &rows, ROWS));
    let parallel_axes = identify(&some, options).is_ok_and(|c| c.parameters.iter().any(|p| p.name.starts_with("beta")));
    let evidence = |widths: &PriorWidths| {
        let found = identify(&some, &widened(options, parallel_axes, widths)).ok();
        found.map(|c| c.log_evidence).filter(|e| e.is_finite())
    };
    let first = evidence(&DEFAULT);
    let (mut chosen, mut best) = (DEFAULT, first.unwrap_or(f64::NEG_INFINITY));
    for _ in 0..CHANGES {
        let candidates: Vec<PriorWidths> = open
            .iter()
            .flat_map(|g| FACTORS.map(|factor| (*g, factor)))
            .filter(|(g, factor)| chosen[*g] != *factor)
            .map(|(g, factor)| {
                let mut widths = chosen;
                widths[g] = factor;
                widths
            })
            .collect();
        let found: Vec<Option<f64>> = candidates.par_iter().map(evidence).collect();
        let better = candidates
            .into_iter()
            .zip(found)
            .filter_map(|(widths, evidence)| Some((widths, evidence?)))
            .max_by(|a, b| a.1.total_cmp(&b.1));
        match better {
            Some((widths, evidence)) if evidence > best + MARGIN => (chosen, best) = (widths, evidence),
            _ => break,
        }
    }
    if chosen == DEFAULT {
        return (options.clone(), None);
    }
    let wide = widened(options, parallel_axes, &chosen);
    if let (Some(narrow), Some(wider)) = (held_out_mm(&some, options), held_out_mm(&some, &wide))
        && wider > narrow
    {
        return (options.clone(), None);
    }
    let words: Vec<String> = GROUPS
        .iter()
        .zip(chosen)
        .filter(|(_, factor)| *factor > 1.0)
        .map(|(group, factor)| format!("{} {:.1} {}", group.name, 1e3 * group.sigma * factor, group.unit))
        .collect();
    let gain = first.map_or(String::new(), |first| format!(" (ln gain {:.0})", best - first));
    let note = format!(
        "the evidence prefers wider priors{gain}: {} (1 sigma)",
        words.join(", ")
    );
    (wide, Some(note))
}
