//! From the approach frame to contact: the tare at rest, then the descent at
//! 25 mm/s with 50/50/100 N/m until the force has been 7.5 N for the dwell time.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Contact, Fault};

use super::{Activity, CartesianState, Coupling, Env, Next};
use crate::Report;
use crate::contact::{ContactTrigger, Tare};
use crate::law::Stiffness;
use crate::motion::LineMove;
use crate::safety::workspace_clearance;

/// Time that the observer gets to settle before the tare, in s.
const SETTLE_S: f64 = 0.3;

/// Estimated contact force above which the arm no longer corrects its line, in N.
const CONTACT_FELT_N: f64 = 2.0;
/// Largest force that keeps the arm on its line, in N. Friction of 2 N m at the
/// wrist can hold as much against it.
const LINE_N: f64 = 10.0;

/// Averages the observer's wrench at rest.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Taring {
    tare: Tare,
}

impl Taring {
    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        if env.elapsed_s < SETTLE_S {
            return Next::Stay;
        }
        self.tare.push(&env.wrench);
        if env.elapsed_s < SETTLE_S + approach.tare_s {
            return Next::Stay;
        }
        cartesian.tare = self.tare.mean();
        let size = cartesian.tare.force.norm();
        // A mean that is not a number is no tare.
        if !(size <= approach.tare_limit_n) {
            return Next::fail(Fault::Tare, size, approach.tare_limit_n);
        }
        let stiffness = Stiffness::about(
            approach.stiffness_n_m,
            &cartesian.direction,
            env.procedure.law.rotation_nm_rad,
        );
        cartesian.engage(env.snapshot, stiffness);
        Next::Enter(Activity::Approaching(Approaching::new(env, cartesian)), None)
    }
}

/// Descends until contact.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Approaching {
    start: Vector3<f64>,
    line: LineMove,
    trigger: ContactTrigger,
    /// Force that keeps the arm on its line, F0, in N.
    line_force: Vector3<f64>,
}

impl Approaching {
    /// Starts at the present setpoint, along the direction of the approach.
    pub(crate) fn new<const N: usize>(env: &Env<'_, N>, cartesian: &CartesianState<N>) -> Self {
        let approach = &env.procedure.approach;
        let line = LineMove::new(
            cartesian.direction,
            approach.speed_m_s,
            approach.acceleration_m_s2,
            f64::INFINITY,
        );
        Self {
            start: cartesian.setpoint.position,
            line,
            trigger: ContactTrigger::default(),
            line_force: Vector3::zeros(),
        }
    }

    /// Increases the force that brings the arm back to its line. Once a contact
    /// force is felt, the force stays as it is, so that the sphere can push the
    /// nest sideways.
    fn keep_line<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) {
        if (env.wrench.force - cartesian.tare.force).norm() > CONTACT_FELT_N {
            return;
        }
        let error = cartesian.setpoint.position - env.snapshot.tcp.position;
        let across = error - cartesian.direction * error.dot(&cartesian.direction);
        self.line_force += across * (env.procedure.approach.line_n_m_s * env.period_s);
        let size = self.line_force.norm();
        if size > LINE_N {
            self.line_force *= LINE_N / size;
        }
        cartesian.setpoint.feed_forward = cartesian.compensation(self.line_force);
    }

    /// One tick.
    pub(crate) fn step<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        let (displacement, velocity) = self.line.step(env.period_s);
        cartesian.setpoint.position = self.start + displacement;
        cartesian.setpoint.velocity.fixed_rows_mut::<3>(0).copy_from(&velocity);
        self.keep_line(env, cartesian);

        let tcp = env.snapshot.tcp.position;
        let travel = (tcp - self.start).dot(&cartesian.direction);
        let force = cartesian.contact_force(env);
        if self
            .trigger
            .push(force, env.snapshot.tcp_speed(), approach, env.period_s)
        {
            cartesian.contact = tcp;
            let contact = Contact {
                sphere: cartesian.sphere,
                time_us: env.time_us,
                force_n: force,
                peak_n: self.trigger.peak_n(),
                tare_n: cartesian.tare.force.into(),
                tcp_m: tcp.into(),
                travel_m: travel,
                latency_ticks: self.trigger.latency_ticks(),
                early_crossings: self.trigger.early_crossings(),
            };
            return Next::Enter(
                Activity::Coupling(Coupling::new(env, cartesian)),
                Some(Report::Contact(contact)),
            );
        }
        if travel > approach.travel_m {
            return Next::fail(Fault::NoContact, travel, approach.travel_m);
        }
        // The TCP is closer to the plate than any sphere: there is no sphere.
        let (left, _) = workspace_clearance(&tcp, &env.procedure.limits);
        if left < 0.0 {
            return Next::fail(Fault::NoContact, travel, travel + left);
        }
        let lag = (cartesian.setpoint.position - tcp).norm();
        if lag > env.procedure.limits.path_m {
            return Next::fail(Fault::PathDeviation, lag, env.procedure.limits.path_m);
        }
        Next::Stay
    }
}
