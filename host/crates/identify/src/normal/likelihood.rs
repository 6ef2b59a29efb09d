//! Whitened residuals and their likelihood.

use nalgebra::{Matrix3, Vector3};
use rayon::prelude::*;

use super::groups::{BLOCK, Group, places};
use super::pose_columns::PoseColumns;
use super::whitening::{Conditional, Root, Whitening};
use crate::chain::{N, Prepared, State};
use crate::noise_scale::Squared;
use crate::parameters::Layout;
use crate::seen::RowPart;

/// One target's whitened residual and what whitened it.
pub(crate) struct WhitenedTarget {
    /// Whitener of a vector in F0, robust weight included.
    pub(crate) root: Root,
    /// Factors on the whitened vectors of the row's earlier targets: see [`Conditional`].
    pub(crate) factors: Vec<Matrix3<f64>>,
    /// Whitened residual.
    pub(crate) residual: Vector3<f64>,
}

/// The whitened columns of each target of an observation over the whole layout, and its residual, for
/// `put`; orientations are left out. Each target is whitened given those before it.
pub(crate) fn whitened_rows(
    state: &State,
    layout: &Layout,
    observation: &Prepared,
    whitening: &Whitening,
    weight: f64,
    mut put: impl FnMut(WhitenedTarget, &[Vector3<f64>]),
) {
    let group = Group {
        reference: observation.reference,
        sphere: observation.sphere,
        seat: observation.seat,
        members: Vec::new(),
    };
    let places = places(layout, &group);
    let mut blocks = state.blocks(layout.n, observation).into_iter();
    let mut before: Vec<Vec<Vector3<f64>>> = Vec::new();
    let mut all = vec![Vector3::zeros(); layout.len()];
    PoseColumns::each(state, layout, observation, whitening, weight, |pose| {
        let Some(block) = blocks.next().filter(|b| b.part != RowPart::Body) else {
            return;
        };
        all.fill(Vector3::zeros());
        for &(c, column, sign) in &places {
            all[column] = pose.own[c] * sign;
        }
        let mut phi = vec![0.0; layout.n * layout.basis()];
        pose.bases(layout, observation, phi.chunks_exact_mut(layout.basis()));
        for (j, phi) in phi.chunks_exact(layout.basis()).enumerate() {
            for (k, value) in phi.iter().enumerate() {
                all[layout.joint(j) + k] = pose.joints[j] * *value;
            }
        }
        let own = if before.is_empty() {
            whitening.leading(observation, block.sight)
        } else {
            whitening.own(block.part, block.sight)
        };
        let mut shared = whitening.shared(&block.joints[..layout.n], block.arm);
        let given = Conditional::new(whitening, &own, &shared, before.iter().map(Vec::as_slice));
        for (c, column) in shared.iter_mut().enumerate() {
            *column = given.times(column, before.iter().map(|before| before[c]));
        }
        before.push(shared);
        let row = WhitenedTarget {
            root: given.root.scaled(weight.sqrt()),
            factors: given.factors.iter().map(|factor| factor / weight.sqrt()).collect(),
            residual: pose.residual,
        };
        put(row, &all);
    });
}

/// The columns of each part of an observation over the whole layout, in F0 and not whitened, for `put`.
pub(crate) fn plain_columns(
    state: &State,
    layout: &Layout,
    observation: &Prepared,
    mut put: impl FnMut(usize, &[Vector3<f64>]),
) {
    let group = Group {
        reference: observation.reference,
        sphere: observation.sphere,
        seat: observation.seat,
        members: Vec::new(),
    };
    let places = places(layout, &group);
    let mut all = vec![Vector3::zeros(); layout.len()];
    let mut phi = vec![0.0; layout.n * layout.basis()];
    let mut part = 0;
    PoseColumns::each(state, layout, observation, &Whitening::NONE, 1.0, |pose| {
        all.fill(Vector3::zeros());
        for &(c, column, sign) in &places {
            all[column] = pose.own[c] * sign;
        }
        pose.bases(layout, observation, phi.chunks_exact_mut(layout.basis()));
        for (j, phi) in phi.chunks_exact(layout.basis()).enumerate() {
            for (k, value) in phi.iter().enumerate() {
                all[layout.joint(j) + k] = pose.joints[j] * *value;
            }
        }
        put(part, &all);
        part += 1;
    });
}

/// Squared whitened residual of every prepared observation, all parts of the row together.
pub(crate) fn distances(state: &State, layout: &Layout, prepared: &[Prepared], whitening: &Whitening) -> Vec<Squared> {
    let [found] = whitened(state, layout, prepared, &[*whitening]).map(|found| found.0);
    found
}

/// Squared whitened residuals under each whitening, and the sum of `ln |L⁻¹|`.
fn whitened<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening; K],
) -> [(Vec<Squared>, f64); K] {
    let block = |prepared: &[Prepared]| {
        let mut columns = [Vector3::zeros(); N];
        let mut found: [(Vec<Squared>, f64); K] = core::array::from_fn(|_| (Vec::with_capacity(prepared.len()), 0.0));
        for observation in prepared {
            let k = state.at(observation);
            for j in 0..layout.n {
                columns[j] = k.frames[j].z().cross(&(k.tcp - k.frames[j].position));
            }
            let residual = state.residual(observation, &k.tcp);
            let further = if observation.further.is_empty() {
                Vec::new()
            } else {
                state.further(layout.n, observation, &k)
            };
            let sight = state.sight(observation, &observation.target);
            let arm = observation.has_several().then(Vector3::zeros);
            for (candidate, (rows, log)) in candidates.iter().zip(&mut found) {
                let own = candidate.leading(observation, sight);
                if further.is_empty() {
                    let root = Root::new(&candidate.covariance(&columns[..layout.n], &own));
                    *log += root.log_determinant();
                    let d2 = root.times(&residual).norm_squared();
                    rows.push(Squared { d2, numbers: 3.0 });
                    continue;
                }
                let shared = candidate.shared(&columns[..layout.n], arm);
                let root = Root::new(&candidate.covariance(&shared, &own));
                let residual = root.times(&residual);
                let white = shared.iter().map(|column| root.times(column)).collect();
                let rest = candidate.further_parts(layout.n, white, residual, &further);
                let d2 = residual.norm_squared() + rest.0;
                *log += root.log_determinant() + rest.1;
                rows.push(Squared {
                    d2,
                    numbers: observation.numbers(),
                });
            }
        }
        found
    };
    let add = |mut total: [(Vec<Squared>, f64); K], next: [(Vec<Squared>, f64); K]| {
        for (total, next) in total.iter_mut().zip(next) {
            total.0.extend(next.0);
            total.1 += next.1;
        }
        total
    };
    let blocks: Vec<_> = prepared.par_chunks(BLOCK).map(block).collect();
    blocks.into_iter().reduce(add).unwrap_or_else(|| block(&[]))
}

/// Sum of `ln |L⁻¹|` over all rows.
pub(crate) fn log_determinant(state: &State, layout: &Layout, prepared: &[Prepared], whitening: &Whitening) -> f64 {
    let [(_, log)] = whitened(state, layout, prepared, &[*whitening]);
    log
}
