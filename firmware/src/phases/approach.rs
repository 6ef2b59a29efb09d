//! From the approach frame to contact: tare at rest, then descend at 25 mm/s
//! with 50/50/100 N/m until 7.5 N have lasted for the dwell.

use nalgebra::Vector3;
use spherecal_shared::protocol::host::{Contact, Event, Fault};

use super::{Activity, Coupling, Env, Next, Task};
use crate::contact::{ContactTrigger, Tare};
use crate::envelope::room;
use crate::law::Stiffness;
use crate::motion::LineMove;

/// Time for the observer to settle before the tare is taken, in s.
const SETTLE_S: f64 = 0.3;

/// Estimated contact force at which the arm no longer corrects its line, in N.
const FELT_N: f64 = 2.0;
/// Largest force that keeps the arm on its line, in N: what 2 N m of friction
/// at the wrist may hold against it.
const LINE_N: f64 = 10.0;

/// At rest, averaging the observer's wrench.
#[derive(Clone, Copy, Debug, Default)]
pub struct Taring {
    tare: Tare,
}

impl Taring {
    /// One tick.
    pub fn step<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        if env.elapsed_s < SETTLE_S {
            return Next::Stay;
        }
        self.tare.push(&env.wrench);
        if env.elapsed_s < SETTLE_S + approach.tare_s {
            return Next::Stay;
        }
        task.tare = self.tare.mean();
        let size = task.tare.force.norm();
        if size > approach.tare_limit_n {
            return Next::fail(Fault::Tare, size, approach.tare_limit_n);
        }
        let stiffness = Stiffness::about(
            approach.stiffness_n_m,
            &task.direction,
            env.procedure.law.rotation_nm_rad,
        );
        task.engage(env.snapshot, stiffness);
        Next::Enter(Activity::Approaching(Approaching::new(env, task)), None)
    }
}

/// Descending until contact.
#[derive(Clone, Copy, Debug)]
pub struct Approaching {
    start: Vector3<f64>,
    line: LineMove,
    trigger: ContactTrigger,
    /// Force that keeps the arm on its line, F0, in N.
    keeping: Vector3<f64>,
}

impl Approaching {
    /// From where the arm is, along the task's direction.
    pub fn new<const N: usize>(env: &Env<'_, N>, task: &Task<N>) -> Self {
        let approach = &env.procedure.approach;
        let line = LineMove::new(
            task.direction,
            approach.speed_m_s,
            approach.acceleration_m_s2,
            f64::INFINITY,
        );
        Self {
            start: task.setpoint.position,
            line,
            trigger: ContactTrigger::default(),
            keeping: Vector3::zeros(),
        }
    }

    /// Grows the force that brings the arm back to its line; keeps it once
    /// something is felt, so that the sphere may push the nest aside.
    fn keep_line<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) {
        if (env.wrench.force - task.tare.force).norm() > FELT_N {
            return;
        }
        let error = task.setpoint.position - env.snapshot.tcp.origin;
        let across = error - task.direction * error.dot(&task.direction);
        self.keeping += across * (env.procedure.approach.line_n_m_s * env.period_s);
        let size = self.keeping.norm();
        if size > LINE_N {
            self.keeping *= LINE_N / size;
        }
        task.setpoint.feed_forward = task.compensation(self.keeping);
    }

    /// One tick.
    pub fn step<const N: usize>(&mut self, env: &Env<'_, N>, task: &mut Task<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        let (displacement, velocity) = self.line.step(env.period_s);
        task.setpoint.position = self.start + displacement;
        task.setpoint.velocity.fixed_rows_mut::<3>(0).copy_from(&velocity);
        self.keep_line(env, task);

        let tcp = env.snapshot.tcp.origin;
        let travel = (tcp - self.start).dot(&task.direction);
        let force = task.contact_force(env);
        if self
            .trigger
            .push(force, env.snapshot.tcp_speed(), approach, env.period_s)
        {
            task.contact = tcp;
            let contact = Contact {
                sphere: task.sphere,
                time_us: env.time_us,
                force_n: force,
                peak_n: self.trigger.peak_n(),
                tare_n: task.tare.force.into(),
                tcp_m: tcp.into(),
                travel_m: travel,
                latency_ticks: self.trigger.latency_ticks(),
                early_crossings: self.trigger.early_crossings(),
            };
            return Next::Enter(
                Activity::Coupling(Coupling::new(env, task)),
                Some(Event::Contact(contact)),
            );
        }
        if travel > approach.travel_m {
            return Next::fail(Fault::NoContact, travel, approach.travel_m);
        }
        // Nearer to the plate than any sphere is: there is none.
        let (left, _) = room(&tcp, &env.procedure.limits);
        if left < 0.0 {
            return Next::fail(Fault::NoContact, travel, travel + left);
        }
        let lag = (task.setpoint.position - tcp).norm();
        if lag > env.procedure.limits.path_m {
            return Next::fail(Fault::PathDeviation, lag, env.procedure.limits.path_m);
        }
        Next::Stay
    }
}
