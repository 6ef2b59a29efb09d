//! The control law of one tick, and what replaces it while a state is unusable.

use nalgebra::SVector;
use spherecal_shared::Joints;
use spherecal_shared::protocol::drive::DriveCommand;
use spherecal_shared::protocol::host::{Fault, Stage};

use super::{BLIND_S, Controller, STILL_FILTER};
use crate::law::{JointSetpoint, Snapshot, Wrench, beyond_sensors, guide_torque, joint_spring, poles};
use crate::phases::{Activity, Env, Next};
use crate::safety::{JointState, Touch, Violation};

/// Rate at which what no force at the sphere explains is taken out of the external torque in a turn, in 1/s: a third of the
/// observer's pole, so that both together do not swing. A cable of 5 N m/rad in a turn of 1.5 rad/s is 0.4 N m ahead.
const SEATED_PER_S: f64 = 20.0;

/// Speed of a joint, without sign, by which an arm counts as at rest, in rad/s: that of the drive, or that of its angles where
/// they show less than a quarter of it.
///
/// A contact that chatters faster than the drive samples it, or a tachometer with an offset, shows a speed that no angle
/// follows. What is recorded are angles.
#[inline]
fn believed(drive: f64, turned: f64) -> f64 {
    let (drive, turned) = (drive.abs(), turned.abs());
    if turned < 0.25 * drive { turned } else { drive }
}

impl<const N: usize> Controller<N> {
    /// A command of the session that asks for the brakes.
    pub(super) fn disabled(&mut self, session: u32, tick: u64) -> DriveCommand {
        let mut tau = Joints::new();
        for _ in 0..N {
            // N joints fit: a robot has at most MAX_JOINTS.
            let _ = tau.push(0.0);
        }
        self.last = None;
        DriveCommand {
            session,
            tick,
            tau,
            follow: Joints::new(),
            enable: false,
        }
    }

    /// The last torque once more, for an unusable state; brakes after too many.
    pub(super) fn bridge(&mut self, tick: u64) -> DriveCommand {
        self.blind_ticks = self.blind_ticks.saturating_add(1);
        let blind_ticks = (BLIND_S / self.period_s + 0.5) as u32;
        let most = self.procedure.limits.missed_ticks.saturating_add(blind_ticks);
        match &self.last {
            Some(last) if self.blind_ticks <= most => DriveCommand { tick, ..last.clone() },
            _ => self.disabled(self.number(), tick),
        }
    }

    /// Starts control after closed brakes: forgets all earlier states, so that the
    /// torque does not jump.
    fn release(&mut self) {
        self.holding = false;
        self.shaper.reset();
        self.disturbance.reset();
        self.forget();
    }

    /// Forgets what all filters have of earlier states. The torque changes on from
    /// the last one, within its rate.
    pub(super) fn forget(&mut self) {
        self.observer.reset();
        self.torque_loop.reset();
        self.instability.reset();
        self.pressing.reset();
        self.filtered_dq = [0.0; N];
        self.filtered_q = None;
        self.wrench = Wrench::default();
    }

    pub(super) fn control(&mut self, tick: u64, state: &JointState<N>) -> DriveCommand {
        self.tick = tick;
        self.latest_q = state.q;
        if self.last.is_none() {
            self.release();
        }
        self.blind_ticks = 0;
        let Some(configured) = &self.configured else {
            return self.disabled(self.number(), tick);
        };
        let actuation = self.actuation();
        let Some(snapshot) = Snapshot::on(&actuation, &configured.arm, &state.q, &state.dq) else {
            self.fail(Violation::new(Fault::Internal, 0.0, 0.0));
            return self.bridge(tick);
        };
        self.costs.end_of(Stage::Model);
        let torque_limits = configured.torque_limits;
        let speeds = configured.speeds;
        self.measured = state.tau;
        if self.disturbance.starts() {
            let beyond = SVector::from(state.tau) - snapshot.gravity;
            self.disturbance.start(&beyond, self.safety.limits());
        }
        // Where the drive has followed angles, its torques are those of its own control, friction included: they tell no force.
        let followed = self.last.as_ref().is_some_and(|last| !last.follow.is_empty());
        self.wrench = if followed {
            self.observer.reset();
            self.torque_loop.reset();
            self.pressing.reset();
            Wrench::default()
        } else {
            self.observer
                .update(&snapshot, &state.tau, self.procedure.law.observer_rad_s, self.period_s)
        };
        let share = (STILL_FILTER * self.period_s).min(1.0);
        let mut joint_speed = 0.0f64;
        let filtered_q = self.filtered_q.get_or_insert(state.q);
        for i in 0..N {
            self.filtered_dq[i] += share * (state.dq[i] - self.filtered_dq[i]);
            let turned = (state.q[i] - filtered_q[i]) * STILL_FILTER;
            filtered_q[i] += share * (state.q[i] - filtered_q[i]);
            joint_speed = joint_speed.max(believed(self.filtered_dq[i], turned));
        }
        if !self.holding {
            self.holding = true;
            self.hold = JointSetpoint {
                q: state.q,
                dq: [0.0; N],
            };
        }
        let wanted = (!self.activity.is_cartesian()).then_some(&self.hold.dq);
        let limits = self.safety.limits();
        let unstable = self
            .instability
            .check(&snapshot, &self.filtered_dq, wanted, limits, self.period_s);
        if let Some(violation) = unstable {
            self.fail(violation);
        }
        let ends = self.activity.ends();
        if let Some(violation) = self.safety.joint_state(state, &self.procedure.limits, ends) {
            self.fail(violation);
        }
        let force = if self.activity.is_cartesian() {
            self.contact_force()
        } else {
            snapshot.point_force(self.observer.residual())
        };
        let touch = self.activity.touch(self.may_be_on_sphere);
        let external = self.observer.residual();
        if !followed && let Some(violation) = self.pressing.check(touch, &snapshot, &force, external, self.period_s) {
            self.fail(violation);
        }
        self.costs.end_of(Stage::Guards);
        self.advance(&snapshot, &speeds, joint_speed, force.norm());
        self.costs.end_of(Stage::Phase);

        let delivered = self.delivered(&snapshot, &state.tau);
        let follows = self.follows();
        // Where the drive follows angles, the torque is the one that it has: from there the law goes on.
        let mut wanted = if follows {
            SVector::from(delivered)
        } else {
            self.torque(&snapshot)
        };
        self.costs.end_of(Stage::Law);
        let law = &self.procedure.law;
        let (gain, corner, bound) = (law.torque_loop_gain, law.torque_loop_rad_s, law.torque_loop_nm);
        if !followed {
            self.watch_answer(&delivered);
        }
        let limits = &self.procedure.limits;
        let (joints, envelope) = self.safety.parts();
        let violation = envelope
            .tcp(&snapshot.tcp.position, &snapshot.velocity, limits, self.period_s)
            .or_else(|| {
                let sent = &self.last.as_ref().filter(|_| !followed)?.tau;
                envelope.torque(sent, &delivered, joints, limits, self.period_s)
            });
        if let Some(violation) = violation {
            self.fail(violation);
        }
        // The noise of the torque sensors must not move an arm that has to rest.
        let rests = matches!(self.activity, Activity::Recording(_)) && self.cartesian.impedance.settled();
        let poles = if rests {
            [0.0; N]
        } else {
            poles(&actuation.motors, gain, corner)
        };
        let exerted = self
            .torque_loop
            .exerted(&delivered, &state.dq, &actuation.motors, self.period_s);
        let correction = self
            .torque_loop
            .correction(&exerted, gain, &poles, bound, self.period_s);
        for i in 0..N {
            wanted[i] += correction[i];
        }
        if !wanted
            .iter()
            .chain(self.observer.residual().iter())
            .all(|x| x.is_finite())
        {
            // A finite state of any size must not stay in a filter.
            self.forget();
            self.fail(Violation::new(Fault::Internal, 0.0, 0.0));
            return self.bridge(tick);
        }
        let limits = self.effective_limits(&snapshot, &torque_limits);
        let step = self.procedure.law.torque_rate_nm_s * self.period_s;
        let share = self.period_s / (self.period_s + actuation.smoothing_s);
        let (tau, shaped) = self.shaper.shape(&wanted, &delivered, &limits, step, share);
        self.torque_loop.sent(&tau);
        let violation = self
            .safety
            .watch(&force, &shaped, &self.procedure.limits, self.period_s);
        if let Some(violation) = violation {
            self.fail(violation);
        }
        self.watch_host();
        self.costs.end_of(Stage::Output);
        self.publish(state, &snapshot, &tau, shaped);
        self.snapshot = Some(snapshot);
        if self.keep_brakes {
            return self.disabled(self.number(), tick);
        }
        let joints = |values: &[f64; N]| {
            let mut joints = Joints::new();
            for value in values {
                let _ = joints.push(*value);
            }
            joints
        };
        let command = DriveCommand {
            session: self.number(),
            tick,
            tau: joints(&tau),
            follow: if follows { joints(&self.hold.q) } else { Joints::new() },
            enable: true,
        };
        self.last = Some(command.clone());
        command
    }

    /// Measured torque less the drive's own gravity torque, in N m, to compare with
    /// the torque that was sent.
    fn delivered(&self, snapshot: &Snapshot<N>, measured: &[f64; N]) -> [f64; N] {
        if !self.gravity_by_drive() {
            return *measured;
        }
        core::array::from_fn(|i| measured[i] - snapshot.gravity[i])
    }

    /// Limits of the torque that is sent to the drive, in N m.
    fn effective_limits(&self, snapshot: &Snapshot<N>, limits: &[f64; N]) -> [f64; N] {
        if !self.gravity_by_drive() {
            return *limits;
        }
        core::array::from_fn(|i| (limits[i] - snapshot.gravity[i].abs()).max(0.0))
    }

    /// Advances the setpoint and the phase by one tick.
    // Not inlined: a board has fast memory for the law, and hardly for all phases too.
    #[inline(never)]
    fn advance(&mut self, snapshot: &Snapshot<N>, speeds: &[f64; N], joint_speed: f64, force_n: f64) {
        let env = Env {
            snapshot,
            wrench: self.wrench,
            external: self.observer.residual(),
            departed: self.departed.as_ref(),
            excess: self.disturbance.excess(),
            tau: &self.measured,
            joint_speed,
            force_n,
            procedure: &self.procedure,
            speeds,
            joints: self.safety.limits(),
            period_s: self.period_s,
            elapsed_s: f64::from(self.phase_ticks) * self.period_s,
            time_us: self.now_us,
            tick: self.tick,
        };
        if self.activity.is_seated() {
            let seating = &env.procedure.seating;
            // A pull on the nest judges the displacement itself.
            let pulling = matches!(&self.activity, Activity::Recording(recording) if recording.is_pulling());
            let speed = if pulling { 0.0 } else { snapshot.tcp_speed() };
            let tcp = &snapshot.tcp.position;
            let watch = &mut self.cartesian.watch;
            if let Some(distance) = watch.push(tcp, speed, &snapshot.jacobian, seating, env.period_s) {
                let limit = seating.window_m;
                self.fail(Violation::new(Fault::ContactLost, distance, limit));
                return;
            }
        }
        let next = self.activity.step(&env, &mut self.hold, &mut self.cartesian);
        let explained = self.explained(snapshot);
        self.observer
            .explain(&explained, self.safety.limits(), self.procedure.law.observer_rad_s);
        match next {
            Next::Stay => {}
            Next::Enter(activity, event) => {
                if let Some(event) = event {
                    self.queue_event(event);
                }
                // After a completed decoupling the nest is off the sphere: all that is felt is a disturbance.
                let freed = matches!((&self.activity, &activity), (Activity::Decoupling(_), Activity::Idle));
                let moved = matches!(self.activity, Activity::Moving(_));
                self.enter(activity);
                if freed {
                    self.may_be_on_sphere = false;
                    self.disturbance.set(&-self.observer.residual(), self.safety.limits());
                }
                if freed || moved {
                    self.disturbance.free();
                }
            }
            Next::Fail(violation) => self.fail(violation),
        }
    }

    /// What is no contact of the external joint torque in this tick, in N m.
    ///
    /// While the nest turns on a sphere, which can only exert a force, it is what no force explains: the cables of the
    /// tool. The tare says it itself.
    fn explained(&mut self, snapshot: &Snapshot<N>) -> SVector<f64, N> {
        let external = self.observer.residual();
        match &self.activity {
            Activity::Turning(_) => {
                let torque = snapshot.unexplained(external);
                beyond_sensors(&torque, self.safety.limits()) * (SEATED_PER_S * self.period_s)
            }
            _ => core::mem::replace(&mut self.cartesian.explained, SVector::zeros()),
        }
    }

    /// Torque of the present phase's law, in N m. It includes gravity unless the
    /// drive adds it.
    pub(super) fn torque(&mut self, snapshot: &Snapshot<N>) -> SVector<f64, N> {
        let law = &self.procedure.law;
        self.disturbance.fade(self.period_s);
        let mut torque = if self.activity.is_cartesian() {
            let (impedance, setpoint) = (&mut self.cartesian.impedance, &self.cartesian.setpoint);
            let force = if self.activity.is_seated() {
                impedance.seated_force(snapshot, setpoint, law.damping_ratio)
            } else {
                impedance.force(snapshot, setpoint, law.damping_ratio)
            };
            let null = self.cartesian.null_space.torque(
                snapshot,
                self.safety.limits(),
                law.elbow_nm_rad,
                law.elbow_damping_ratio,
            );
            snapshot.joint_torque(&force) + null - self.observer.known()
        } else if matches!(self.activity, Activity::HandGuiding) {
            let margin = self.procedure.limits.position_margin_rad;
            guide_torque(snapshot, &mut self.hold, self.safety.limits(), margin)
        } else {
            let spring = joint_spring(snapshot, &self.hold, self.procedure.motion.natural_rad_s, 1.0);
            if let Some(giving) = &self.giving {
                let margin = self.procedure.limits.position_margin_rad;
                giving.follow(snapshot, &spring.torque, &mut self.hold, self.safety.limits(), margin);
            }
            let touch = self.activity.touch(self.may_be_on_sphere);
            if matches!(touch, Touch::Rest | Touch::Free) {
                self.disturbance.push(
                    &spring,
                    &self.hold.dq,
                    self.safety.limits(),
                    touch == Touch::Rest,
                    self.period_s,
                );
            }
            spring.torque + self.disturbance.torque()
        };
        torque += snapshot.coriolis;
        if !self.gravity_by_drive() {
            torque += snapshot.gravity;
        }
        torque
    }
}
