//! Coupling: a soft hold (5 N/m, 5 s) while the magnet seats the nest, then a test
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
/// Largest distance that a search may move it, in m: the width of the nest's cone.
const SEARCH_M: f64 = 0.035;
/// Frequency of the circling force of a search, in Hz.
const CIRCLES_HZ: f64 = 1.0;

/// The soft hold after contact, or a search.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Coupling {
    /// Searches so far, this one included.
    searches: u32,
}

impl Coupling {
    /// Sets the setpoint to the measured pose and reduces the stiffness.
    pub(crate) fn new<const N: usize>(env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Self {
        cartesian.relatch(env.snapshot, env.snapshot.tcp.rotation);
        cartesian.soften(env, env.procedure.couple.stiffness_n_m);
        Self { searches: 0 }
    }

    /// Force of a search at the present time, F0, in N: a push along the approach
    /// that rises, stays and falls, and a growing circle across it.
    fn search<const N: usize>(env: &Env<'_, N>, cartesian: &CartesianState<N>) -> Vector3<f64> {
        let couple = &env.procedure.couple;
        let share = (env.elapsed_s / couple.search_s).min(1.0);
        let envelope = (4.0 * share).min(1.0).min(4.0 * (1.0 - share));
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
        let wander = (env.snapshot.tcp.position - cartesian.contact).norm();
        if wander > most {
            return Next::fail(Fault::NotSeated, wander, most);
        }
        if env.elapsed_s < time_s {
            if self.searches > 0 {
                cartesian.setpoint.position = env.snapshot.tcp.position;
                cartesian.setpoint.feed_forward = cartesian.compensation(Self::search(env, cartesian));
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
    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let seating = &env.procedure.seating;
        let tcp = env.snapshot.tcp.position;
        let moved = self.pull.push(&tcp);
        if moved > seating.test_m {
            cartesian.setpoint.feed_forward = cartesian.compensation(Vector3::zeros());
            if self.searches < env.procedure.couple.searches {
                cartesian.setpoint.position = tcp;
                let search = Coupling {
                    searches: self.searches + 1,
                };
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
