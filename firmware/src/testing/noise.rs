//! Noise that is the same on every machine and in every run.

use nalgebra::SVector;
use spherecal_shared::Joints;

/// A number from -1 to 1 for each seed, the same on every machine (splitmix64).
pub(crate) fn random(seed: u64) -> f64 {
    let mut x = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}

/// The values with noise of a size, from this seed on.
pub(super) fn noisy(values: SVector<f64, 7>, size: f64, seed: u64) -> Joints {
    let one = |i: usize| {
        // None at all, so that -0 stays -0.
        if size == 0.0 {
            values[i]
        } else {
            values[i] + size * random(seed + i as u64)
        }
    };
    (0..7).map(one).collect()
}
