//! From the approach frame to contact: the tare at rest, then the descent at
//! 25 mm/s, stiff in free motion and with 50/50/200 N/m once something stops it, until the force has been 7.5 N for the
//! dwell time.

use nalgebra::{SVector, Vector3, Vector6};
use spherecal_shared::protocol::host::{Contact, Fault};

use super::{Activity, CartesianState, Coupling, Env, Next};
use crate::Report;
use crate::contact::ContactTrigger;
use crate::law::Stiffness;
use crate::motion::LineMove;
use crate::safety::workspace_clearance;

/// Time that the observer gets to settle before the tare, in s.
const SETTLE_S: f64 = 0.3;

/// Estimated contact force above which the arm no longer corrects its line, in N.
const CONTACT_FELT_N: f64 = 2.0;
/// Least stiffness across the line (two axes) and along it while the TCP moves freely, in N/m. Within the play of its torque
/// sensors the torque loop gives seven times the torque that the law asks for, that of gravity included: with 50 N/m an arm
/// then drifts away.
const LINE_N_M: [f64; 3] = [400.0, 400.0, 200.0];
/// How much faster the force that keeps the line grows with that stiffness: as 400 N/m are to the 50 N/m of Algorithm 2.
const LINE_FACTOR: f64 = LINE_N_M[0] / 50.0;
/// Shares of its setpoint's speed within which the TCP moves freely on its way down: a contact stops it, and a magnet
/// draws it on.
const FREELY: [f64; 2] = [0.8, 1.2];
/// Share below which something may stop it.
const STOPPED_SHARE: f64 = 0.25;
/// Rate at which the force on a TCP that moves freely counts as an error of the torque sensors, in 1/s: their play
/// changes sides on the way down.
const ERROR_PER_S: f64 = 4.0;
/// Largest distance from its line of a TCP that nothing stops, for longer than a push, in m and s: an iiwa 7 that drifts within
/// 1 % of play covers it in 1 s.
const ASIDE_M: f64 = 0.025;
const ASIDE_S: f64 = 0.3;
/// Largest force that keeps the arm on its line, in N. Friction of 2 N m at the
/// wrist can hold as much against it.
const LINE_N: f64 = 10.0;

/// Share of the change of the force, since the posture before, that the change of the joint torque may explain if the
/// external torque is a bias.
const BIAS_SHARE: f64 = 0.5;

/// Stiffness of the approach, with at least `least` (N/m) across it (two axes) and along it.
fn stiffness<const N: usize>(env: &Env<'_, N>, cartesian: &CartesianState<N>, least: [f64; 3]) -> Stiffness {
    let of_contact = env.procedure.approach.stiffness_n_m;
    let values = core::array::from_fn(|i| of_contact[i].max(least[i]));
    Stiffness::about(values, &cartesian.direction, env.procedure.law.rotation_nm_rad)
}

/// Averages what the observer shows at rest.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Taring<const N: usize> {
    external: SVector<f64, N>,
    ticks: u32,
}

impl<const N: usize> Default for Taring<N> {
    fn default() -> Self {
        Self {
            external: SVector::zeros(),
            ticks: 0,
        }
    }
}

impl<const N: usize> Taring<N> {
    /// One tick.
    ///
    /// The tare is the force at the TCP that explains the external torque best: a wrong mass of the tool. The rest is
    /// of cables and torque sensors. If all of it was the same joint torque in another posture, and another force, then
    /// it is a bias, however large that force.
    pub(crate) fn step(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Next<N> {
        let approach = &env.procedure.approach;
        if env.elapsed_s < SETTLE_S {
            return Next::Stay;
        }
        self.external += env.external;
        self.ticks += 1;
        if env.elapsed_s < SETTLE_S + approach.tare_s {
            return Next::Stay;
        }
        let external = self.external / f64::from(self.ticks);
        let force = env.snapshot.point_force(&external);
        let size = force.norm();
        let biased = env.departed.is_some_and(|departed| {
            let change = env.snapshot.point_force(&(external - departed.external)).norm();
            change < BIAS_SHARE * (force - departed.force).norm()
        });
        // A mean that is not a number is no tare. One that is refused is a push, not model error: the arm
        // must not compensate it on its way off.
        if !(size <= approach.tare_limit_n || biased) {
            return Next::fail(Fault::Tare, size, approach.tare_limit_n);
        }
        (cartesian.tare.force, cartesian.explained) = if biased {
            (Vector3::zeros(), external)
        } else {
            (force, env.snapshot.unexplained(&external))
        };
        cartesian.engage(env.snapshot, stiffness(env, cartesian, LINE_N_M));
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
    /// Estimated force beyond the tare while the TCP moved freely, F0, in N.
    error: Vector3<f64>,
    /// Whether something is felt that stops the TCP.
    stopped: bool,
    /// Time for which the TCP has been too far from its line, in s.
    aside_s: f64,
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
            error: Vector3::zeros(),
            stopped: false,
            aside_s: 0.0,
        }
    }

    /// Force beyond the tare and the error of the sensors, F0, in N. Judges whether the TCP moves freely, or something
    /// stops it: then the spring across the line becomes soft, so that the sphere can push the nest sideways.
    fn feel<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) -> Vector3<f64> {
        let along = |v: &Vector6<f64>| Vector3::new(v[0], v[1], v[2]).dot(&cartesian.direction);
        let share = along(&env.snapshot.velocity) / along(&cartesian.setpoint.velocity);
        let beyond = env.wrench.force - cartesian.tare.force;
        let freely = share > FREELY[0] && share < FREELY[1];
        if freely {
            self.error += (beyond - self.error) * (ERROR_PER_S * env.period_s);
        }
        let force = beyond - self.error;
        let felt = force.norm() > CONTACT_FELT_N;
        let stopped = felt && (self.stopped || share < STOPPED_SHARE);
        if stopped != self.stopped {
            self.stopped = stopped;
            let least = if stopped { [0.0; 3] } else { LINE_N_M };
            let ramp_s = env.procedure.law.stiffness_ramp_s;
            let to = stiffness(env, cartesian, least);
            cartesian.impedance.ramp_to(to, ramp_s, env.period_s);
        }
        force
    }

    /// Increases the force that brings the arm back to its line. Once something stops the TCP, the force stays as
    /// it is. A force alone may be an error of the torque sensors.
    fn keep_line<const N: usize>(&mut self, env: &Env<'_, N>, cartesian: &mut CartesianState<N>) {
        if self.stopped {
            return;
        }
        let error = cartesian.setpoint.position - env.snapshot.tcp.position;
        let across = error - cartesian.direction * error.dot(&cartesian.direction);
        self.line_force += across * (LINE_FACTOR * env.procedure.approach.line_n_m_s * env.period_s);
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
        let felt = self.feel(env, cartesian);
        self.keep_line(env, cartesian);

        let tcp = env.snapshot.tcp.position;
        let travel = (tcp - self.start).dot(&cartesian.direction);
        let force = -felt.dot(&cartesian.direction);
        let pole = env.procedure.law.observer_rad_s;
        if self
            .trigger
            .push(force, env.snapshot.tcp_speed(), approach, pole, env.period_s)
        {
            cartesian.contact = tcp;
            let contact = Contact {
                sphere: cartesian.sphere,
                time_us: env.time_us,
                force_n: force,
                peak_n: self.trigger.peak_n(),
                tare_n: (cartesian.tare.force + self.error).into(),
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
        let error = cartesian.setpoint.position - tcp;
        let aside = (error - cartesian.direction * error.dot(&cartesian.direction)).norm();
        self.aside_s = if aside > ASIDE_M && !self.stopped {
            self.aside_s + env.period_s
        } else {
            0.0
        };
        if self.aside_s > ASIDE_S {
            return Next::fail(Fault::PathDeviation, aside, ASIDE_M);
        }
        let lag = error.norm();
        if lag > env.procedure.limits.path_m {
            return Next::fail(Fault::PathDeviation, lag, env.procedure.limits.path_m);
        }
        Next::Stay
    }
}

#[cfg(test)]
#[path = "approach_tests.rs"]
mod tests;
