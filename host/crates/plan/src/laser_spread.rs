//! How the points of the laser measurements are spread: the statistics of Tables 3 and 4 of the
//! paper, and the choice of points that have them.

use nalgebra::{DMatrix, DVector, Vector3};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Statistics of TCP coordinates in F0 (x, y, z), in m.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Spread {
    /// Means.
    pub mean_m: [f64; 3],
    /// Standard deviations.
    pub std_m: [f64; 3],
    /// Smallest values.
    pub min_m: [f64; 3],
    /// Largest values.
    pub max_m: [f64; 3],
}

/// Table 3: the 284 configurations used for laser calibration.
pub const TABLE_3: Spread = Spread {
    mean_m: [0.525_872, -0.069_712, 0.650_021],
    std_m: [0.160_031, 0.220_397, 0.186_840],
    min_m: [-0.007_304, -0.560_339, 0.198_322],
    max_m: [0.947_042, 0.452_969, 1.197_046],
};

/// Table 4: the 125 configurations used for laser validation.
pub const TABLE_4: Spread = Spread {
    mean_m: [0.501_986, -0.007_856, 0.750_930],
    std_m: [0.211_902, 0.252_262, 0.227_457],
    min_m: [-0.024_214, -0.578_336, 0.137_178],
    max_m: [0.995_460, 0.523_221, 1.135_052],
};

impl Spread {
    /// The same for an arm `scale` times as large.
    pub(super) fn scaled(&self, scale: f64) -> Self {
        let by = |values: [f64; 3]| values.map(|v| v * scale);
        Self {
            mean_m: by(self.mean_m),
            std_m: by(self.std_m),
            min_m: by(self.min_m),
            max_m: by(self.max_m),
        }
    }

    /// Statistics of a set of points (m); the standard deviation is over n.
    pub fn of(points: &[Vector3<f64>]) -> Self {
        let n = points.len().max(1) as f64;
        let each = |f: &dyn Fn(usize) -> f64| [f(0), f(1), f(2)];
        let mean_m = each(&|k| points.iter().map(|p| p[k]).sum::<f64>() / n);
        Self {
            mean_m,
            std_m: each(&|k| (points.iter().map(|p| (p[k] - mean_m[k]).powi(2)).sum::<f64>() / n).sqrt()),
            min_m: each(&|k| points.iter().map(|p| p[k]).fold(f64::INFINITY, f64::min)),
            max_m: each(&|k| points.iter().map(|p| p[k]).fold(f64::NEG_INFINITY, f64::max)),
        }
    }

    pub(super) fn holds(&self, p: &Vector3<f64>) -> bool {
        (0..3).all(|k| (self.min_m[k]..=self.max_m[k]).contains(&p[k]))
    }
}

/// Indices of `count` of the `points` (m) whose statistics are the target's, as nearly as exchanges reach.
pub(super) fn choose(rng: &mut ChaCha8Rng, points: &[Vector3<f64>], target: &Spread, count: usize) -> Vec<usize> {
    let weights = tilted(points, target);
    let mut chosen = draw(rng, &weights, count);
    exchange(points, &weights, target, &mut chosen);
    chosen
}

/// Maximum-entropy weights under which the points have the target's means and second moments: `w ∝
/// exp(λ · f)`, by damped Newton on the dual.
fn tilted(points: &[Vector3<f64>], target: &Spread) -> Vec<f64> {
    let features: Vec<[f64; 6]> = points
        .iter()
        .map(|p| {
            let z: [f64; 3] = std::array::from_fn(|k| (p[k] - target.mean_m[k]) / target.std_m[k]);
            [
                z[0],
                z[1],
                z[2],
                z[0] * z[0] - 1.0,
                z[1] * z[1] - 1.0,
                z[2] * z[2] - 1.0,
            ]
        })
        .collect();
    let weights_at = |lambda: &DVector<f64>| -> Vec<f64> {
        let raw: Vec<f64> = features
            .iter()
            .map(|f| f.iter().zip(lambda.iter()).map(|(a, b)| a * b).sum::<f64>())
            .collect();
        let top = raw.iter().copied().fold(f64::NEG_INFINITY, f64::max);
        let sum: f64 = raw.iter().map(|r| (r - top).exp()).sum();
        raw.iter().map(|r| (r - top).exp() / sum).collect()
    };
    let mut lambda = DVector::<f64>::zeros(6);
    for _ in 0..50 {
        let weights = weights_at(&lambda);
        let mut mean = DVector::<f64>::zeros(6);
        let mut second = DMatrix::<f64>::zeros(6, 6);
        for (f, w) in features.iter().zip(&weights) {
            let f = DVector::from_row_slice(f);
            second.ger(*w, &f, &f, 1.0);
            mean.axpy(*w, &f, 1.0);
        }
        second.ger(-1.0, &mean, &mean, 1.0);
        for k in 0..6 {
            second[(k, k)] += 1e-9;
        }
        let Some(factor) = second.cholesky() else { break };
        let step = factor.solve(&mean);
        lambda -= &step * (1.0 / step.norm().max(1.0));
        if step.norm() < 1e-10 {
            break;
        }
    }
    weights_at(&lambda)
}

/// `count` different indices, drawn with the given weights.
fn draw(rng: &mut ChaCha8Rng, weights: &[f64], count: usize) -> Vec<usize> {
    // Weighted sampling without replacement by the keys u^(1/w) (Efraimidis, Spirakis).
    let mut keys: Vec<(f64, usize)> = weights
        .iter()
        .enumerate()
        .map(|(i, w)| (rng.random::<f64>().max(1e-300).ln() / w.max(1e-300), i))
        .collect();
    keys.sort_by(|a, b| b.0.total_cmp(&a.0));
    keys.into_iter().take(count).map(|(_, i)| i).collect()
}

/// Exchanges chosen points for spare ones while that brings means and deviations closer to the
/// target. Spare points with a small weight are not considered.
fn exchange(points: &[Vector3<f64>], weights: &[f64], target: &Spread, chosen: &mut [usize]) {
    let n = chosen.len() as f64;
    let z = |i: usize, k: usize| (points[i][k] - target.mean_m[k]) / target.std_m[k];
    let add = |sum: &mut [f64; 6], i: usize, sign: f64| {
        for k in 0..3 {
            sum[k] += sign * z(i, k);
            sum[k + 3] += sign * (z(i, k) * z(i, k) - 1.0);
        }
    };
    let cost = |sum: &[f64; 6]| sum.iter().map(|s| (s / n).powi(2)).sum::<f64>();
    let mut sum = [0.0; 6];
    for i in chosen.iter() {
        add(&mut sum, *i, 1.0);
    }
    let mut taken = vec![false; points.len()];
    for i in chosen.iter() {
        taken[*i] = true;
    }
    let typical = 0.2 / points.len() as f64;
    let mut spare: Vec<usize> = (0..points.len())
        .filter(|i| !taken[*i] && weights[*i] > typical)
        .collect();
    for slot in chosen.iter_mut() {
        let mut best = (cost(&sum), None);
        for (s, candidate) in spare.iter().enumerate() {
            let mut trial = sum;
            add(&mut trial, *slot, -1.0);
            add(&mut trial, *candidate, 1.0);
            let c = cost(&trial);
            if c < best.0 {
                best = (c, Some(s));
            }
        }
        if best.0 < 1e-10 && best.1.is_none() {
            break;
        }
        if let (_, Some(s)) = best {
            add(&mut sum, *slot, -1.0);
            add(&mut sum, spare[s], 1.0);
            std::mem::swap(slot, &mut spare[s]);
        }
        if cost(&sum) < 1e-8 {
            break;
        }
    }
}
