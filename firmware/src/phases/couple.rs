//! Coupling: 5 N/m for 5 s while the magnet seats the nest; then a test pull
//! that a seated nest resists and a loose one does not.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Coupled, Event, Fault};

use super::{Activity, Env, Next, Task};
use crate::contact::SeatingWatch;

/// Farthest that the nest may wander while the magnet seats it, in m: half
/// the taught error of 10 mm more than that error.
const WANDER_M: f64 = 0.015;

/// Soft hold after contact.
#[derive(Clone, Copy, Debug)]
pub struct Coupling;

impl Coupling {
    /// Re-latches the setpoint to the measured pose and goes soft.
    pub fn new<const N: usize>(env: &Env<'_, N>, task: &mut Task<N>) -> Self {
        task.relatch(env.snapshot, env.snapshot.tcp.rotation);
        task.soften(env, env.procedure.couple.stiffness_n_m);
        Self
    }

    /// One tick.
    pub fn step<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        let wander = (env.snapshot.tcp.origin - task.contact).norm();
        if wander > WANDER_M {
            return Next::fail(Fault::NotSeated, wander, WANDER_M);
        }
        if env.elapsed_s < env.procedure.couple.hold_s {
            return Next::Stay;
        }
        task.setpoint.position = env.snapshot.tcp.origin;
        task.watch = SeatingWatch::new(env.snapshot.tcp.origin);
        Next::Enter(
            Activity::Verifying(Verifying {
                start: env.snapshot.tcp.origin,
                moved: 0.0,
            }),
            None,
        )
    }
}

/// Test pull against the approach.
#[derive(Clone, Copy, Debug)]
pub struct Verifying {
    start: Vector3<f64>,
    moved: f64,
}

impl Verifying {
    /// One tick: the pull rises to its full size and falls again.
    pub fn step<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        let seating = &env.procedure.seating;
        let tcp = env.snapshot.tcp.origin;
        self.moved = self.moved.max((tcp - self.start).norm());
        if self.moved > seating.test_m {
            task.setpoint.feed_forward = task.compensation(Vector3::zeros());
            return Next::fail(Fault::NotSeated, self.moved, seating.test_m);
        }
        if env.elapsed_s < seating.test_s {
            let share = libm::sin(core::f64::consts::PI * env.elapsed_s / seating.test_s);
            let pull = task.direction * (-seating.test_n * share * share);
            task.setpoint.feed_forward = task.compensation(pull);
            return Next::Stay;
        }
        task.setpoint.feed_forward = task.compensation(Vector3::zeros());
        task.setpoint.position = tcp;
        task.watch = SeatingWatch::new(tcp);
        let coupled = Coupled {
            sphere: task.sphere,
            time_us: env.time_us,
            centre_m: tcp.into(),
            shift_m: (tcp - task.contact).norm(),
            test_m: self.moved,
        };
        Next::Enter(Activity::Coupled, Some(Event::Coupled(coupled)))
    }
}
