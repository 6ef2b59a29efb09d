//! The scalar that models and control law are written over: `f32` or `f64`.
//!
//! All transcendental functions come from `libm` (nalgebra's `libm-force`),
//! on every target, so that results are the same bits everywhere.

pub use spherecal_fpu::sqrt;

/// A real scalar: `f32` or `f64`.
pub trait Real: nalgebra::RealField + Copy {
    /// Both sine and cosine of an angle in rad.
    fn sin_cos_of(self) -> (Self, Self);

    /// The square root; the same bits on every target, since IEEE 754 rounds
    /// it exactly, and one instruction where there is one.
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

/// A literal as scalar `T`.
#[inline(always)]
pub fn lit<T: Real>(value: f64) -> T {
    nalgebra::convert(value)
}
