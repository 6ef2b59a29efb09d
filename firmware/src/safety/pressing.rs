//! The pressing guard: bounds the force with which the arm presses on what it meets.
//!
//! In free space nothing should touch the arm. While the nest is on a sphere, turns,
//! test pulls and the way off it need some force, and no more. The approach has its
//! own condition, the force trigger.
//!
//! The estimated force contains model error, as in the approach. So the guard takes
//! the mean estimate of an arm that stands in free space as the *rest force*, and
//! judges a free motion by its difference from that. Beyond [`REST_N`] an estimate at
//! rest is no model error: something pushes.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::Fault;

use super::violation::Violation;

/// Largest force in a free motion, in N, and the time for which it may be larger, in s.
/// An impact is shorter.
const FREE_N: f64 = 15.0;
const FREE_S: f64 = 0.050;
/// The same while the nest is on a sphere. The magnet holds it with 26.5 N.
const SEATED_N: f64 = 40.0;
const SEATED_S: f64 = 0.200;
/// Largest rest force, in N: the tare of an approach that is refused.
const REST_N: f64 = 12.0;
/// Time constant of the rest force, in s. It includes the time that the observer takes
/// to settle.
const REST_S: f64 = 0.2;

/// What the present phase expects to touch.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) enum Touch {
    /// Nothing: the arm stands in free space.
    Rest,
    /// Nothing: the arm moves in free space.
    Free,
    /// The sphere.
    Seated,
    /// What the phase itself judges, a hand, or an unknown thing.
    #[default]
    Wanted,
}

/// The pressing guard.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Pressing {
    /// Rest force, F0, in N.
    rest: Vector3<f64>,
    /// Time for which the rest force has been taken, in s.
    rest_s: f64,
    /// Ticks for which the force has been too large.
    ticks: u32,
    /// What the phase of the last tick touched.
    touch: Touch,
}

impl Pressing {
    /// Forgets everything: the estimator has started again.
    pub(crate) fn reset(&mut self) {
        *self = Self::default();
    }

    /// Size of the rest force, in N.
    pub(crate) fn rest_n(&self) -> f64 {
        self.rest.norm()
    }

    /// Takes the estimated force of one tick (F0, in N). It is tared where the phase has
    /// a tare ([`Touch::Seated`]).
    #[inline]
    pub(crate) fn check(&mut self, touch: Touch, force: &Vector3<f64>, period_s: f64) -> Option<Violation> {
        let free = |touch| matches!(touch, Touch::Rest | Touch::Free);
        if self.touch != touch {
            self.ticks = 0;
            if !free(self.touch) {
                // What the arm touched until now is no model error.
                self.rest_s = 0.0;
            }
            self.touch = touch;
        }
        // A motion may begin before the rest force is known.
        if touch == Touch::Rest || (touch == Touch::Free && self.rest_s < REST_S) {
            self.take_rest(force, period_s);
        }
        let (size, limit, dwell_s) = match touch {
            Touch::Rest | Touch::Wanted => return None,
            Touch::Free => ((force - self.rest).norm(), FREE_N, FREE_S),
            Touch::Seated => (force.norm(), SEATED_N, SEATED_S),
        };
        // A force that is not a number counts as too large.
        self.ticks = if size <= limit { 0 } else { self.ticks.saturating_add(1) };
        (f64::from(self.ticks) * period_s > dwell_s).then(|| Violation::new(Fault::Pressing, size, limit))
    }

    fn take_rest(&mut self, force: &Vector3<f64>, period_s: f64) {
        if !force.iter().all(|x| x.is_finite()) {
            return;
        }
        // At first it follows the estimate: the observer settles.
        let share = if self.rest_s < REST_S { 1.0 } else { period_s / REST_S };
        self.rest_s += period_s;
        self.rest += (force - self.rest) * share;
        let size = self.rest.norm();
        if size > REST_N {
            self.rest *= REST_N / size;
        }
    }
}
