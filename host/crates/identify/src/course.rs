//! In which order and in which coupling observations were made.
//!
//! Drift, slips and bad seats are functions of time and coupling; the estimator
//! itself needs neither.

use std::collections::HashMap;

use spherecal_model::{Experiment, Observation, Target};

/// The course of an experiment: one entry per observation.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Number of the coupling (a nest put on a sphere once) in which each
    /// observation was made, from 0, in order of first appearance. Measured
    /// points have no coupling: all are in one.
    pub coupling: Vec<usize>,
    /// When each was made, as a share of the whole time, from 0 to 1.
    pub time: Vec<f64>,
    /// The last move before each observation, in rad by joint; none where it is not known:
    /// before the first observation of a coupling the arm came from above the sphere.
    pub moves: Vec<Option<Vec<f64>>>,
    /// Where each was made, as a number in [`Self::place_names`]: the placement of the plate, or
    /// the group of points that a column of the table names. Empty where there is one place.
    pub place: Vec<u32>,
    /// Names of the places.
    pub place_names: Vec<String>,
}

impl Course {
    /// The course where only the order of the rows is known: rows on one sphere of
    /// one place that follow each other are one coupling.
    pub fn in_order(experiment: &Experiment) -> Self {
        Self::without_moves(experiment).with_moves(&experiment.observations)
    }

    /// As [`Self::in_order`], without the last moves.
    pub(crate) fn without_moves(experiment: &Experiment) -> Self {
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
            ..Self::default()
        }
    }

    /// The same with the last moves, where the observations stand in the order in which they were made.
    #[must_use]
    pub fn with_moves(mut self, observations: &[Observation]) -> Self {
        self.moves = (0..observations.len())
            .map(|row| self.last_move(observations, row))
            .collect();
        self
    }

    /// As [`Self::with_moves`], for some of the observations: `rows` are their numbers.
    #[must_use]
    pub(crate) fn with_moves_of(mut self, observations: &[Observation], rows: &[usize]) -> Self {
        self.moves = vec![None; observations.len()];
        for &row in rows {
            let last = self.last_move(observations, row);
            if let Some(slot) = self.moves.get_mut(row) {
                *slot = last;
            }
        }
        self
    }

    /// The move from the observation before `row`, in rad by joint, where it is known.
    fn last_move(&self, observations: &[Observation], row: usize) -> Option<Vec<f64>> {
        let before = row.checked_sub(1)?;
        let (from, to) = (&observations.get(before)?.q, &observations.get(row)?.q);
        let known = self.coupling.get(before)? == self.coupling.get(row)? && from.len() == to.len();
        known.then(|| to.iter().zip(from).map(|(to, from)| to - from).collect())
    }

    /// The same with places: a number by observation, and their names by number.
    #[must_use]
    pub fn with_places(mut self, place: Vec<u32>, names: Vec<String>) -> Self {
        (self.place, self.place_names) = (place, names);
        self
    }

    /// Name of a place for people.
    pub(crate) fn place_name(&self, place: u32) -> String {
        match self.place_names.get(place as usize) {
            Some(name) if !name.is_empty() => format!("place {name}"),
            _ => format!("place {place}"),
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
            moves: rows.iter().map(|&row| self.moves.get(row).cloned().flatten()).collect(),
            place: rows.iter().filter_map(|&row| self.place.get(row).copied()).collect(),
            place_names: self.place_names.clone(),
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
    use spherecal_model::{Observation, Set, Target};

    // Fails if couplings that lose all their rows leave gaps in the numbers, if two
    // couplings become one or if a row gets the time or the move of another.
    #[test]
    fn a_part_of_the_rows_keeps_couplings_and_times() {
        let course = Course {
            coupling: vec![0, 0, 1, 2, 2, 3],
            time: vec![0.0, 0.2, 0.4, 0.6, 0.8, 1.0],
            ..Course::default()
        };
        let observation = |k: usize| Observation {
            seat: None,
            q: vec![k as f64 * k as f64],
            tau: None,
            target: Target::Point([0.0; 3]),
            set: Set::Calibrate,
        };
        let observations: Vec<Observation> = (0..6).map(observation).collect();
        let part = course.with_moves(&observations).of_rows(&[1, 3, 4, 5]);
        assert_eq!(part.coupling, [0, 1, 1, 2]);
        assert_eq!(part.time, [0.2, 0.6, 0.8, 1.0]);
        // Row 1 moved from row 0, row 4 from row 3; rows 3 and 5 began a coupling.
        assert_eq!(part.moves, [Some(vec![1.0]), None, Some(vec![7.0]), None]);
    }
}
