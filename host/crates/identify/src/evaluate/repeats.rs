//! Rows that stand in the data more than once.
//!
//! Two measurements of one pose differ in their last digits. Rows that agree in
//! every bit are copies: they say nothing new, and a copy of a calibration row
//! judges nothing.

use std::collections::HashMap;

use spherecal_model::{Observation, Target};

/// The bits of a row: joint angles, and target.
fn key(observation: &Observation) -> Vec<u64> {
    let mut bits: Vec<u64> = observation.q.iter().map(|q| q.to_bits()).collect();
    let mut put = |values: &[f64]| bits.extend(values.iter().map(|v| v.to_bits()));
    match &observation.target {
        Target::Sphere { sphere, place } => put(&[f64::from(*sphere), f64::from(*place), 0.0]),
        Target::Point(point) => put(point),
        Target::Frame(pose) => {
            put(pose.position.as_slice());
            put(pose.rotation.as_slice());
        }
        Target::Points(points) => points.iter().flatten().for_each(|point| put(point)),
    }
    bits
}

/// Rows among `of` that repeat an earlier one: the copy, and what it repeats.
pub(super) fn copies<'a>(of: impl IntoIterator<Item = (usize, &'a Observation)>) -> Vec<(usize, usize)> {
    let mut first: HashMap<Vec<u64>, usize> = HashMap::new();
    let mut copies = Vec::new();
    for (i, observation) in of {
        match first.entry(key(observation)) {
            std::collections::hash_map::Entry::Occupied(known) => copies.push((i, *known.get())),
            std::collections::hash_map::Entry::Vacant(free) => {
                free.insert(i);
            }
        }
    }
    copies
}
