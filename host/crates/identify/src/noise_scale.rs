//! Noise scale and robust weights, from squared distances.

/// Student-t weights for three-dimensional residuals; 1 where `nu` is 0.
pub(crate) fn weights(d2: &[f64], s2: f64, nu: f64) -> Vec<f64> {
    if nu <= 0.0 {
        return vec![1.0; d2.len()];
    }
    d2.iter().map(|d| weight(*d, s2, nu)).collect()
}

/// Student-t weight of one residual.
#[inline]
fn weight(d2: f64, s2: f64, nu: f64) -> f64 {
    (nu + 3.0) / (nu + d2 / s2)
}

/// Noise variance by the Student-t likelihood, with `effective` parameters subtracted.
pub(crate) fn scale(d2: &[f64], effective: f64, nu: f64, start: f64) -> f64 {
    let freedom = (3.0 * d2.len() as f64 - effective).max(1.0);
    let mut s2 = start;
    for _ in 0..if nu > 0.0 { 12 } else { 1 } {
        let sum: f64 = if nu > 0.0 {
            d2.iter().map(|d| weight(*d, s2, nu) * d).sum()
        } else {
            d2.iter().sum()
        };
        s2 = (sum / freedom).max(1e-8);
    }
    s2
}

/// Start value of the noise variance that is robust against gross errors.
pub(crate) fn median_scale(d2: &[f64]) -> f64 {
    let mut sorted = d2.to_vec();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return 1.0;
    }
    let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
    // Median of chi-square with three degrees of freedom.
    (*median / 2.366).max(1e-8)
}
