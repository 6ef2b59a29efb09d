//! How large the error of the TCP is over the workspace, as far as the model knows.
//!
//! [`Diagnosis::expected_error_of`](crate::diagnosis::Diagnosis::expected_error_of)
//! says it, with what the model leaves out. Where no diagnosis could be made, robots are
//! drawn from the calibration's posterior distribution alone: each draw displaces the TCP
//! at configurations spread over the joints' ranges. Those figures hold where the model
//! is right.

use nalgebra::{DMatrix, DVector, SymmetricEigen, Vector3};
use rand::SeedableRng as _;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;

use crate::Calibration;

/// Robots drawn.
const DRAWS: usize = 200;

/// Error of the TCP to expect over the workspace, in mm.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct ExpectedError {
    /// Mean over the workspace.
    pub mean: f64,
    /// 95 % of the workspace has an error below this.
    pub p95: f64,
    /// 95 % interval of the mean.
    pub interval: [f64; 2],
}

impl ExpectedError {
    /// Over `configurations`; `off` is a known displacement (m) at each of them, which
    /// adds to what is not known.
    pub(crate) fn of(
        calibration: &Calibration,
        configurations: &[Vec<f64>],
        off: Option<&[Vector3<f64>]>,
    ) -> Option<Self> {
        let (columns, covariance, _) = calibration.spread_in_base(configurations);
        if covariance.is_empty() || covariance.iter().any(|c| !c.is_finite()) {
            return None;
        }
        let eigen = SymmetricEigen::new(covariance);
        let scale = eigen.eigenvalues.map(|v| v.max(0.0).sqrt());
        if scale.max() <= 0.0 {
            return None;
        }
        // The columns have the axes of the first reference frame.
        let rotation = calibration.base.rotation;
        let spread = columns * (eigen.eigenvectors * DMatrix::from_diagonal(&scale));
        let mut random = ChaCha8Rng::seed_from_u64(1);
        let mut means = Vec::with_capacity(DRAWS);
        let mut all = Vec::with_capacity(DRAWS * configurations.len());
        for _ in 0..DRAWS {
            let draw = DVector::from_fn(spread.ncols(), |_, _| normal(&mut random));
            let displaced = &spread * draw;
            let errors: Vec<f64> = displaced
                .as_slice()
                .chunks_exact(3)
                .enumerate()
                .map(|(k, e)| {
                    let known = off
                        .and_then(|off| off.get(k))
                        .map_or_else(Vector3::zeros, |off| rotation * off);
                    (Vector3::new(e[0], e[1], e[2]) + known).norm() * 1e3
                })
                .collect();
            means.push(errors.iter().sum::<f64>() / errors.len().max(1) as f64);
            all.extend(errors);
        }
        Some(Self {
            mean: means.iter().sum::<f64>() / DRAWS as f64,
            p95: quantile(&mut all, 0.95),
            interval: [quantile(&mut means, 0.025), quantile(&mut means, 0.975)],
        })
    }
}

/// A standard normal number, by Box and Muller.
fn normal(random: &mut ChaCha8Rng) -> f64 {
    use rand::RngExt as _;
    let (u, v): (f64, f64) = (random.random(), random.random());
    (-2.0 * libm::log1p(-u)).sqrt() * libm::cos(std::f64::consts::TAU * v)
}

fn quantile(values: &mut [f64], share: f64) -> f64 {
    values.sort_unstable_by(f64::total_cmp);
    let at = (share * values.len().saturating_sub(1) as f64).round() as usize;
    values.get(at).copied().unwrap_or_default()
}
