//! What the tests of several modules share.

use spherecal_shared::robot::JointLimits;

/// Home position of the tests: elbow up, tool straight down, far from every limit.
pub(crate) const HOME: [f64; 7] = [0.0, 0.7, 0.0, -1.2, 0.0, 1.241_592_653_589_793, 0.0];

/// Limits that no posture of a test comes near.
pub(crate) const NO_LIMITS: JointLimits = JointLimits {
    min_rad: -1e3,
    max_rad: 1e3,
    velocity_rad_s: 1e3,
    torque_nm: 1e3,
};

/// A number from -1 to 1 for each seed, the same on every machine (splitmix64).
pub(crate) fn random(seed: u64) -> f64 {
    let mut x = seed.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    ((x ^ (x >> 31)) >> 11) as f64 / (1u64 << 52) as f64 - 1.0
}
