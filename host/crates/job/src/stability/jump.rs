//! Whether the nest moved on its sphere within a hold: a step of the TCP from one window to the next.

use nalgebra::Vector3;
use serde::Serialize;

/// How many times the noise of a window's mean a step must be.
const NOISES: f64 = 10.0;
/// The smallest step that counts, in µm: a tenth of the accuracy that a calibration reaches.
const LEAST_UM: f64 = 20.0;

/// A step of the TCP.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct Jump {
    /// Distance between the means of two windows that follow each other, in µm.
    pub size_um: f64,
    /// When it was, in s after the start of the hold: between the middles of the two windows.
    pub at_s: f64,
}

/// The largest step between the TCPs of windows that follow each other (µm; their middles in s), if `noise` (µm) of a
/// window does not explain it.
pub(super) fn jump(points: &[Vector3<f64>], time_s: &[f64], noise: f64) -> Option<Jump> {
    let steps = points.windows(2).zip(time_s.windows(2)).map(|(p, t)| Jump {
        size_um: (p[1] - p[0]).norm(),
        at_s: 0.5 * (t[0] + t[1]),
    });
    steps
        .max_by(|a, b| a.size_um.total_cmp(&b.size_um))
        .filter(|largest| largest.size_um > LEAST_UM.max(NOISES * noise))
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a step of 100 µm is not found at its time, or if a drift of the same size, or noise, counts as one.
    #[test]
    fn a_step_is_no_drift() {
        let time_s: Vec<f64> = (0..20).map(|k| f64::from(k) + 0.5).collect();
        let along = |of: &dyn Fn(f64) -> f64| -> Vec<Vector3<f64>> {
            time_s.iter().map(|t| Vector3::new(0.0, of(*t), 0.0)).collect()
        };
        let step = along(&|t| if t > 7.0 { 100.0 } else { 0.0 });
        let found = jump(&step, &time_s, 4.0).expect("a step");
        assert_eq!(
            found,
            Jump {
                size_um: 100.0,
                at_s: 7.0
            }
        );
        assert_eq!(jump(&step, &time_s, 11.0), None);
        assert_eq!(jump(&along(&|t| 5.0 * t), &time_s, 0.1), None);
        assert_eq!(jump(&[], &[], 1.0), None);
    }
}
