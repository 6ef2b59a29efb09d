//! Whitened residuals and their likelihood.

use nalgebra::Vector3;
use rayon::prelude::*;

use super::groups::{BLOCK, Group, places};
use super::pose_columns::PoseColumns;
use super::whitening::{Root, Whitening};
use crate::chain::{N, Prepared, State};
use crate::parameters::Layout;

/// One observation's whitened residual and what whitened it.
pub(crate) struct Row {
    /// Whitener of a vector in F0, robust weight included.
    pub(crate) root: Root,
    /// Whitened residual.
    pub(crate) residual: Vector3<f64>,
}

/// The whitened columns of one observation over the whole layout, into `all`,
/// and its residual.
pub(crate) fn whitened_row(
    state: &State,
    layout: &Layout,
    observation: &Prepared,
    whitening: &Whitening,
    weight: f64,
    all: &mut [Vector3<f64>],
) -> Row {
    let pose = PoseColumns::new(state, layout, observation, whitening, weight);
    all.fill(Vector3::zeros());
    let group = Group {
        reference: observation.reference,
        sphere: observation.sphere,
        members: Vec::new(),
    };
    for (c, column, sign) in places(layout, &group) {
        all[column] = pose.own[c] * sign;
    }
    let mut phi = vec![0.0; layout.n * layout.basis()];
    pose.bases(layout, observation, phi.chunks_exact_mut(layout.basis()));
    for (j, phi) in phi.chunks_exact(layout.basis()).enumerate() {
        for (k, value) in phi.iter().enumerate() {
            all[layout.joint(j) + k] = pose.joints[j] * *value;
        }
    }
    let k = state.at(observation);
    let joints: Vec<_> = (0..layout.n)
        .map(|j| k.frames[j].z().cross(&(k.tcp - k.frames[j].position)))
        .collect();
    let covariance = whitening.covariance(&joints, observation.sphere.is_some());
    Row {
        root: Root::new(&covariance).scaled(weight.sqrt()),
        residual: pose.residual,
    }
}

/// Squared whitened residual of every prepared observation.
pub(crate) fn distances(state: &State, layout: &Layout, prepared: &[Prepared], whitening: &Whitening) -> Vec<f64> {
    let [found] = whitened(state, layout, prepared, &[*whitening]).map(|found| found.0);
    found
}

/// Squared whitened residuals under each whitening, and the sum of `ln |L⁻¹|`.
fn whitened<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening; K],
) -> [(Vec<f64>, f64); K] {
    let block = |prepared: &[Prepared]| {
        let mut columns = [Vector3::zeros(); N];
        let mut found: [(Vec<f64>, f64); K] = core::array::from_fn(|_| (Vec::with_capacity(prepared.len()), 0.0));
        for observation in prepared {
            let k = state.at(observation);
            for j in 0..layout.n {
                columns[j] = k.frames[j].z().cross(&(k.tcp - k.frames[j].position));
            }
            let residual = state.residual(observation, &k.tcp);
            for (candidate, (d2, log)) in candidates.iter().zip(&mut found) {
                let root = Root::new(&candidate.covariance(&columns[..layout.n], observation.sphere.is_some()));
                d2.push(root.times(&residual).norm_squared());
                *log += root.log_determinant();
            }
        }
        found
    };
    let add = |mut total: [(Vec<f64>, f64); K], next: [(Vec<f64>, f64); K]| {
        for (total, next) in total.iter_mut().zip(next) {
            total.0.extend(next.0);
            total.1 += next.1;
        }
        total
    };
    let blocks: Vec<_> = prepared.par_chunks(BLOCK).map(block).collect();
    blocks.into_iter().reduce(add).unwrap_or_else(|| block(&[]))
}

/// Log likelihood of the residuals under each candidate whitening, its scale at
/// its own best; `nu` as in the estimator.
pub(crate) fn likelihoods<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    candidates: &[Whitening; K],
    nu: f64,
) -> [f64; K] {
    whitened(state, layout, prepared, candidates).map(|(d2, log)| likelihood(&d2, log, nu))
}

/// The same under one whitening for each of several `nus`.
pub(crate) fn likelihoods_of_tails<const K: usize>(
    state: &State,
    layout: &Layout,
    prepared: &[Prepared],
    whitening: &Whitening,
    nus: [f64; K],
) -> [f64; K] {
    let [(d2, log)] = whitened(state, layout, prepared, &[*whitening]);
    nus.map(|nu| likelihood(&d2, log, nu))
}

/// Log likelihood of squared whitened residuals, the scale at its best.
fn likelihood(d2: &[f64], log: f64, nu: f64) -> f64 {
    let shape = |d: f64, s2: f64| {
        if nu > 0.0 {
            -0.5 * (nu + 3.0) * (d / (s2 * nu)).ln_1p()
        } else {
            -0.5 * d / s2
        }
    };
    let s2 = crate::noise_scale::scale(d2, 0.0, nu, 1.0);
    log + d2.iter().map(|d| shape(*d, s2)).sum::<f64>() - 1.5 * d2.len() as f64 * s2.ln()
}
