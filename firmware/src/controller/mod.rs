//! The control path: one synchronous tick from joint state to joint torque.
//!
//! ```text
//!   DriveState ─▶ SafetyMonitor ─▶ Snapshot ─▶ Observer ─▶ phase ─▶ law ─▶ shaper ─▶ DriveCommand
//!                   └─────────── Violation ────────▶ Fault: damped gravity hold
//! ```
//!
//! `tick` allocates nothing, has bounded loops and returns a torque for every
//! state: while a drive state is unusable the last torque stands for some ticks,
//! then the brakes are asked for, as they are where the motors do not do what
//! they are told; every other fault ends in a joint spring-damper about where
//! the arm was, with gravity.

mod accept;
mod publish;
mod schedule;
mod transition;

use embassy_time::Instant;
use heapless::Deque;
use nalgebra::{SVector, Vector3};
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, TorqueSign};
use spherecal_shared::protocol::host::{Event, Fault, Phase, Refusal, Sample, Statistics};
use spherecal_shared::robot::Arm;

use crate::law::{JointSetpoint, Observer, Snapshot, TorqueLoop, TorqueShaper, Wrench, guide_torque, joint_torque};
use crate::phases::{Activity, CartesianState, Env, Next};
use crate::safety::{Admission, JointState, SafetyMonitor, Violation};
use schedule::Schedule;

/// Events that wait for the host link.
const OUTBOX: usize = 12;
/// Telemetry samples that wait for the host link.
const SAMPLES: usize = 32;
/// Corner of the low-pass on joint speeds that tells a still arm, in rad/s.
const STILL_FILTER: f64 = 60.0;

/// Ticks past [`missed_ticks`](spherecal_shared::procedure::Limits::missed_ticks)
/// for which the last torque stands while no state can be used; then the brakes
/// are asked for: an unwatched torque does not hold an arm for long.
const BLIND_TICKS: u32 = 20;

/// What a configured controller computes with.
#[derive(Clone, Debug)]
struct Configured<const N: usize> {
    arm: Arm<f64, N>,
    torque_limits: [f64; N],
    speeds: [f64; N],
}

/// The controller of an arm with `N` joints.
#[derive(Clone, Debug)]
pub struct Controller<const N: usize> {
    robot: Option<spherecal_shared::robot::Robot>,
    configured: Option<Configured<N>>,
    procedure: Procedure,
    gravity_by_drive: bool,
    torque_reversed: bool,
    period_s: f64,

    safety: SafetyMonitor<N>,
    observer: Observer<N>,
    shaper: TorqueShaper<N>,
    torque_loop: TorqueLoop<N>,
    activity: Activity<N>,
    hold: JointSetpoint<N>,
    cartesian: CartesianState<N>,
    /// A sphere was approached since the arm was last known to be clear of one.
    touched: bool,
    holding: bool,
    snapshot: Option<Snapshot<N>>,
    latest_q: [f64; N],
    measured: [f64; N],
    wrench: Wrench,
    slow_dq: [f64; N],
    phase_ticks: u32,
    silent_ticks: u32,

    schedule: Schedule,
    last: Option<DriveCommand>,
    /// Ticks in a row without a state that could be used.
    blind: u32,
    /// Whether the motors cannot be relied on, until the fault is cleared.
    braked: bool,
    ticks: u64,
    now_us: u64,
    tick: u64,
    since_sample: u32,
    outbox: Deque<Event, OUTBOX>,
    samples: Deque<Sample, SAMPLES>,
    overflow: u32,
}

impl<const N: usize> Default for Controller<N> {
    fn default() -> Self {
        Self {
            robot: None,
            configured: None,
            procedure: Procedure::default(),
            gravity_by_drive: false,
            torque_reversed: false,
            period_s: 1e-3,
            safety: SafetyMonitor::default(),
            observer: Observer::default(),
            shaper: TorqueShaper::default(),
            torque_loop: TorqueLoop::default(),
            activity: Activity::Idle,
            hold: JointSetpoint {
                q: [0.0; N],
                dq: [0.0; N],
            },
            cartesian: CartesianState::default(),
            touched: false,
            holding: false,
            snapshot: None,
            latest_q: [0.0; N],
            measured: [0.0; N],
            wrench: Wrench::default(),
            slow_dq: [0.0; N],
            phase_ticks: 0,
            silent_ticks: 0,
            schedule: Schedule::default(),
            last: None,
            blind: 0,
            braked: false,
            ticks: 0,
            now_us: 0,
            tick: 0,
            since_sample: 0,
            outbox: Deque::new(),
            samples: Deque::new(),
            overflow: 0,
        }
    }
}

impl<const N: usize> Controller<N> {
    /// Takes what the drive says of itself.
    ///
    /// # Errors
    /// [`Refusal::Drive`] when its number of joints, period or protocol is not
    /// this controller's.
    pub fn connect(&mut self, hello: &DriveHello) -> Result<(), Refusal> {
        let period_s = f64::from(hello.period_us) * 1e-6;
        let fits = hello.limits.len() == N
            && hello.protocol == spherecal_shared::protocol::PROTOCOL_VERSION
            && (1e-4..=1e-2).contains(&period_s);
        if !fits {
            return Err(Refusal::Drive);
        }
        self.gravity_by_drive = hello.compensates_gravity;
        self.torque_reversed = hello.torque_sign == TorqueSign::OfLink;
        self.period_s = period_s;
        Ok(())
    }

    /// The phase that the controller is in.
    pub fn phase(&self) -> Phase {
        self.activity.phase()
    }

    /// The procedure in force.
    pub fn procedure(&self) -> &Procedure {
        &self.procedure
    }

    /// Estimated force of the environment at the TCP, F0, tared once a tare
    /// was taken, in N.
    pub fn contact_force(&self) -> Vector3<f64> {
        self.wrench.force - self.cartesian.tare.force
    }

    /// Notes that the host was heard.
    pub fn host_heard(&mut self) {
        self.silent_ticks = 0;
    }

    /// Notes `ticks` control periods that were missed by whoever runs the tick,
    /// 0 for one that came in time.
    pub fn record_missed(&mut self, ticks: u32) {
        if let Some(violation) = self.safety.overrun(ticks, &self.procedure.limits) {
            self.fail(violation);
        }
    }

    /// The next event for the host.
    pub fn next_event(&mut self) -> Option<Event> {
        self.outbox.pop_front()
    }

    /// The next telemetry sample for the host.
    pub fn next_sample(&mut self) -> Option<Sample> {
        self.samples.pop_front()
    }

    /// Samples that wait.
    pub fn samples_waiting(&self) -> usize {
        self.samples.len()
    }

    /// Counters of the control path; the link adds its own.
    pub fn statistics(&self) -> Statistics {
        let mut statistics = Statistics {
            ticks: self.ticks,
            missed: self.safety.missed(),
            late: self.schedule.late(),
            ..Statistics::default()
        };
        statistics.link.overflow = self.overflow;
        statistics
    }

    /// One control period: joint state in, joint torque out. `now` is device
    /// time; it stamps events and does not steer the law.
    pub fn tick(&mut self, now: Instant, state: &DriveState) -> DriveCommand {
        self.now_us = now.as_micros();
        self.ticks += 1;
        self.phase_ticks = self.phase_ticks.saturating_add(1);
        // What starts now belongs to this tick. Any other number is the guard's to judge.
        if state.tick == self.tick.wrapping_add(1) {
            self.tick = state.tick;
        }
        self.start_due_command();
        let sent = self.last.as_ref().map_or(&[][..], |last| &last.tau);
        let admission = self
            .safety
            .admit(self.now_us, state, sent, &self.procedure.limits, self.period_s);
        if self.configured.is_none() {
            return self.disabled(state.tick);
        }
        match admission {
            Admission::Fresh(mut admitted) => {
                if self.torque_reversed {
                    admitted.tau = admitted.tau.map(|tau| -tau);
                }
                self.control(state.tick, &admitted)
            }
            Admission::Bridged => self.bridge(state.tick),
            Admission::Refused(violation) => {
                self.fail(violation);
                if violation.fault == Fault::PositionJump || violation.is_stuck_encoder() {
                    // Whatever the last torque was for, the arm is not there.
                    return self.disabled(state.tick);
                }
                self.bridge(state.tick)
            }
        }
    }

    /// Brakes: before there is a robot to control.
    fn disabled(&mut self, tick: u64) -> DriveCommand {
        let mut tau = Joints::new();
        for _ in 0..N {
            // N joints fit: robots have at most MAX_JOINTS.
            let _ = tau.push(0.0);
        }
        self.last = None;
        DriveCommand {
            tick,
            tau,
            enable: false,
        }
    }

    /// The last torque again, for a state that could not be used; brakes after too many.
    fn bridge(&mut self, tick: u64) -> DriveCommand {
        self.blind = self.blind.saturating_add(1);
        let most = self.procedure.limits.missed_ticks.saturating_add(BLIND_TICKS);
        match &self.last {
            Some(last) if self.blind <= most => DriveCommand { tick, ..last.clone() },
            _ => self.disabled(tick),
        }
    }

    /// Takes over from closed brakes, bumpless: nothing of before is true any more.
    fn release(&mut self) {
        self.holding = false;
        self.observer.reset();
        self.shaper.reset();
        self.torque_loop.reset();
    }

    fn control(&mut self, tick: u64, state: &JointState<N>) -> DriveCommand {
        self.tick = tick;
        self.latest_q = state.q;
        if self.last.is_none() {
            self.release();
        }
        self.blind = 0;
        let Some(configured) = &self.configured else {
            return self.disabled(tick);
        };
        let Some(snapshot) = Snapshot::new(&configured.arm, &state.q, &state.dq) else {
            self.fail(Violation::new(Fault::Internal, 0.0, 0.0));
            return self.bridge(tick);
        };
        let torque_limits = configured.torque_limits;
        let speeds = configured.speeds;
        self.measured = state.tau;
        self.wrench = self
            .observer
            .update(&snapshot, &state.tau, self.procedure.law.observer_rad_s, self.period_s);
        let share = (STILL_FILTER * self.period_s).min(1.0);
        let mut joint_speed = 0.0f64;
        for i in 0..N {
            self.slow_dq[i] += share * (state.dq[i] - self.slow_dq[i]);
            joint_speed = joint_speed.max(self.slow_dq[i].abs());
        }
        if !self.holding {
            self.holding = true;
            self.hold = JointSetpoint {
                q: state.q,
                dq: [0.0; N],
            };
        }
        let leaves = matches!(self.activity, Activity::Decoupling(_));
        if let Some(violation) = self.safety.joint_state(state, &self.procedure.limits, leaves) {
            self.fail(violation);
        }
        let force = if self.activity.is_cartesian() {
            self.contact_force()
        } else {
            snapshot.point_force(self.observer.residual())
        };
        self.advance(&snapshot, &speeds, joint_speed, force.norm());

        let mut wanted = self.torque(&snapshot);
        let law = &self.procedure.law;
        let (gain, corner, bound) = (law.torque_loop_gain, law.torque_loop_rad_s, law.torque_loop_nm);
        let delivered = self.delivered(&snapshot, &state.tau);
        let limits = &self.procedure.limits;
        let (joints, envelope) = self.safety.parts();
        let violation = envelope
            .tcp(&snapshot.tcp.position, &snapshot.velocity, limits, self.period_s)
            .or_else(|| {
                let sent = &self.last.as_ref()?.tau;
                envelope.torque(sent, &delivered, joints, limits, self.period_s)
            });
        if let Some(violation) = violation {
            self.fail(violation);
        }
        let correction = self
            .torque_loop
            .correction(&delivered, gain, corner, bound, self.period_s);
        for i in 0..N {
            wanted[i] += correction[i];
        }
        let limits = self.effective_limits(&snapshot, &torque_limits);
        let step = self.procedure.law.torque_rate_nm_s * self.period_s;
        let (tau, shaped) = self.shaper.shape(&wanted, &delivered, &limits, step);
        self.torque_loop.sent(&tau);
        let violation = self
            .safety
            .watch(&force, &shaped, &self.procedure.limits, self.period_s);
        if let Some(violation) = violation {
            self.fail(violation);
        }
        self.watch_host();
        self.publish(state, &snapshot, &tau, shaped);
        self.snapshot = Some(snapshot);
        if self.braked {
            return self.disabled(tick);
        }
        let mut joints = Joints::new();
        for value in tau {
            let _ = joints.push(value);
        }
        let command = DriveCommand {
            tick,
            tau: joints,
            enable: true,
        };
        self.last = Some(command.clone());
        command
    }

    /// What arrived of the torque that was sent, in N m: without the drive's own share.
    fn delivered(&self, snapshot: &Snapshot<N>, measured: &[f64; N]) -> [f64; N] {
        if !self.gravity_by_drive {
            return *measured;
        }
        core::array::from_fn(|i| measured[i] - snapshot.gravity[i])
    }

    /// Torque limits of what is sent to the drive, in N m.
    fn effective_limits(&self, snapshot: &Snapshot<N>, limits: &[f64; N]) -> [f64; N] {
        if !self.gravity_by_drive {
            return *limits;
        }
        core::array::from_fn(|i| (limits[i] - snapshot.gravity[i].abs()).max(0.0))
    }

    /// Moves the setpoint and the phase by one tick.
    fn advance(&mut self, snapshot: &Snapshot<N>, speeds: &[f64; N], joint_speed: f64, force_n: f64) {
        let env = Env {
            snapshot,
            wrench: self.wrench,
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
            let tcp = &snapshot.tcp.position;
            if let Some(distance) = self
                .cartesian
                .watch
                .push(tcp, snapshot.tcp_speed(), seating, env.period_s)
            {
                let limit = seating.window_m;
                self.fail(Violation::new(Fault::ContactLost, distance, limit));
                return;
            }
        }
        match self.activity.step(&env, &mut self.hold, &mut self.cartesian) {
            Next::Stay => {}
            Next::Enter(activity, event) => {
                if let Some(event) = event {
                    self.queue_event(event);
                }
                // Only a retreat that has come to its end leaves no sphere behind it.
                if matches!((&self.activity, &activity), (Activity::Decoupling(_), Activity::Idle)) {
                    self.touched = false;
                }
                self.enter(activity);
            }
            Next::Fail(violation) => self.fail(violation),
        }
    }

    /// The law of the present phase, in N m, gravity included unless the drive
    /// adds it.
    fn torque(&mut self, snapshot: &Snapshot<N>) -> SVector<f64, N> {
        let law = &self.procedure.law;
        let mut torque = if self.activity.is_cartesian() {
            let force = self
                .cartesian
                .impedance
                .force(snapshot, &self.cartesian.setpoint, law.damping_ratio);
            let null = self
                .cartesian
                .null_space
                .torque(snapshot, law.elbow_nm_rad, law.elbow_damping_ratio);
            snapshot.joint_torque(&force) + null
        } else if matches!(self.activity, Activity::HandGuiding) {
            let margin = self.procedure.limits.position_margin_rad;
            guide_torque(snapshot, &mut self.hold, self.safety.limits(), margin)
        } else {
            joint_torque(snapshot, &self.hold, self.procedure.motion.natural_rad_s, 1.0)
        };
        torque += snapshot.coriolis;
        if !self.gravity_by_drive {
            torque += snapshot.gravity;
        }
        torque
    }
}

#[cfg(test)]
mod tests;
