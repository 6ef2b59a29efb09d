//! How heavy the tails of the noise are.

use super::constants::{TAILS, TAILS_RANGE};

/// Degrees of freedom of Student's t that whitened residuals (squared length, numbers that the model leaves free) and
/// hyperprior prefer.
pub(super) fn tails(rows: &[(f64, f64)]) -> f64 {
    let density = |nu: f64| {
        let row = |&(d2, p): &(f64, f64)| {
            libm::lgamma(0.5 * (nu + p))
                - libm::lgamma(0.5 * nu)
                - 0.5 * p * nu.ln()
                - 0.5 * (nu + p) * (d2 / nu).ln_1p()
        };
        rows.iter().map(row).sum::<f64>() - 0.5 * ((nu / TAILS.0).ln() / TAILS.1.ln()).powi(2)
    };
    // Golden section over the logarithm: the likelihood has one maximum.
    let ratio = 0.5 * (5.0_f64.sqrt() - 1.0);
    let (mut low, mut high) = (TAILS_RANGE.0.ln(), TAILS_RANGE.1.ln());
    for _ in 0..30 {
        let (a, b) = (high - ratio * (high - low), low + ratio * (high - low));
        if density(a.exp()) > density(b.exp()) {
            high = b;
        } else {
            low = a;
        }
    }
    (0.5 * (low + high)).exp()
}

#[cfg(test)]
mod tests {
    use super::tails;

    // Fails if normal residuals are given heavy tails, or heavy ones light tails, or if rows that the model follows count
    // as evidence of tails.
    #[test]
    fn tails_follow_the_residuals() {
        let normal: Vec<(f64, f64)> = (0..400).map(|k| (3.0 + 2.0 * f64::from(k % 3 - 1), 3.0)).collect();
        assert!(tails(&normal) > 20.0);
        let heavy: Vec<(f64, f64)> = (0..400).map(|k| (if k % 10 == 0 { 60.0 } else { 1.5 }, 3.0)).collect();
        assert!(tails(&heavy) < 5.0);
        let followed = |share: f64| -> Vec<(f64, f64)> {
            (0..20)
                .map(|k| if k % 2 == 0 { (0.3, share) } else { (5.0, 5.0) })
                .collect()
        };
        assert!(tails(&followed(0.3)) > 1.5 * tails(&followed(5.0)));
    }
}
