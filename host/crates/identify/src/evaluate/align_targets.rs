//! Further targets and the measured body in the alignment: where they are on the tool with the nominal
//! geometry, and how far each row is from there.

use std::collections::BTreeMap;

use nalgebra::{Matrix3, Vector3};

use crate::flange::Flange;
use crate::parts::rotation_vector;
use crate::start_targets::{in_flange, median_point, median_rotation};
use crate::targets::{further_targets, orientation_of, reference_of};
use crate::{Experiment, Observation, Pose, Reference, Set, Target};

/// A turn counts as the distance that it makes at this lever, in m: a hand's breadth.
const LEVER_M: f64 = 0.2;
/// Rows that the places are found from, spread evenly.
const PLACED: usize = 2000;

/// Further targets and the measured body on the tool.
#[derive(Default)]
pub(super) struct TargetsOnTool {
    /// Targets 2.. in the last frame of the table, in m.
    pub(super) targets_m: Vec<Vector3<f64>>,
    /// Orientation of the measured body in the last frame of the table.
    pub(super) body: Option<Matrix3<f64>>,
    /// Median turn of the measured body against the flange, in rad.
    pub(super) median_turn_rad: Option<f64>,
}

/// Finds them with F0 in its `frames`, and adds their distances (m) to those of the rows: a row counts with its largest
/// distance, and is left out as a whole.
pub(super) fn place(
    experiment: &Experiment,
    flange: &Flange,
    frames: &[(Reference, Pose)],
    distances_m: &mut Vec<(usize, f64)>,
) -> TargetsOnTool {
    let frame = |target: &Target| {
        let reference = reference_of(target);
        frames.iter().find(|(r, _)| *r == reference).map(|(_, pose)| pose)
    };
    let several = |o: &Observation| matches!(o.target, Target::Points(_) | Target::Frame(_));
    let rows: Vec<(usize, &Observation)> = experiment
        .observations
        .iter()
        .enumerate()
        .filter(|(_, o)| o.set == Set::Calibrate && several(o))
        .collect();
    let mut places: Vec<Vec<Vector3<f64>>> = Vec::new();
    let mut bodies = Vec::new();
    for (_, o) in rows.iter().step_by(rows.len().div_ceil(PLACED).max(1)) {
        let Some(base) = frame(&o.target) else { continue };
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
        return TargetsOnTool::default();
    }
    let targets_m: Vec<Vector3<f64>> = places.iter().map(|own| median_point(own)).collect();
    let body = (!bodies.is_empty()).then(|| median_rotation(&bodies));
    let turn = |own: &Matrix3<f64>| Some(rotation_vector(&(own * body?.transpose())).norm());
    let median_turn_rad = middle(bodies.iter().filter_map(turn).collect());
    let off = |o: &Observation| {
        let base = frame(&o.target)?;
        let at = flange.at(&o.q);
        let points = further_targets(&o.target).filter_map(|(number, point)| {
            let place = targets_m.get(number - 1)?;
            Some((base.point(&at.point(place)) - point).norm())
        });
        let measured = orientation_of(&o.target);
        let turned = measured.and_then(|measured| Some(LEVER_M * turn(&in_flange(&at, base, &measured))?));
        points.chain(turned).reduce(f64::max)
    };
    let mut all: BTreeMap<usize, f64> = distances_m.drain(..).collect();
    for (index, o) in rows {
        if let Some(distance) = off(o) {
            let slot = all.entry(index).or_insert(distance);
            *slot = slot.max(distance);
        }
    }
    distances_m.extend(all);
    TargetsOnTool {
        targets_m,
        body,
        median_turn_rad,
    }
}

/// Middle of the values; none of none.
fn middle(mut values: Vec<f64>) -> Option<f64> {
    let at = values.len() / 2;
    (!values.is_empty()).then(|| *values.select_nth_unstable_by(at, f64::total_cmp).1)
}
