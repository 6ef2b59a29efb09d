//! Further targets and the measured body in the alignment: where they are on the tool with the nominal
//! geometry, and how far each row is from there.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::align::NominalFrames;
use crate::flange::Flange;
use crate::parts::rotation_vector;
use crate::start_targets::{in_flange, median_point, median_rotation};
use crate::targets::{further_targets, orientation_of, reference_of};
use crate::{Experiment, Observation, Set, Target};

/// A turn counts as the distance that it makes at this lever, in m: a hand's breadth.
const LEVER_M: f64 = 0.2;
/// Rows that the places are found from, spread evenly.
const PLACED: usize = 2000;

/// Adds the further targets and the measured body to an alignment: their places, and their distances to those of
/// the rows. A row counts with its largest distance, and is left out as a whole.
pub(super) fn add(aligned: &mut NominalFrames, experiment: &Experiment, flange: &Flange) {
    let calibrating = |o: &Observation| o.set == Set::Calibrate;
    let several = |o: &Observation| matches!(o.target, Target::Points(_) | Target::Frame(_));
    let rows: Vec<&Observation> = experiment
        .observations
        .iter()
        .filter(|o| calibrating(o) && several(o))
        .collect();
    let mut places: Vec<Vec<Vector3<f64>>> = Vec::new();
    let mut bodies = Vec::new();
    for o in rows.iter().step_by(rows.len().div_ceil(PLACED).max(1)) {
        let Some(base) = aligned.frame(reference_of(&o.target)) else {
            continue;
        };
        let at = flange.at(&o.q);
        for (number, point) in further_targets(&o.target) {
            if places.len() < number {
                places.resize(number, Vec::new());
            }
            places[number - 1].push(at.inverse_point(&base.inverse_point(&point)));
        }
        if let Some(measured) = orientation_of(&o.target) {
            bodies.push(in_flange(&at, base, &measured));
        }
    }
    if places.is_empty() && bodies.is_empty() {
        return;
    }
    aligned.targets_m = places.iter().map(|own| median_point(own)).collect();
    aligned.body = (!bodies.is_empty()).then(|| median_rotation(&bodies));
    let turns: Vec<f64> = bodies
        .iter()
        .filter_map(|own| Some(rotation_vector(&(own * aligned.body?.transpose())).norm()))
        .collect();
    aligned.median_turn_rad = middle(turns);
    let off = |index: usize| {
        let o = experiment.observations.get(index)?;
        let base = aligned.frame(reference_of(&o.target))?;
        let at = flange.at(&o.q);
        let points = further_targets(&o.target).filter_map(|(number, point)| {
            let place = aligned.targets_m.get(number - 1)?;
            Some((base.point(&at.point(place)) - point).norm())
        });
        let turn = orientation_of(&o.target).and_then(|measured| {
            let own: Matrix3<f64> = in_flange(&at, base, &measured);
            Some(LEVER_M * rotation_vector(&(own * aligned.body?.transpose())).norm())
        });
        points.chain(turn).reduce(f64::max)
    };
    let known: std::collections::HashMap<usize, f64> = aligned.distances_m.iter().copied().collect();
    let all: Vec<(usize, f64)> = experiment
        .observations
        .par_iter()
        .enumerate()
        .filter(|(_, o)| calibrating(o))
        .filter_map(|(index, _)| {
            let distance = [known.get(&index).copied(), off(index)]
                .into_iter()
                .flatten()
                .reduce(f64::max)?;
            Some((index, distance))
        })
        .collect();
    aligned.distances_m = all;
}

/// Middle of the values; none of none.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    let at = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, f64::total_cmp).1)
}
