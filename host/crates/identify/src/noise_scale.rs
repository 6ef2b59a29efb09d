//! Noise scale and robust weights, from squared distances.

/// A row's whitened residual.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Squared {
    /// Its squared length.
    pub(crate) d2: f64,
    /// How many numbers it has: three per part of the row.
    pub(crate) numbers: f64,
}

impl Squared {
    /// Log of Student's t density at noise variance `s2` up to its normaliser, or of the normal
    /// density where `nu` is 0.
    pub(crate) fn shape(&self, s2: f64, nu: f64) -> f64 {
        if nu > 0.0 {
            -0.5 * (nu + self.numbers) * (self.d2 / (s2 * nu)).ln_1p()
        } else {
            -0.5 * self.d2 / s2
        }
    }

    /// Student-t weight.
    #[inline]
    pub(crate) fn weight(&self, s2: f64, nu: f64) -> f64 {
        (nu + self.numbers) / (nu + self.d2 / s2)
    }
}

/// How many numbers all rows have.
pub(crate) fn numbers(rows: &[Squared]) -> f64 {
    rows.iter().map(|row| row.numbers).sum()
}

/// Student-t weights of rows; 1 where `nu` is 0. A row is down-weighted as a whole.
pub(crate) fn weights(rows: &[Squared], s2: f64, nu: f64) -> Vec<f64> {
    if nu <= 0.0 {
        return vec![1.0; rows.len()];
    }
    rows.iter().map(|row| row.weight(s2, nu)).collect()
}

/// Noise variance by the Student-t likelihood, with `effective` parameters subtracted.
pub(crate) fn scale(rows: &[Squared], effective: f64, nu: f64, start: f64) -> f64 {
    let freedom = (numbers(rows) - effective).max(1.0);
    let mut s2 = start;
    for _ in 0..if nu > 0.0 { 12 } else { 1 } {
        let sum: f64 = if nu > 0.0 {
            rows.iter().map(|row| row.weight(s2, nu) * row.d2).sum()
        } else {
            rows.iter().map(|row| row.d2).sum()
        };
        s2 = (sum / freedom).max(1e-8);
    }
    s2
}

/// Start value of the noise variance that is robust against gross errors.
pub(crate) fn median_scale(rows: &[Squared]) -> f64 {
    let mut sorted: Vec<f64> = rows.iter().map(|row| row.d2 / median(row.numbers)).collect();
    let middle = sorted.len() / 2;
    if sorted.is_empty() {
        return 1.0;
    }
    let (_, median, _) = sorted.select_nth_unstable_by(middle, f64::total_cmp);
    median.max(1e-8)
}

/// Median of chi-square with `freedom` degrees of freedom (Wilson and Hilferty beyond three).
fn median(freedom: f64) -> f64 {
    if freedom == 3.0 {
        return 2.366;
    }
    freedom * (1.0 - 2.0 / (9.0 * freedom)).powi(3)
}
