//! Halton's sequence: points that fill a box evenly, and are the same every time.
//!
//! For points "anywhere in the joint ranges" without random numbers: seeds of the inverse
//! kinematics, candidates of plans, validation targets.

/// Bases of the dimensions.
const PRIMES: [usize; 12] = [2, 3, 5, 7, 11, 13, 17, 19, 23, 29, 31, 37];

/// Item `index` (from 1) in [0, 1), in dimension `dimension`, from 0; after the
/// twelfth the dimensions repeat.
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
