//! The scalar of the models and of the control law: `f32` or `f64`.
//!
//! All trigonometric functions come from `libm` on every target (nalgebra's
//! feature `libm-force`), so results have the same bits everywhere.

pub use spherecal_fpu::sqrt;

/// A real scalar: `f32` or `f64`.
pub trait Real: nalgebra::RealField + Copy {
    /// Sine and cosine of an angle in rad.
    fn sin_cos_of(self) -> (Self, Self);

    /// The square root. IEEE 754 demands the correctly rounded root, so it has
    /// the same bits on every target.
    fn sqrt_of(self) -> Self;
}

impl Real for f64 {
    #[inline]
    fn sin_cos_of(self) -> (Self, Self) {
        libm::sincos(self)
    }

    #[inline]
    fn sqrt_of(self) -> Self {
        sqrt(self)
    }
}

impl Real for f32 {
    #[inline]
    fn sin_cos_of(self) -> (Self, Self) {
        libm::sincosf(self)
    }

    #[inline]
    fn sqrt_of(self) -> Self {
        libm::sqrtf(self)
    }
}

/// `value` within ±`bound`. `None` if either is not a number: NaN must not turn into
/// a limit, as it does in `value.max(-bound).min(bound)`.
#[inline]
pub fn bounded(value: f64, bound: f64) -> Option<f64> {
    let within = value.max(-bound).min(bound);
    (!value.is_nan() && !bound.is_nan()).then_some(within)
}

/// The number `value` as scalar `T`.
#[inline(always)]
pub(crate) fn lit<T: Real>(value: f64) -> T {
    nalgebra::convert(value)
}

#[cfg(test)]
mod tests {
    use super::bounded;

    // Fails if what is not a number becomes a bound, as `max` and `min` alone would make it.
    #[test]
    fn what_is_not_a_number_has_no_bound() {
        assert_eq!(f64::NAN.max(-2.0), -2.0, "the trap");
        assert_eq!((bounded(f64::NAN, 2.0), bounded(1.0, f64::NAN)), (None, None));
        for (value, expected) in [(-3.0, -2.0), (-2.0, -2.0), (1.5, 1.5), (f64::INFINITY, 2.0)] {
            assert_eq!(bounded(value, 2.0), Some(expected));
        }
    }
}
