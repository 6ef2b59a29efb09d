//! The size of a group whose mean follows it: the bending of links, whose sign is known.

use nalgebra::{DMatrix, DVector, DVectorView};

use super::highest;

/// Least share of a combination that the data tell: with less, the measurement is lost in rounding.
const LEAST_TOLD: f64 = 1e-6;
/// Sizes that are tried on each side of the ordinary one, and how far in standard deviations of the hyperprior.
const GRID: (i32, f64) = (30, 3.0);
/// Steps by the golden ratio between two of them, to 1e-5 of the size.
const GOLDEN_STEPS: usize = 20;

/// What the data tell of the members of a group of size `now`, by position among the unknowns and factor: measurements along the
/// axes of their covariance, which are independent. `mean` is that of a member by the size, `deviation` what the estimate is from
/// it, `Rᵀ R` the covariance of all unknowns.
pub(super) fn measured(
    members: &[(usize, f64)],
    (now, mean): (f64, f64),
    deviation: &[f64],
    root: &DMatrix<f64>,
) -> Vec<Measured> {
    let count = members.len();
    let by_size = |k: usize| (now * members[k].1).recip();
    let columns: Vec<_> = (0..count).map(|k| root.column(members[k].0) * by_size(k)).collect();
    let axes = DMatrix::from_fn(count, count, |i, k| columns[i].dot(&columns[k])).symmetric_eigen();
    let deviation = DVector::from_fn(count, |k, _| deviation[members[k].0] * by_size(k));
    let along = |(axis, &left): (DVectorView<'_, f64>, &f64)| {
        let told = 1.0 - left;
        let mean = mean * axis.sum();
        (told > LEAST_TOLD).then(|| Measured {
            value: now * (axis.dot(&deviation) / told + mean),
            variance: now.powi(2) * left.max(0.0) / told,
            mean,
        })
    };
    axes.eigenvectors
        .column_iter()
        .zip(&axes.eigenvalues)
        .filter_map(along)
        .collect()
}

/// What the data tell of a combination of members of a group whose mean follows its size.
pub(super) struct Measured {
    value: f64,
    variance: f64,
    /// Mean of the combination before the data, by the size.
    mean: f64,
}

/// The logarithm of the size `t` that makes measurements `y ~ N(m t, t² + v)` and its hyperprior most probable. Small values are
/// those of a small size, or chance: there can be two maxima, so all sizes are tried.
pub(super) fn size(measured: &[Measured], middle: f64, spread: f64) -> f64 {
    let worth = |l: f64| {
        let size = l.exp();
        let each = |m: &Measured| {
            let variance = size * size + m.variance;
            variance.ln() + (m.value - m.mean * size).powi(2) / variance
        };
        -0.5 * (measured.iter().map(each).sum::<f64>() + ((l - middle) / spread).powi(2))
    };
    let step = spread * GRID.1 / f64::from(GRID.0);
    let grid = (-GRID.0..=GRID.0).map(|k| middle + step * f64::from(k));
    let best = grid.max_by(|a, b| worth(*a).total_cmp(&worth(*b))).unwrap_or(middle);
    highest((best - step, best + step), GOLDEN_STEPS, worth).0
}

#[cfg(test)]
mod tests {
    use nalgebra::DMatrix;

    use super::{Measured, measured, size};

    /// The size of springs that are measured as `(value, variance)`.
    fn size_of(springs: &[(f64, f64)]) -> f64 {
        let measured = |&(value, variance): &(f64, f64)| Measured {
            value,
            variance,
            mean: 1.0,
        };
        let measured: Vec<_> = springs.iter().map(measured).collect();
        size(&measured, 1e-3_f64.ln(), 3.0_f64.ln()).exp()
    }

    // Fails if many springs of mean and sigma 2e-3 do not give that size; if springs that are all 2e-3 do not give the
    // size at which `−ln t − (y/t − 1)²/2` is largest, y (√5 − 1)/2; if springs that are hardly measured do not leave
    // the ordinary size; or if many that are not there do not give a small one.
    #[test]
    fn a_size_follows_the_mean_of_springs() {
        let scattered: Vec<_> = (0..10_000).map(|k| (4e-3 * f64::from(k % 2), 0.0)).collect();
        assert!(
            (size_of(&scattered) / 2e-3 - 1.0).abs() < 1e-3,
            "{}",
            size_of(&scattered)
        );
        let alike = size_of(&[(2e-3, 0.0); 10_000]);
        assert!((alike / (1e-3 * (5.0_f64.sqrt() - 1.0)) - 1.0).abs() < 1e-3, "{alike}");
        let unknown = size_of(&[(2e-3, 1.0); 12]);
        assert!((unknown / 1e-3 - 1.0).abs() < 1e-2, "{unknown}");
        assert!(size_of(&[(0.0, 1e-8); 12]) < 2e-4);
    }

    // Fails if data that tell only the sum of the springs count once for each of them: 12 springs of which nothing is known
    // but that their sum is 0.1 ± 0.01 are no more evidence than that one number.
    #[test]
    fn a_sum_of_springs_is_one_measurement() {
        let (count, now) = (12, 1e-3_f64);
        let members: Vec<_> = (0..count).map(|k| (k, 1.0)).collect();
        let precision = DMatrix::from_fn(count, count, |i, k| 1e4 + f64::from(u8::from(i == k)) * now.powi(-2));
        let covariance = precision.try_inverse().expect("regular");
        let pull = 1e4 * (0.1 - count as f64 * now);
        let deviation: Vec<f64> = covariance.row_iter().map(|row| row.sum() * pull).collect();
        let root = covariance.cholesky().expect("positive").l().transpose();
        let measured = measured(&members, (now, 1.0), &deviation, &root);
        assert_eq!(measured.len(), 1);
        let sum = (count as f64).sqrt() * measured[0].value.abs();
        assert!((sum / 0.1 - 1.0).abs() < 1e-6, "{sum}");
        assert!((measured[0].variance * count as f64 / 1e-4 - 1.0).abs() < 1e-6);
        assert!((measured[0].mean.abs() / (count as f64).sqrt() - 1.0).abs() < 1e-6);
    }
}
