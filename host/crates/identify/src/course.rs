//! In which order and in which coupling observations were made.
//!
//! Drift, slips and bad seats are functions of time and coupling; the estimator
//! itself needs neither.

use std::collections::HashMap;

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

    /// The course of some of the observations: `rows` are their numbers, in order.
    #[must_use]
    pub fn of_rows(&self, rows: &[usize]) -> Self {
        let mut numbers = HashMap::new();
        let coupling = rows.iter().map(|&row| {
            let next = numbers.len();
            *numbers.entry(self.coupling.get(row)).or_insert(next)
        });
        Self {
            coupling: coupling.collect(),
            time: rows
                .iter()
                .map(|&row| self.time.get(row).copied().unwrap_or(1.0))
                .collect(),
        }
    }

    /// Number of couplings.
    pub fn couplings(&self) -> usize {
        self.coupling.iter().max().map_or(0, |m| m + 1)
    }
}

#[cfg(test)]
mod tests {
    use super::Course;

    // Fails if couplings that lose all their rows leave gaps in the numbers, if two
    // couplings become one, or if a row gets the time of another.
    #[test]
    fn a_part_of_the_rows_keeps_couplings_and_times() {
        let course = Course {
            coupling: vec![0, 0, 1, 2, 2, 3],
            time: vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0],
        };
        let part = course.of_rows(&[1, 3, 4, 5]);
        assert_eq!(part.coupling, [0, 1, 1, 2]);
        assert_eq!(part.time, [0.2, 0.6, 0.8, 1.0]);
    }
}
