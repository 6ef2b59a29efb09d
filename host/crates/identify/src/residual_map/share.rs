//! What a map does over the workspace, and its share in the error that is left.

use nalgebra::{DMatrix, Matrix3, SymmetricEigen, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use rand_distr::{Distribution as _, StandardNormal};
use serde::Serialize;

use super::{MapFrame, ResidualMap, coordinates, kernel, squared};
use crate::Calibration;
use crate::diagnosis::{Rigid, Size};
use crate::expected_error::ExpectedError;
use crate::flange::Flange;

/// Robots and maps drawn.
const DRAWS: usize = 200;
/// Share of the amplitude's variance below which a map knows a pose.
const KNOWN: f64 = 0.5;

/// A map over the workspace.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct MapShare {
    /// Mean length of the correction, in mm.
    pub correction_mm: f64,
    /// Largest, in mm.
    pub largest_mm: f64,
    /// Mean standard deviation of the correction by the map (root of the summed variances), in mm.
    pub sigma_mm: f64,
    /// Share of the workspace where the data take at least half of the map's variance away; elsewhere the map
    /// says little and corrects little.
    pub known: f64,
    /// Error of the TCP with the map, if the map describes what the model leaves out: from the uncertainties of
    /// the parameters, of the joints in one pose, and of the map. What the map takes off the residuals is no
    /// longer noise to the first two.
    pub expected_error_mm: ExpectedError,
    /// Share of the map's own uncertainty in the mean square of that error.
    pub of_map: f64,
}

/// A column of standard normal numbers.
fn white(random: &mut ChaCha8Rng, n: usize) -> DMatrix<f64> {
    DMatrix::from_fn(n, 1, |_, _| StandardNormal.sample(random))
}

/// A matrix whose product with its transpose is the covariance; rounding below zero counts as zero.
fn root(covariance: DMatrix<f64>) -> DMatrix<f64> {
    let eigen = SymmetricEigen::new(covariance);
    let scale = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
    eigen.eigenvectors * DMatrix::from_diagonal(&scale)
}

/// [`root`] of the covariance of parameters, if the noise of the data had `share` of its variance: what the data
/// say of them then counts more, and their priors as before.
fn root_with_less_noise(covariance: DMatrix<f64>, priors: &[f64], share: f64) -> DMatrix<f64> {
    let mut scaled = covariance;
    for (j, one) in priors.iter().enumerate() {
        for (i, other) in priors.iter().enumerate() {
            scaled[(i, j)] /= one * other;
        }
    }
    // In units of the priors the information is that of the data, and 1.
    let eigen = SymmetricEigen::new(scaled);
    let scale = eigen.eigenvalues.map(|v| {
        let of_data = (1.0 / v.clamp(f64::MIN_POSITIVE, 1.0) - 1.0) / share;
        (1.0 + of_data).powf(-0.5)
    });
    let mut root = eigen.eigenvectors * DMatrix::from_diagonal(&scale);
    for (mut row, sigma) in root.row_iter_mut().zip(priors) {
        row *= *sigma;
    }
    root
}

impl MapShare {
    /// Over `configurations` (joint angles, rad); none where the calibration has no covariance.
    pub(crate) fn of(map: &ResidualMap, calibration: &Calibration, configurations: &[Vec<f64>]) -> Option<Self> {
        let count = configurations.len();
        let flange = Flange::new(&calibration.robot);
        let rotations: Vec<Matrix3<f64>> = configurations.iter().map(|q| flange.at(q).rotation).collect();
        let poses = || rotations.iter().zip(configurations);
        let shifts: Vec<f64> = poses().map(|(r, q)| map.shift(r, q).norm() * 1e3).collect();
        let data = map.data();
        // Covariance of one coordinate of the map over the configurations.
        let at: Vec<Vec<f64>> = poses().map(|(r, q)| coordinates(data.input, r, q)).collect();
        let kernels: Vec<_> = poses().map(|(r, q)| map.kernels(r, q)).collect();
        let before = DMatrix::from_fn(count, count, |i, j| kernel(squared(&at[i], &at[j]), data.length));
        let left = before - map.explained(&DMatrix::from_columns(&kernels));
        let known = left.diagonal().iter().filter(|v| **v < KNOWN).count();
        let sigma = left.diagonal().map(|v| data.amplitude_m * (3.0 * v.max(0.0)).sqrt());
        let of_map = root(left * data.amplitude_m.powi(2));
        // The parameters, and the joints of each pose, in the axes of F0.
        let (columns, covariance, priors) = calibration.spread_in_base(configurations);
        if count == 0 || covariance.is_empty() || covariance.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let turn = calibration.base.rotation.transpose();
        let quieter = map.noise_share();
        let joints: Vec<DMatrix<f64>> = configurations
            .iter()
            .enumerate()
            .map(|(k, q)| {
                let rows = columns.rows(3 * k, 3);
                let parameters = rows * &covariance * rows.transpose();
                let all = calibration.tcp_covariance_in_base(q);
                root(DMatrix::from_fn(3, 3, |i, j| {
                    quieter * (all[(i, j)] - parameters[(i, j)])
                }))
            })
            .collect();
        let parameters = columns * root_with_less_noise(covariance, &priors, quieter);
        let points: Vec<Vector3<f64>> = configurations.iter().map(|q| calibration.tcp_m(q, None)).collect();
        let rigid = Rigid::new(&points);
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let (mut means, mut p95) = (Vec::with_capacity(DRAWS), Vec::with_capacity(DRAWS));
        let mut squares = [0.0; 2];
        for _ in 0..DRAWS {
            let mut model = &parameters * white(&mut random, parameters.ncols());
            let mapped = [0; 3].map(|_| &of_map * white(&mut random, count));
            let mut own = DMatrix::zeros(3 * count, 1);
            for k in 0..count {
                let pose = model.rows(3 * k, 3) + &joints[k] * white(&mut random, 3);
                let pose = turn * Vector3::new(pose[0], pose[1], pose[2]);
                let shift = Vector3::new(mapped[0][k], mapped[1][k], mapped[2][k]);
                let shift = match data.frame {
                    MapFrame::Tool => rotations[k] * shift,
                    MapFrame::Base => shift,
                };
                for axis in 0..3 {
                    model[(3 * k + axis, 0)] = pose[axis];
                    own[(3 * k + axis, 0)] = shift[axis];
                }
            }
            rigid.remove(&mut model);
            rigid.remove(&mut own);
            squares[0] += own.norm_squared();
            squares[1] += model.norm_squared();
            let all = model + own;
            let mut lengths: Vec<f64> = all
                .as_slice()
                .chunks_exact(3)
                .map(|v| Vector3::from_column_slice(v).norm())
                .collect();
            means.push(lengths.iter().sum::<f64>() / count as f64);
            lengths.sort_by(f64::total_cmp);
            p95.push(lengths[(0.95 * (count - 1) as f64).round() as usize]);
        }
        Some(Self {
            correction_mm: shifts.iter().sum::<f64>() / count as f64,
            largest_mm: shifts.iter().copied().fold(0.0, f64::max),
            sigma_mm: sigma.mean() * 1e3,
            known: known as f64 / count as f64,
            // Without the factor of the size: the map describes errors that nothing else does.
            expected_error_mm: Size::of(calibration.heavy_tails).summary(means, &p95),
            of_map: squares[0] / (squares[0] + squares[1]).max(f64::MIN_POSITIVE),
        })
    }
}
