//! The square root of an `f64`, by the FPU where an Arm core has one for `f64`.
//!
//! Stands below `spherecal-shared` and is used by its `scalar` module alone.
//! On an Arm core with a double-precision FPU (Cortex-M7) it is one
//! instruction; `libm` takes about 90 there, and a control tick takes some
//! fifty roots. On every other target, a Cortex-M3 or Cortex-M4F among them, it
//! is `libm::sqrt`. The results have the same bits everywhere, because IEEE 754
//! demands the correctly rounded root.
#![no_std]

#[cfg(test)]
mod detect;

/// The square root of `x`; NaN for a negative `x`.
#[cfg(not(fpu_f64))]
#[inline]
#[must_use]
pub fn sqrt(x: f64) -> f64 {
    libm::sqrt(x)
}

/// The square root of `x`; NaN for a negative `x`.
#[cfg(fpu_f64)]
#[inline(always)]
#[must_use]
#[allow(unsafe_code)]
pub fn sqrt(x: f64) -> f64 {
    let root: f64;
    // SAFETY: the instruction reads and writes registers only. `build.rs` sets
    // `fpu_f64` only for cores that have it. Stable Rust offers no safe
    // function for it in `core`.
    unsafe {
        core::arch::asm!(
            "vsqrt.f64 {root}, {x}",
            root = out(dreg_low16) root,
            x = in(dreg_low16) x,
            options(pure, nomem, nostack, preserves_flags)
        );
    }
    root
}
