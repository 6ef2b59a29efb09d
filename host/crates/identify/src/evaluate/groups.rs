//! The rows that are held out together: by a column of the data, by coupling, or by region of the joints.

use std::collections::{HashMap, HashSet};

use crate::course::Course;
use crate::holdout::regions;
use crate::{Recordings, Target};

/// Parts of the joint space that are held out in turn.
const REGIONS: usize = 4;

/// A hold-out that needs no column of the data.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Derived {
    /// Each coupling of the nest with a sphere: how well a visit is predicted by the others.
    Coupling,
    /// Each quarter of the rows along the direction in which the joints vary most: how well the model
    /// predicts poses that are unlike the others.
    Region,
}

impl Derived {
    /// By its name on the command line.
    pub(crate) fn of(column: &str) -> Option<Self> {
        match column.to_lowercase().as_str() {
            "coupling" => Some(Self::Coupling),
            "region" => Some(Self::Region),
            _ => None,
        }
    }

    /// The parts with their rows.
    pub(super) fn groups(self, recordings: &Recordings, used: &[usize]) -> Vec<(String, Vec<usize>)> {
        let experiment = &recordings.experiment;
        let (of, name): (Vec<usize>, &str) = match self {
            Self::Coupling => {
                let course = recordings.course.clone();
                (
                    course.unwrap_or_else(|| Course::in_order(experiment)).coupling,
                    "coupling",
                )
            }
            Self::Region => (regions(experiment, REGIONS), "region"),
        };
        let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
        for &i in used {
            let part = of.get(i).copied().unwrap_or_default();
            while groups.len() <= part {
                groups.push((format!("{name} {}", groups.len() + 1), Vec::new()));
            }
            groups[part].1.push(i);
        }
        groups.retain(|g| !g.1.is_empty());
        groups
    }
}

/// Takes those parts out of `groups` that hold all contacts with a sphere which fewer than three
/// others of its place hold: without them the plate's frame is free, and the figure would be that
/// of the frame. Returns their names.
pub(super) fn without_only_contacts(
    recordings: &Recordings,
    used: &[usize],
    groups: &mut Vec<(String, Vec<usize>)>,
) -> Vec<String> {
    let touched = |i: &usize| match recordings.experiment.observations.get(*i).map(|o| &o.target) {
        Some(&Target::Sphere { sphere, place }) => Some((place, sphere)),
        _ => None,
    };
    let mut only = Vec::new();
    groups.retain(|(name, out)| {
        let held: HashSet<usize> = out.iter().copied().collect();
        let rest: HashSet<(u32, u32)> = used.iter().filter(|i| !held.contains(i)).filter_map(touched).collect();
        let free = out.iter().filter_map(touched).any(|(place, sphere)| {
            !rest.contains(&(place, sphere)) && rest.iter().filter(|(p, _)| *p == place).count() < 3
        });
        if free {
            only.push(name.clone());
        }
        !free
    });
    only
}

/// The values of the hold-out column with their rows, in the order in which they appear.
pub(super) fn groups(recordings: &Recordings, used: &[usize]) -> Vec<(String, Vec<usize>)> {
    let mut groups: Vec<(String, Vec<usize>)> = Vec::new();
    let mut numbers: HashMap<u32, usize> = HashMap::new();
    for &i in used {
        let label = recordings.samples[i].label;
        let group = *numbers.entry(label).or_insert_with(|| {
            groups.push((recordings.labels.name(label).to_owned(), Vec::new()));
            groups.len() - 1
        });
        groups[group].1.push(i);
    }
    groups
}
