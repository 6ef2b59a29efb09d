//! Tail probabilities of chi-square and of the normal distribution, far out.

use core::f64::consts::PI;

/// `ln` of the probability that chi-square with `freedom` degrees of freedom
/// exceeds `statistic`.
pub(crate) fn log_tail(statistic: f64, freedom: usize) -> f64 {
    let x = 0.5 * statistic.max(0.0);
    // ln Q(a, x) by Q(a + 1, x) = Q(a, x) + x^a e^-x / Γ(a + 1).
    let (mut a, mut log) = if freedom % 2 == 1 {
        (0.5, log_erfc(x.sqrt()))
    } else {
        (1.0, -x)
    };
    while 2.0 * a + 0.5 < freedom as f64 {
        let term = if x > 0.0 {
            a * x.ln() - x - libm::lgamma(a + 1.0)
        } else {
            f64::NEG_INFINITY
        };
        let (high, low) = if log > term { (log, term) } else { (term, log) };
        log = high + (low - high).exp().ln_1p();
        a += 1.0;
    }
    log.min(0.0)
}

/// `ln erfc(z)` for z from 0.
fn log_erfc(z: f64) -> f64 {
    if z < 20.0 {
        return libm::erfc(z).ln();
    }
    let t = 1.0 / (2.0 * z * z);
    -z * z - (z * PI.sqrt()).ln() + (-t * (1.0 - 3.0 * t)).ln_1p()
}

/// As many standard deviations of one normal variable (both sides) as have this
/// logarithm of a tail probability.
pub(crate) fn sigmas(log_p: f64) -> f64 {
    let (mut low, mut high) = (0.0, 1.0);
    while log_tail(high * high, 1) > log_p && high < 1e6 {
        high *= 2.0;
    }
    for _ in 0..60 {
        let middle = f64::midpoint(low, high);
        if log_tail(middle * middle, 1) > log_p {
            low = middle;
        } else {
            high = middle;
        }
    }
    low
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the tail of chi-square departs from tables at any number of
    // degrees of freedom, or overflows far out.
    #[test]
    fn tails_agree_with_tables() {
        for (statistic, freedom, p) in [
            (3.841_458_8, 1, 0.05),
            (10.827_566, 1, 0.001),
            (5.991_464_5, 2, 0.05),
            (7.814_727_9, 3, 0.05),
            (16.266_236, 3, 0.001),
            (12.591_587, 6, 0.05),
        ] {
            assert!(
                (log_tail(statistic, freedom).exp() - p).abs() < 1e-6 * p.max(1e-3),
                "{statistic} {freedom}"
            );
        }
        let far = log_tail(40_000.0, 3);
        assert!(far.is_finite() && far < -19_000.0, "{far}");
        assert!((sigmas(log_tail(25.0, 1)) - 5.0).abs() < 1e-6);
    }
}
