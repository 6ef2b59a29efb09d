//! The pressing guard: bounds the force with which the arm presses on what it meets.
//!
//! In free space nothing should touch the arm. While the nest is on a sphere, turns,
//! test pulls and the way off it need some force, and no more. The approach has its
//! own condition, the force trigger.
//!
//! The estimated force contains model error, as in the approach. So the guard takes
//! the estimate of an arm that stands in free space as the *rest force*, and judges a
//! free motion by its difference from that. Beyond [`REST_N`] an estimate at rest is no
//! model error: something pushes. A wrong mass of the tool is the same force in every
//! posture. A bias of a torque sensor is the same joint torque, but another force where
//! the arm is stretched. So both differences must be too large.

use nalgebra::{SVector, Vector3};
use spherecal_shared::procedure::Decouple;
use spherecal_shared::protocol::host::Fault;

use super::violation::Violation;
use crate::law::Snapshot;

/// Largest force in a free motion, in N, and the time for which it may be larger, in s.
/// An impact is shorter.
const FREE_N: f64 = 15.0;
const FREE_S: f64 = 0.050;
/// The same while the nest is on a sphere. The magnet holds it with 26.5 N.
const SEATED_N: f64 = 40.0;
const SEATED_S: f64 = 0.200;
/// Time for which a force that no magnet explains may be a wrong estimate, in s.
const HELD_S: f64 = 0.050;
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
    /// The sphere, until the magnet lets go: the time in ms for which more than is [granted](Decouple::GRANTED_N) may be needed.
    Leaving(u16),
    /// What the phase itself judges, a hand, or an unknown thing.
    #[default]
    Wanted,
}

/// The pressing guard.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Pressing<const N: usize> {
    /// Rest force, F0, in N, and the external joint torque of the same time, in N m.
    rest: Vector3<f64>,
    rest_torque: SVector<f64, N>,
    /// Time for which the rest force has been taken, in s.
    rest_s: f64,
    /// Ticks for which the force has been above each of the phase's limits.
    ticks: [u32; 2],
    /// What the phase of the last tick touched.
    touch: Touch,
    /// How a sphere is left, with its magnet.
    decouple: Decouple,
}

impl<const N: usize> Default for Pressing<N> {
    fn default() -> Self {
        Self {
            rest: Vector3::zeros(),
            rest_torque: SVector::zeros(),
            rest_s: 0.0,
            ticks: [0; 2],
            touch: Touch::default(),
            decouple: Decouple::default(),
        }
    }
}

impl<const N: usize> Pressing<N> {
    /// Forgets everything: the estimator has started again.
    pub(crate) fn reset(&mut self) {
        *self = Self::of(self.decouple);
    }

    /// A guard for a magnet that is left so.
    pub(crate) fn of(decouple: Decouple) -> Self {
        Self {
            decouple,
            ..Self::default()
        }
    }

    /// Size of the rest force, in N.
    pub(crate) fn rest_n(&self) -> f64 {
        self.rest.norm()
    }

    /// Takes the estimates of one tick: the force (F0, in N), which is tared where the
    /// phase has a tare (on a sphere), and the external joint torque (N m).
    #[inline]
    pub(crate) fn check(
        &mut self,
        touch: Touch,
        snapshot: &Snapshot<N>,
        force: &Vector3<f64>,
        external: &SVector<f64, N>,
        period_s: f64,
    ) -> Option<Violation> {
        let free = |touch| matches!(touch, Touch::Rest | Touch::Free);
        if self.touch != touch {
            self.ticks = [0; 2];
            if !free(self.touch) {
                // What the arm touched until now is no model error.
                self.rest_s = 0.0;
            }
            self.touch = touch;
        }
        // A motion may begin before the rest force is known.
        if touch == Touch::Rest || (touch == Touch::Free && self.rest_s < REST_S) {
            self.take_rest(force, external, period_s);
        }
        let seated = (SEATED_N, SEATED_S);
        let (mut size, limits) = match touch {
            Touch::Rest | Touch::Wanted => return None,
            Touch::Free => ((force - self.rest).norm(), [(FREE_N, FREE_S); 2]),
            Touch::Seated => (force.norm(), [seated; 2]),
            Touch::Leaving(ms) => {
                let unexplained = (self.decouple.unexplained_n(), HELD_S);
                let granted = (Decouple::GRANTED_N, f64::from(ms) * 1e-3);
                (force.norm(), [unexplained, granted])
            }
        };
        if touch == Touch::Free && size > FREE_N {
            let change = external - self.rest_torque;
            size = size.min(snapshot.point_force(&change).norm());
        }
        let mut found = None;
        for (ticks, (limit, dwell_s)) in self.ticks.iter_mut().zip(limits) {
            // A force that is not a number counts as too large.
            *ticks = if size <= limit { 0 } else { ticks.saturating_add(1) };
            if found.is_none() && f64::from(*ticks) * period_s > dwell_s {
                found = Some(Violation::new(Fault::Pressing, size, limit));
            }
        }
        found
    }

    fn take_rest(&mut self, force: &Vector3<f64>, external: &SVector<f64, N>, period_s: f64) {
        if !force.iter().chain(external).all(|x| x.is_finite()) {
            return;
        }
        // At first it follows the estimate: the observer settles.
        let share = if self.rest_s < REST_S { 1.0 } else { period_s / REST_S };
        self.rest_s += period_s;
        self.rest += (force - self.rest) * share;
        self.rest_torque += (external - self.rest_torque) * share;
        let size = self.rest.norm();
        if size > REST_N {
            self.rest *= REST_N / size;
            self.rest_torque *= REST_N / size;
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    use crate::testing::HOME;
    use spherecal_shared::robot::{Arm, iiwa7, iiwa7_tool};

    const PERIOD_S: f64 = 1e-3;

    fn snapshot() -> Snapshot<7> {
        let arm = Arm::<f64, 7>::new(&iiwa7(), &iiwa7_tool()).expect("the built-in robot");
        Snapshot::new(&arm, &HOME, &[0.0; 7]).expect("a mass matrix")
    }

    /// One tick with a force at the TCP (N). The force that explains a joint torque is a
    /// little smaller: it is damped.
    fn look(guard: &mut Pressing<7>, touch: Touch, force: &Vector3<f64>) -> Option<Violation> {
        let snapshot = snapshot();
        let external = snapshot.jacobian.fixed_rows::<3>(0).transpose() * force;
        guard.check(touch, &snapshot, force, &external, PERIOD_S)
    }

    fn newton(x: f64) -> Vector3<f64> {
        Vector3::new(0.6 * x, 0.0, -0.8 * x)
    }

    /// A guard that knows the rest force of an arm that stood with `rest` (N).
    fn known(rest: f64) -> Pressing<7> {
        let mut guard = Pressing::default();
        for _ in 0..2_000 {
            assert_eq!(look(&mut guard, Touch::Rest, &newton(rest)), None);
        }
        guard
    }

    /// The tick, from 1, at which a force (N) that lasts is a fault, within 1 s.
    fn noticed(guard: &mut Pressing<7>, touch: Touch, force: f64) -> Option<(u32, f64)> {
        (1..1_000).find_map(|tick| {
            let found = look(guard, touch, &newton(force))?;
            assert_eq!((found.fault, found.joint), (Fault::Pressing, 0));
            assert!(found.value > found.limit, "{found:?}");
            Some((tick, found.limit))
        })
    }

    // Fails if a force that lasts is noticed before or after its time, or below its limit.
    #[test]
    fn a_force_that_lasts_is_noticed_in_its_tick() {
        assert_eq!(noticed(&mut known(0.0), Touch::Free, 17.0), Some((51, 15.0)));
        assert_eq!(noticed(&mut known(0.0), Touch::Free, 14.9), None);
        assert_eq!(noticed(&mut known(0.0), Touch::Seated, 40.1), Some((201, 40.0)));
        assert_eq!(noticed(&mut known(0.0), Touch::Seated, 39.9), None);
        assert_eq!(noticed(&mut known(0.0), Touch::Leaving(250), 20.1), Some((251, 20.0)));
        assert_eq!(noticed(&mut known(0.0), Touch::Leaving(250), 19.9), None);
        assert_eq!(noticed(&mut known(0.0), Touch::Leaving(600), 34.1), Some((51, 34.0)));
        assert_eq!(noticed(&mut known(0.0), Touch::Leaving(600), 33.9), Some((601, 20.0)));
    }

    // Fails if the magnet's own pull-off is taken for pressing: a force that rises by 40 N/s, as dry friction makes
    // it of the usual 100, to what the magnet holds, and model error of 3 N.
    #[test]
    fn a_magnet_may_be_pulled_off() {
        let pulled = |n_s: f64| {
            let mut guard = known(0.0);
            (0..3_000).find_map(|ms| {
                let force = newton(n_s * 1e-3 * f64::from(ms));
                look(&mut guard, Touch::Leaving(250), &force).map(|_| force.norm())
            })
        };
        assert!(pulled(40.0).is_some_and(|n| (29.5..30.5).contains(&n)));
        assert!(pulled(100.0).is_some_and(|n| (38.5..39.5).contains(&n)));
    }

    // Fails if a magnet that is declared cannot be pulled off at half of the spring's rate, or if something that holds with more
    // may be pulled for long.
    #[test]
    fn a_declared_magnet_may_be_pulled_off() {
        for magnet_n in [13.0, 26.5, 79.0, 120.0, 265.0] {
            let decouple = Decouple {
                magnet_n,
                ..Decouple::default()
            };
            let touch = Touch::Leaving((decouple.pull_s() * 1e3) as u16);
            let rate = 0.5 * decouple.pull_n_m() * decouple.speed_m_s;
            let mut guard = Pressing::of(decouple);
            let pulled = (0..20_000).find_map(|ms| {
                let force = newton(rate * 1e-3 * f64::from(ms));
                look(&mut guard, touch, &force).map(|_| force.norm())
            });
            let most = pulled.expect("something holds it");
            assert!(most > magnet_n && most < magnet_n + 22.0, "{magnet_n} N: {most}");
        }
    }

    // Fails if the approach, a hand that guides or an arm that stands is judged, or if the
    // time in another phase counts.
    #[test]
    fn only_motions_are_judged() {
        assert_eq!(noticed(&mut known(0.0), Touch::Wanted, 80.0), None);
        assert_eq!(noticed(&mut known(0.0), Touch::Rest, 80.0), None);
        let mut guard = known(0.0);
        for touch in [Touch::Free, Touch::Wanted, Touch::Free, Touch::Seated, Touch::Free] {
            for _ in 0..50 {
                assert_eq!(look(&mut guard, touch, &newton(26.0)), None);
            }
        }
    }

    // Fails if impacts count, or if the guard remembers the one before.
    #[test]
    fn a_spike_is_no_pressing() {
        let mut guard = known(0.0);
        for _ in 0..20 {
            for _ in 0..49 {
                assert_eq!(look(&mut guard, Touch::Free, &newton(80.0)), None);
            }
            assert_eq!(look(&mut guard, Touch::Free, &newton(3.0)), None);
        }
    }

    // Fails if model error counts as pressing, or if a push on an arm that stands is taken
    // for model error.
    #[test]
    fn the_force_at_rest_is_model_error_up_to_its_limit() {
        assert_eq!(noticed(&mut known(11.0), Touch::Free, 25.0), None);
        assert_eq!(noticed(&mut known(11.0), Touch::Free, 28.0), Some((51, FREE_N)));
        assert!((known(50.0).rest_n() - REST_N).abs() < 1e-9);
        assert_eq!(noticed(&mut known(50.0), Touch::Free, 50.0), Some((51, FREE_N)));
        // The force of a contact is no model error of the motion after it.
        let mut guard = known(2.0);
        for _ in 0..100 {
            look(&mut guard, Touch::Seated, &newton(11.0));
        }
        assert_eq!(noticed(&mut guard, Touch::Free, -11.0), None);
    }

    // Fails if the bias of a torque sensor, which is another force in another posture,
    // counts as pressing.
    #[test]
    fn a_torque_that_was_there_at_rest_is_model_error() {
        let mut guard = Pressing::default();
        let snapshot = snapshot();
        let bias = SVector::from([2.0, -2.0, 2.0, 2.0, -0.5, 0.5, -0.5]);
        let mut run = |touch, force: Vector3<f64>, external: &SVector<f64, 7>| {
            (0..400).find_map(|_| guard.check(touch, &snapshot, &force, external, PERIOD_S))
        };
        assert_eq!(run(Touch::Rest, newton(4.0), &bias), None);
        assert_eq!(run(Touch::Free, newton(30.0), &bias), None);
        let pushed = bias + snapshot.jacobian.fixed_rows::<3>(0).transpose() * newton(30.0);
        assert!(run(Touch::Free, newton(34.0), &pushed).is_some());
    }

    // Fails if the torque at rest is not reduced like the force at rest, beyond which something pushes:
    // of 24 N and their torque, half is model error.
    #[test]
    fn the_torque_at_rest_is_bounded_like_the_force() {
        let snapshot = snapshot();
        let bias = snapshot.jacobian.fixed_rows::<3>(0).transpose() * newton(50.0);
        for (kept, pressed) in [(0.5, false), (1.0, true), (0.0, true)] {
            let mut guard = Pressing::default();
            for _ in 0..2_000 {
                assert_eq!(
                    guard.check(Touch::Rest, &snapshot, &newton(24.0), &bias, PERIOD_S),
                    None
                );
            }
            let external = bias * kept;
            assert!(snapshot.point_force(&(bias * 0.5)).norm() > FREE_N, "the torque counts");
            let found = (0..100).find_map(|_| guard.check(Touch::Free, &snapshot, &newton(-30.0), &external, PERIOD_S));
            assert_eq!(found.is_some(), pressed, "{kept} of the torque");
        }
    }

    // Fails if the force at rest does not follow the estimate at once for 0.2 s, and with that time
    // constant from then on.
    #[test]
    fn the_force_at_rest_settles() {
        let mut guard = Pressing::<7>::default();
        let snapshot = snapshot();
        for (newton_at, rest) in [(4.0, 4.0), (6.0, 6.0), (10.0, 8.0), (8.0, 8.0), (0.0, 4.0)] {
            guard.check(Touch::Rest, &snapshot, &newton(newton_at), &SVector::zeros(), 0.1);
            assert!((guard.rest_n() - rest).abs() < 1e-9, "{} N", guard.rest_n());
        }
    }

    // Fails if a motion that begins before the force at rest is known is not judged.
    #[test]
    fn a_motion_may_begin_at_once() {
        let mut guard = Pressing::default();
        assert_eq!(noticed(&mut guard, Touch::Free, 11.0), None);
        guard.reset();
        assert_eq!(noticed(&mut guard, Touch::Free, 30.0), Some((51, FREE_N)));
    }

    // Fails if a force that is not a number passes, or stays in the guard.
    #[test]
    fn what_is_not_a_number_is_refused() {
        let mut guard = known(1.0);
        let found = (1..100).find(|_| {
            let force = Vector3::new(f64::NAN, 0.0, 0.0);
            look(&mut guard, Touch::Free, &force).is_some()
        });
        assert_eq!(found, Some(51));
        for x in [f64::NAN, f64::INFINITY, -f64::INFINITY] {
            look(&mut guard, Touch::Rest, &Vector3::new(0.0, x, 0.0));
        }
        assert!((guard.rest_n() - 1.0).abs() < 1e-9);
        assert_eq!(noticed(&mut guard, Touch::Free, 15.5), None);
    }

    // Fails if anything stays in the guard when the filters start again.
    #[test]
    fn nothing_is_remembered_after_a_reset() {
        let mut guard = known(11.0);
        for _ in 0..50 {
            look(&mut guard, Touch::Free, &newton(30.0));
        }
        guard.reset();
        assert_eq!(guard.rest_n(), 0.0);
        assert_eq!(noticed(&mut guard, Touch::Seated, 40.1), Some((201, SEATED_N)));
    }
}
