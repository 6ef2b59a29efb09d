//! A test pull on the nest.

use nalgebra::Vector3;

/// A pull that rises to its full force and falls again, and the displacement of
/// the TCP under it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Pull {
    start: Vector3<f64>,
    moved: f64,
}

impl Pull {
    /// Starts at a computed TCP (F0, in m).
    pub(super) fn new(start: Vector3<f64>) -> Self {
        Self { start, moved: 0.0 }
    }

    /// Takes one tick's computed TCP; returns the largest displacement so far, in m.
    pub(super) fn push(&mut self, tcp: &Vector3<f64>) -> f64 {
        self.moved = self.moved.max(self.left(tcp));
        self.moved
    }

    /// Displacement of this computed TCP, in m.
    pub(super) fn left(&self, tcp: &Vector3<f64>) -> f64 {
        (tcp - self.start).norm()
    }

    /// Force after `elapsed_s` of a pull of `most_n` that lasts `time_s`, in N.
    pub(super) fn size(elapsed_s: f64, time_s: f64, most_n: f64) -> f64 {
        let share = libm::sin(core::f64::consts::PI * elapsed_s / time_s);
        most_n * share * share
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if a pull does not rise to its full force in the middle of its time and fall to nothing
    // at its end, or if a smaller displacement later hides the largest one.
    #[test]
    fn a_pull_rises_and_falls() {
        for (elapsed_s, share) in [
            (0.0, 0.0),
            (0.05, 0.25),
            (0.075, 0.5),
            (0.15, 1.0),
            (0.25, 0.25),
            (0.3, 0.0),
        ] {
            assert!(
                (Pull::size(elapsed_s, 0.3, 8.0) - 8.0 * share).abs() < 1e-12,
                "{elapsed_s} s"
            );
        }
        let mut pull = Pull::new(Vector3::new(1.0, 2.0, 3.0));
        assert!((pull.push(&Vector3::new(1.0, 2.003, 3.004)) - 0.005).abs() < 1e-12);
        assert!((pull.push(&Vector3::new(1.0, 2.0, 3.0)) - 0.005).abs() < 1e-12);
    }
}
