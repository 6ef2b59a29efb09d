//! Coupling: a soft hold (5 N/m) while the magnet seats the nest, then a test
//! pull. A seated nest resists the pull; a loose one moves. Joint friction can hold
//! a loose nest beside the sphere. Then a search follows: a push along the approach
//! while a force circles across it; and another test pull.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Coupled, Fault};

use super::pull::Pull;
use super::{Activity, CartesianState, Env, Next};
use crate::Report;
use crate::contact::SeatingWatch;

/// Largest distance that the nest may move while the magnet seats it, in m: one
/// and a half times the taught error of 10 mm.
const WANDER_M: f64 = 0.015;
/// Distance back against the approach, in m, from where it was farthest on, from which on the nest is lifted: a search presses it on
/// at once. The magnet draws it on, but torque sensors with play lift an arm as the force of the contact ends: a UR5e with 1 % of
/// play by 5 mm in 0.1 s.
const LIFTED_M: f64 = 0.005;
/// Largest distance that it may move back in a search, in m, which pushes the nest on and may let it climb over the sphere a
/// little, or where none is permitted. A nest that a push lifts off would fall back on the sphere.
const BACK_M: f64 = 0.010;
/// Largest distance that a search may move it, in m: the width of the nest's cone.
const SEARCH_M: f64 = 0.035;
/// Frequency of the circling force of a search, in Hz.
const CIRCLES_HZ: f64 = 1.0;

/// The soft hold after contact, or a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coupling {
    /// Searches so far, this one included.
    searches: u32,
    /// How far the nest has come on along the approach since contact, in m.
    farthest_m: f64,
    /// Whether the push of the search begins at once.
    lifted: bool,
}

impl Coupling {
    /// Sets the setpoint to the measured pose and reduces the stiffness.
    pub(crate) fn new<const N: usize>(env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Self {
        cartesian.relatch(env.snapshot, env.snapshot.tcp.rotation);
        cartesian.soften(env, env.procedure.couple.stiffness_n_m);
        Self::after(0)
    }

    /// After so many searches.
    pub(super) fn after(searches: u32) -> Self {
        Self {
            searches,
            farthest_m: 0.0,
            lifted: false,
        }
    }

    /// Force of a search at the present time, F0, in N: a push along the approach
    /// that rises, stays and falls, and a growing circle across it.
    fn search<const N: usize>(&self, env: &Env<'_, N>, cartesian: &CartesianState<N>) -> Vector3<f64> {
        let couple = &env.procedure.couple;
        let share = (env.elapsed_s / couple.search_s).min(1.0);
        let rise = if self.lifted { 1.0 } else { (4.0 * share).min(1.0) };
        let envelope = rise.min(4.0 * (1.0 - share));
        let along = &cartesian.direction;
        let reference = if along.z.abs() > 0.9 {
            Vector3::x()
        } else {
            Vector3::z()
        };
        let x = along.cross(&reference);
        let x = x / x.norm();
        let y = along.cross(&x);
        let (sine, cosine) = libm::sincos(core::f64::consts::TAU * CIRCLES_HZ * env.elapsed_s);
        let circle = (x * cosine + y * sine) * (couple.search_across_n * share);
        (along * couple.search_n + circle) * envelope
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let couple = &env.procedure.couple;
        let (most, time_s) = if self.searches == 0 {
            (WANDER_M, couple.hold_s)
        } else {
            (SEARCH_M, couple.search_s)
        };
        let moved = env.snapshot.tcp.position - cartesian.contact;
        let wander = moved.norm();
        if wander > most {
            return Next::fail(Fault::NotSeated, wander, most);
        }
        let on = moved.dot(&cartesian.direction);
        self.farthest_m = self.farthest_m.max(on);
        let back = self.farthest_m - on;
        if back > LIFTED_M && self.searches == 0 && couple.searches > 0 {
            let search = Self {
                searches: 1,
                lifted: true,
                ..*self
            };
            return Next::Enter(Activity::Coupling(search), None);
        }
        if back > BACK_M {
            return Next::fail(Fault::NotSeated, back, BACK_M);
        }
        if env.elapsed_s < time_s {
            if self.searches > 0 {
                cartesian.setpoint.position = env.snapshot.tcp.position;
                cartesian.setpoint.feed_forward = cartesian.compensation(self.search(env, cartesian));
            }
            return Next::Stay;
        }
        cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
        cartesian.setpoint.position = env.snapshot.tcp.position;
        cartesian.watch = SeatingWatch::new(env.snapshot.tcp.position, &env.snapshot.jacobian);
        Next::Enter(
            Activity::Verifying(Verifying {
                pull: Pull::new(env.snapshot.tcp.position),
                searches: self.searches,
            }),
            None,
        )
    }
}

/// The test pull against the approach.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Verifying {
    pull: Pull,
    searches: u32,
}

impl Verifying {
    /// A pull after so many searches.
    #[cfg(test)]
    pub(super) fn after(searches: u32, pull: Pull) -> Self {
        Self { pull, searches }
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let seating = &env.procedure.seating;
        let tcp = env.snapshot.tcp.position;
        let moved = self.pull.push(&tcp);
        if moved > seating.test_m {
            cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
            if self.searches < env.procedure.couple.searches {
                cartesian.setpoint.position = tcp;
                let search = Coupling::after(self.searches + 1);
                return Next::Enter(Activity::Coupling(search), None);
            }
            return Next::fail(Fault::NotSeated, moved, seating.test_m);
        }
        if env.elapsed_s < seating.test_s {
            let pull = cartesian.direction * -Pull::size(env.elapsed_s, seating.test_s, seating.test_n);
            cartesian.setpoint.feed_forward = cartesian.compensation(pull);
            return Next::Stay;
        }
        cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
        cartesian.setpoint.position = tcp;
        cartesian.watch = SeatingWatch::new(tcp, &env.snapshot.jacobian);
        let coupled = Coupled {
            sphere: cartesian.sphere,
            time_us: env.time_us,
            centre_m: tcp.into(),
            shift_m: (tcp - cartesian.contact).norm(),
            test_m: moved,
        };
        Next::Enter(Activity::Coupled, Some(Report::Coupled(coupled)))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::phases::scene::Scene;

    // Fails if the push of a search along the approach does not rise for a quarter of its time, stay
    // and fall again, or if the force across it is no circle of one turn a second that grows from
    // nothing to its whole size, in the sense of the approach's own axis.
    #[test]
    fn a_search_pushes_and_circles() {
        for along in [
            -Vector3::z(),
            Vector3::new(0.48, -0.6, -0.64),
            Vector3::new(0.6, 0.8, 0.0),
        ] {
            let mut scene = Scene::new();
            let cartesian = scene.engaged(along);
            let mut force = |elapsed_s: f64| {
                scene.elapsed_s = elapsed_s;
                Coupling::after(1).search(&scene.env(), &cartesian)
            };
            // Of 3 s: the share of the push, and the share of the circle.
            for (elapsed_s, push, circle) in [
                (0.0, 0.0, 0.0),
                (0.375, 0.5, 0.125),
                (0.75, 1.0, 0.25),
                (1.5, 1.0, 0.5),
                (2.25, 1.0, 0.75),
                (2.625, 0.5, 0.875),
                (3.0, 0.0, 1.0),
                (3.5, 0.0, 1.0),
            ] {
                let is = force(elapsed_s);
                let across = is - along * is.dot(&along);
                assert!((is.dot(&along) - 12.0 * push).abs() < 1e-9, "{elapsed_s} s: {is}");
                assert!(
                    (across.norm() - 5.0 * push * circle).abs() < 1e-9,
                    "{elapsed_s} s: {is}"
                );
            }
            let direction = |force: Vector3<f64>| (force - along * force.dot(&along)).normalize();
            let start = direction(force(1.0));
            let quarter = direction(force(1.25));
            assert!((start.cross(&quarter) - along).norm() < 1e-9, "a quarter of a turn");
            assert!((direction(force(1.5)) + start).norm() < 1e-9, "half a turn");
            assert!((direction(force(2.0)) - start).norm() < 1e-9, "a turn");
        }
    }

    // Fails if a nest may wander farther than 15 mm while the magnet seats it or 35 mm in a search,
    // or less far, or if the time of either is not that of the procedure.
    #[test]
    fn a_nest_may_wander_as_far_as_the_magnet_reaches() {
        for (searches, most, time_s) in [(0, 0.015, 0.5), (1, 0.035, 3.0)] {
            let mut scene = Scene::new();
            let mut cartesian = scene.engaged(-Vector3::z());
            cartesian.contact = scene.snapshot.tcp.position;
            let mut phase = Coupling::after(searches);
            let place = scene.snapshot.tcp.position;
            scene.snapshot.tcp.position = place + Vector3::new(0.6, 0.8, 0.0) * (most + 1e-6);
            match phase.step(&scene.env(), &mut cartesian) {
                Next::Fail(found) => {
                    assert_eq!((found.fault, found.limit), (Fault::NotSeated, most));
                    assert!((found.value - most - 1e-6).abs() < 1e-12);
                }
                _ => panic!("too far"),
            }
            scene.snapshot.tcp.position = place + Vector3::new(0.6, 0.8, 0.0) * (most - 1e-6);
            scene.elapsed_s = time_s - 1e-6;
            assert!(matches!(phase.step(&scene.env(), &mut cartesian), Next::Stay));
            let follows = cartesian.setpoint.position == scene.snapshot.tcp.position;
            assert_eq!(follows, searches > 0, "the spring of a search follows the nest");
            scene.elapsed_s = time_s;
            match phase.step(&scene.env(), &mut cartesian) {
                Next::Enter(Activity::Verifying(next), None) => assert_eq!(next.searches, searches),
                _ => panic!("then the test pull"),
            }
            assert_eq!(*cartesian.watch.centre(), scene.snapshot.tcp.position);
        }
    }

    // Fails if a nest that is lifted off is not noticed, or if it may not climb as far as it should: while the magnet should seat
    // it, a search presses it on, with its whole push at once.
    #[test]
    fn a_nest_that_is_lifted_off_is_noticed() {
        let lifted = |searches: u32, most: u32, on: f64, back: f64| {
            let mut scene = Scene::new();
            scene.procedure.couple.searches = most;
            let mut cartesian = scene.engaged(Vector3::new(0.0, 0.6, -0.8));
            cartesian.contact = scene.snapshot.tcp.position;
            let mut phase = Coupling::after(searches);
            let mut step = |on: f64| {
                scene.snapshot.tcp.position = cartesian.contact + cartesian.direction * on;
                match phase.step(&scene.env(), &mut cartesian) {
                    Next::Fail(found) => Err(found.limit),
                    Next::Enter(Activity::Coupling(search), None) => {
                        let push = search.search(&scene.env(), &cartesian).dot(&cartesian.direction);
                        Ok(Some((search.searches, push)))
                    }
                    _ => Ok(None),
                }
            };
            assert_eq!(step(on), Ok(None), "the magnet draws it on");
            step(on - back)
        };
        for on in [0.0, 0.014] {
            assert_eq!(lifted(0, 2, on, 0.0049), Ok(None));
            let Ok(Some((searches, push))) = lifted(0, 2, on, 0.0051) else {
                panic!("a search")
            };
            assert!(searches == 1 && (push - 12.0).abs() < 1e-9, "{searches}, {push} N");
            for (searches, most) in [(1, 2), (0, 0)] {
                assert_eq!(lifted(searches, most, on, 0.0099), Ok(None));
                assert_eq!(lifted(searches, most, on, 0.0101), Err(BACK_M));
            }
        }
    }

    // Fails if the test pull has another direction or size than the procedure says, moves on to a
    // search before the nest has moved too far, searches more often than it may, or reports another
    // shift than that from the contact.
    #[test]
    fn the_test_pull_decides() {
        let verify = |moved: f64, elapsed_s: f64, searches: u32| {
            let mut scene = Scene::new();
            let mut cartesian = scene.engaged(Vector3::new(0.0, 0.6, -0.8));
            cartesian.contact = scene.snapshot.tcp.position + Vector3::new(0.003, 0.0, 0.0);
            let pull = Pull::new(scene.snapshot.tcp.position);
            let mut phase = Verifying { pull, searches };
            scene.elapsed_s = elapsed_s;
            scene.snapshot.tcp.position.y += moved;
            let next = phase.step(&scene.env(), &mut cartesian);
            (next, cartesian)
        };
        let (next, cartesian) = verify(0.0014, 0.15, 0);
        assert!(matches!(next, Next::Stay));
        let force = cartesian.setpoint.feed_forward.fixed_rows::<3>(0).into_owned();
        // Half of 10 N, after a quarter of 0.6 s.
        assert!((force - Vector3::new(0.0, -0.6, 0.8) * 5.0).norm() < 1e-9, "{force}");
        assert!(matches!(
            verify(0.0016, 0.15, 1).0,
            Next::Enter(Activity::Coupling(Coupling { searches: 2, .. }), None)
        ));
        match verify(0.0016, 0.15, 2).0 {
            Next::Fail(found) => assert_eq!((found.fault, found.limit), (Fault::NotSeated, 0.0015)),
            _ => panic!("two searches are all"),
        }
        match verify(0.0014, 0.6, 0).0 {
            Next::Enter(Activity::Coupled, Some(Report::Coupled(coupled))) => {
                assert!((coupled.test_m - 0.0014).abs() < 1e-12);
                let shift = libm::sqrt(0.003 * 0.003 + 0.0014 * 0.0014);
                assert!((coupled.shift_m - shift).abs() < 1e-12);
            }
            _ => panic!("it is seated"),
        }
    }
}
