//! Causes that show in how the residuals depend on the last move, on the place, on the load and on
//! the orientation of the tool.

use std::collections::BTreeMap;

use nalgebra::{DMatrix, DVector, Vector3};

use super::alternatives::Alternative;
use super::linear::{Linear, LinearRow};
use super::payload::LoadEffects;
use crate::course::Course;
use crate::parameters::Layout;

/// A joint that moved by less than this (rad) came from neither side.
const MOVED_RAD: f64 = 1e-3;
/// Fewest rows of a place, and of the others.
const FEWEST: usize = 3;
/// Fewest rows with a known last move for each unknown of the regression on where the joint stands.
const MOVES_PER_UNKNOWN: usize = 3;
/// What a move is compared with: 1, q, and harmonics 1 and 2 of the joint.
const WHERE: usize = 6;

/// All of these causes that the data could show, with their whitened columns.
pub(crate) fn patterns(
    linear: &Linear,
    layout: &Layout,
    course: &Course,
    loaded: Option<&LoadEffects<'_>>,
) -> Vec<(Alternative, DMatrix<f64>)> {
    let mut list = Vec::new();
    last_move(linear, layout, course, &mut list);
    places(linear, layout, course, &mut list);
    if let Some(loaded) = loaded {
        list.push((Alternative::Payload, one(loaded.column(linear))));
    }
    list
}

fn one(column: DVector<f64>) -> DMatrix<f64> {
    DMatrix::from_columns(&[column])
}

/// The last move of joint `j` before each row, less what follows from where the joint stands.
///
/// A joint that stands high mostly came from below. So a move goes along with any error that depends on
/// the joint's angle. What is left of it after a regression on that angle does not.
fn surprise(linear: &Linear, course: &Course, j: usize, of: impl Fn(f64) -> f64) -> Option<Vec<f64>> {
    let moved = |p: &LinearRow| course.moves.get(p.index)?.as_ref()?.get(j).copied();
    let stands = |p: &LinearRow| {
        let q = p.posture.q[j];
        let (s, c) = q.sin_cos();
        [1.0, q, s, c, 2.0 * s * c, c * c - s * s]
    };
    let known: Vec<(usize, [f64; WHERE], f64)> = linear
        .rows
        .iter()
        .enumerate()
        .filter_map(|(k, p)| Some((k, stands(p), of(moved(p)?))))
        .collect();
    if known.len() < MOVES_PER_UNKNOWN * WHERE {
        return None;
    }
    let a = DMatrix::from_fn(known.len(), WHERE, |r, c| known[r].1[c]);
    let b = DVector::from_iterator(known.len(), known.iter().map(|k| k.2));
    let fitted = a.clone().svd(true, true).solve(&b, 1e-9).ok()?;
    let rest = b - a * fitted;
    let mut out = vec![0.0; linear.rows.len()];
    for ((k, ..), value) in known.iter().zip(rest.iter()) {
        out[*k] = *value;
    }
    Some(out)
}

/// Readings that lag, and backlash.
fn last_move(linear: &Linear, layout: &Layout, course: &Course, list: &mut Vec<(Alternative, DMatrix<f64>)>) {
    let mut all: Option<DVector<f64>> = None;
    let along = |j: usize, by: &[f64]| {
        let mut by = by.iter();
        linear.column(|p| p.posture.joints[j] * by.next().copied().unwrap_or_default())
    };
    for joint in 0..layout.n {
        // The arm came to rest further along its move than the angle says.
        if let Some(by) = surprise(linear, course, joint, |moved| moved) {
            let column = along(joint, &by);
            all = Some(all.map_or_else(|| column.clone(), |all| all + &column));
            list.push((Alternative::Lag { joint: Some(joint) }, one(column)));
        }
        let side = |moved: f64| {
            if moved.abs() > MOVED_RAD {
                0.5 * moved.signum()
            } else {
                0.0
            }
        };
        if let Some(by) = surprise(linear, course, joint, side) {
            list.push((Alternative::Backlash { joint }, one(along(joint, &by))));
        }
    }
    if let Some(all) = all.filter(|_| layout.n > 1) {
        list.push((Alternative::Lag { joint: None }, one(all)));
    }
}

/// Measured points of one place, and one sphere in one placement, that are off as a whole.
fn places(linear: &Linear, layout: &Layout, course: &Course, list: &mut Vec<(Alternative, DMatrix<f64>)>) {
    let place = |p: &LinearRow| course.place.get(p.index).copied();
    let mut groups: BTreeMap<(u32, Option<usize>), usize> = BTreeMap::new();
    let mut totals: BTreeMap<Option<usize>, usize> = BTreeMap::new();
    for p in &linear.rows {
        let Some(place) = place(p) else { return };
        *groups.entry((place, p.sphere)).or_default() += 1;
        *totals.entry(p.sphere).or_default() += 1;
    }
    for (&(at, sphere), &count) in &groups {
        let others = totals.get(&sphere).copied().unwrap_or_default() - count;
        if count < FEWEST || others < FEWEST {
            continue;
        }
        let columns: Vec<DVector<f64>> = (0..3)
            .map(|axis| {
                linear.column(|p| {
                    if place(p) == Some(at) && p.sphere == sphere {
                        // `y` is target minus model; a target that is off by e adds Rᵀ e to it.
                        p.rotation.row(axis).transpose()
                    } else {
                        Vector3::zeros()
                    }
                })
            })
            .collect();
        let sphere = sphere.and_then(|s| layout.spheres.get(s).copied());
        list.push((
            Alternative::Place { place: at, sphere },
            DMatrix::from_columns(&columns),
        ));
    }
}
