//! Some of an experiment's rows.

use std::borrow::Cow;
use std::collections::HashMap;

use crate::targets::reference_of;
use crate::{Experiment, Reference, Target};

/// The experiment with only the named rows; the experiment itself where they are all.
pub(super) fn only<'a>(experiment: &'a Experiment, keep: &[usize]) -> Cow<'a, Experiment> {
    if keep.len() == experiment.observations.len() && keep.iter().enumerate().all(|(k, i)| k == *i) {
        return Cow::Borrowed(experiment);
    }
    let observations = keep.iter().filter_map(|&i| experiment.observations.get(i).cloned());
    Cow::Owned(Experiment {
        robot: experiment.robot.clone(),
        tool: experiment.tool,
        spheres: experiment.spheres.clone(),
        observations: observations.collect(),
    })
}

/// At most `most` of the rows, spread evenly over each sphere and place.
pub(super) fn thinned(experiment: &Experiment, rows: &[usize], most: usize) -> Vec<usize> {
    let step = rows.len().div_ceil(most).max(1);
    let mut seen: HashMap<(Reference, Option<u32>), usize> = HashMap::new();
    let mut keep = rows.to_vec();
    keep.retain(|&i| {
        let Some(target) = experiment.observations.get(i).map(|o| &o.target) else {
            return false;
        };
        let sphere = match target {
            Target::Sphere { sphere, .. } => Some(*sphere),
            _ => None,
        };
        let count = seen.entry((reference_of(target), sphere)).or_default();
        *count += 1;
        (*count - 1).is_multiple_of(step)
    });
    keep
}
