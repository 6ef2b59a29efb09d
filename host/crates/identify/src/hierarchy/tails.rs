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
    highest((TAILS_RANGE.0.ln(), TAILS_RANGE.1.ln()), 30, |l| density(l.exp()))
        .0
        .exp()
}

/// Where a function with one maximum is highest, by steps of the golden ratio, and its value near there.
pub(crate) fn highest((mut low, mut high): (f64, f64), steps: usize, of: impl Fn(f64) -> f64) -> (f64, f64) {
    const GOLDEN: f64 = 0.618_033_988_749_895;
    let mut left = high - GOLDEN * (high - low);
    let mut right = low + GOLDEN * (high - low);
    let (mut at_left, mut at_right) = (of(left), of(right));
    for _ in 0..steps {
        if at_left > at_right {
            (high, right, at_right) = (right, left, at_left);
            left = high - GOLDEN * (high - low);
            at_left = of(left);
        } else {
            (low, left, at_left) = (left, right, at_right);
            right = low + GOLDEN * (high - low);
            at_right = of(right);
        }
    }
    (0.5 * (low + high), at_left.max(at_right))
}

#[cfg(test)]
mod tests {
    use super::{highest, tails};

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

    // Fails if the search misses the top of a hill, also beside the middle or at an end.
    #[test]
    fn the_highest_point_is_found() {
        for top in [-2.9, -0.2, 1.7, 3.5] {
            let (found, value) = highest((-3.0, 3.5), 10, |x| -(x - top) * (x - top));
            assert!((found - top).abs() < 0.06, "{found}, {top}");
            assert!((-0.04..=0.0).contains(&value), "{value}");
        }
    }
}
