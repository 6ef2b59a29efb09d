//! Rows that stand in the data more than once.
//!
//! Two measurements of one pose differ in their last digits. Rows that agree in
//! every bit are copies: they say nothing new, and a copy of a calibration row
//! judges nothing.

use std::collections::HashMap;
use std::collections::hash_map::Entry;
use std::hash::{BuildHasher as _, RandomState};

use rayon::prelude::*;
use spherecal_model::{Observation, Target};

/// The bits of a row: joint angles, and target.
fn key(observation: &Observation, bits: &mut Vec<u64>) {
    bits.clear();
    bits.extend(observation.q.iter().map(|q| q.to_bits()));
    let mut put = |values: &[f64]| bits.extend(values.iter().map(|v| v.to_bits()));
    match &observation.target {
        Target::Sphere { sphere, place } => put(&[f64::from(*sphere), f64::from(*place), 0.0]),
        Target::Point(point) => put(point),
        Target::Frame(pose) => {
            put(pose.position.as_slice());
            put(pose.rotation.as_slice());
        }
        Target::Points(points) => points.iter().for_each(|point| put(&point.unwrap_or([f64::NAN; 3]))),
    }
}

/// Rows among `of` that repeat an earlier one: the copy, and what it repeats.
pub(super) fn copies(of: &[(usize, &Observation)]) -> Vec<(usize, usize)> {
    let state = RandomState::new();
    let hash = |bits: &mut Vec<u64>, (place, (_, observation)): (usize, &(usize, &Observation))| {
        key(observation, bits);
        (state.hash_one(&*bits), place)
    };
    let mut hashes: Vec<(u64, usize)> = of.par_iter().enumerate().map_init(Vec::new, hash).collect();
    hashes.par_sort_unstable();
    let mut copies = Vec::new();
    for equal in hashes.chunk_by(|a, b| a.0 == b.0).filter(|equal| equal.len() > 1) {
        // Rows of one hash differ only by chance.
        let mut first: HashMap<Vec<u64>, usize> = HashMap::new();
        for &(_, place) in equal {
            let (row, observation) = of[place];
            let mut bits = Vec::new();
            key(observation, &mut bits);
            match first.entry(bits) {
                Entry::Occupied(known) => copies.push((place, row, *known.get())),
                Entry::Vacant(free) => {
                    free.insert(row);
                }
            }
        }
    }
    copies.sort_unstable();
    copies.into_iter().map(|(_, copy, of)| (copy, of)).collect()
}
