//! Halton's sequence: points that fill a box evenly, and are the same every time.
//!
//! For points "anywhere in the joint ranges" without random numbers: seeds of the inverse
//! kinematics, candidates of plans, validation targets.

use spherecal_shared::robot::JointLimits;

/// Bases of the dimensions: one for each joint of a chain.
const PRIMES: [usize; spherecal_shared::MAX_CHAIN] = [
    2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37, 41, 43, 47, 53, 59, 61, 67, 71,
];

/// Item `index` (from 1) in [0, 1), in dimension `dimension`, from 0; after the
/// twentieth the dimensions repeat.
pub fn halton(index: usize, dimension: usize) -> f64 {
    let base = PRIMES[dimension % PRIMES.len()];
    let (mut rest, mut weight, mut value) = (index, 1.0, 0.0);
    while rest > 0 {
        weight /= base as f64;
        value += weight * (rest % base) as f64;
        rest /= base;
    }
    value
}

/// Configuration `index` (from 1) of those that fill the middle `share` of every joint's range, in rad. Of a longer range
/// the middle `2 * most_rad` counts as the whole.
pub fn spread<'a>(
    limits: impl IntoIterator<Item = &'a JointLimits>,
    index: usize,
    share: f64,
    most_rad: f64,
) -> Vec<f64> {
    let joint = |(j, limit): (usize, &JointLimits)| {
        let middle = 0.5 * (limit.min_rad + limit.max_rad);
        let half = (0.5 * (limit.max_rad - limit.min_rad)).min(most_rad);
        middle + share * half * (2.0 * halton(index, j) - 1.0)
    };
    limits.into_iter().enumerate().map(joint).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a dimension is not the radical inverse to its prime.
    #[test]
    fn the_first_items_are_halton_s() {
        let first = |dimension| [1, 2, 3, 4].map(|index| halton(index, dimension));
        assert_eq!(first(0), [0.5, 0.25, 0.75, 0.125]);
        let thirds = [1.0, 2.0, 1.0 / 3.0, 4.0 / 3.0];
        for (item, third) in first(1).iter().zip(thirds) {
            assert!((item - third / 3.0).abs() < 1e-15, "{item}");
        }
    }
}
