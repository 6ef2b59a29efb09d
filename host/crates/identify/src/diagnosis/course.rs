//! In which order and in which coupling observations were made.
//!
//! Drift, slips and bad seats are functions of time and coupling; the estimator
//! itself needs neither.

use spherecal_model::{Experiment, Target};

/// The course of an experiment: one entry per observation.
#[derive(Clone, Debug, PartialEq)]
pub struct Course {
    /// Number of the coupling (a nest put on a sphere once) in which each
    /// observation was made, from 0, in order of first appearance. Measured
    /// points have no coupling: all are in one.
    pub coupling: Vec<usize>,
    /// When each was made, as a share of the whole time, from 0 to 1.
    pub time: Vec<f64>,
}

impl Course {
    /// The course where only the order of the rows is known: rows on one sphere of
    /// one place that follow each other are one coupling.
    pub fn in_order(experiment: &Experiment) -> Self {
        let mut coupling = Vec::with_capacity(experiment.observations.len());
        let mut count = 0;
        let mut before = None;
        for observation in &experiment.observations {
            let now = match observation.target {
                Target::Sphere { sphere, place } => Some((sphere, place)),
                Target::Point(_) | Target::Points(_) | Target::Frame(_) => None,
            };
            if before.is_some_and(|b| b != now) {
                count += 1;
            }
            before = Some(now);
            coupling.push(count);
        }
        let last = experiment.observations.len().saturating_sub(1).max(1) as f64;
        Self {
            coupling,
            time: (0..experiment.observations.len()).map(|k| k as f64 / last).collect(),
        }
    }

    /// Number of couplings.
    pub fn couplings(&self) -> usize {
        self.coupling.iter().max().map_or(0, |m| m + 1)
    }
}
