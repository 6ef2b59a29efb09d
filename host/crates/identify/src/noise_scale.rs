//! Whitened residuals of rows.

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
}
