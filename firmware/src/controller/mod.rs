//! The control path: one synchronous tick from joint state to joint torque.
//!
//! ```text
//!   DriveState ─▶ SafetyMonitor ─▶ Snapshot ─▶ Observer ─▶ phase ─▶ law ─▶ shaper ─▶ DriveCommand
//!                   └─────────── Violation ────────▶ Fault: damped hold with gravity
//! ```
//!
//! `tick` allocates nothing, has bounded loops and returns a command for every
//! state. It gives no torque outside of a session with a drive. While drive states
//! are unusable it repeats the last torque for some ticks; then it asks for the
//! brakes. It also asks for the brakes if the motors do not deliver the commanded
//! torque, an encoder sticks, or control itself sets the arm in motion. Every other fault ends in a joint spring-damper
//! about the position where the fault happened, with gravity compensation; it gives way if the arm pressed on
//! something.

mod accept;
mod costs;
mod cycle;
mod publish;
mod schedule;
mod session;
mod transition;

use embassy_time::Instant;
use heapless::Deque;
use nalgebra::Vector3;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, NO_SESSION};
use spherecal_shared::protocol::host::{Event, Fault, LoopTiming, Phase, Sample, Stage, Statistics};
use spherecal_shared::robot::Arm;

use crate::Report;
use crate::law::{Actuation, Disturbance, Giving, JointSetpoint, Observer, Snapshot, TorqueLoop, TorqueShaper, Wrench};
use crate::phases::{Activity, CartesianState, Departed};
use crate::safety::{Admission, AnswerWatch, Instability, Pressing, SafetyMonitor};
use costs::Costs;
pub use costs::Stopwatch;
use schedule::Schedule;
use session::DriveSession;

/// Most events that wait for the host link.
const OUTBOX: usize = 12;
/// Most telemetry samples that wait for the host link.
const SAMPLES: usize = 32;
/// Corner frequency of the low-pass on joint speeds, in rad/s. The filtered speeds
/// show whether the arm is still.
const STILL_FILTER: f64 = 60.0;

/// Time after [`missed_ticks`](spherecal_shared::procedure::Limits::missed_ticks)
/// for which the last torque is repeated while no state is usable, in s. Then the
/// controller asks for the brakes: a torque without control does not hold an arm
/// for long.
const BLIND_S: f64 = 0.020;

/// What a configured controller needs for its computations.
#[derive(Clone, Debug)]
struct Configured<const N: usize> {
    arm: Arm<f64, N>,
    torque_limits: [f64; N],
    speeds: [f64; N],
}

/// The controller of an arm with `N` joints.
#[derive(Clone, Debug)]
pub struct Controller<const N: usize> {
    robot: Option<spherecal_shared::robot::DrivenRobot>,
    configured: Option<Configured<N>>,
    procedure: Procedure,
    session: Option<DriveSession<N>>,
    /// The drive as the law takes it: as it declares itself, or as much later as it shows.
    drive: Actuation<N>,
    answer: AnswerWatch<N>,
    /// Delay that the drive has shown in this session, in periods.
    shown: usize,
    period_s: f64,

    safety: SafetyMonitor<N>,
    instability: Instability<N>,
    pressing: Pressing<N>,
    observer: Observer<N>,
    shaper: TorqueShaper<N>,
    torque_loop: TorqueLoop<N>,
    disturbance: Disturbance<N>,
    departed: Option<Departed<N>>,
    activity: Activity<N>,
    hold: JointSetpoint<N>,
    /// How the hold gives way after the fault of an arm that pressed on something.
    giving: Option<Giving>,
    cartesian: CartesianState<N>,
    /// Whether the nest may be on a sphere: one was approached, and no decoupling
    /// has ended since.
    may_be_on_sphere: bool,
    holding: bool,
    snapshot: Option<Snapshot<N>>,
    latest_q: [f64; N],
    measured: [f64; N],
    wrench: Wrench,
    filtered_dq: [f64; N],
    /// The angles through the same low-pass, in rad; the next angles begin it where there are none.
    filtered_q: Option<[f64; N]>,
    phase_ticks: u32,
    silent_ticks: u32,

    schedule: Schedule,
    last: Option<DriveCommand>,
    /// Ticks in a row without a usable state.
    blind_ticks: u32,
    /// Whether the brakes stay closed until the fault is cleared.
    keep_brakes: bool,
    ticks: u64,
    now_us: u64,
    tick: u64,
    since_sample: u32,
    outbox: Deque<Report, OUTBOX>,
    samples: Deque<Sample, SAMPLES>,
    overflow: u32,
    costs: Costs,
    timing: LoopTiming,
}

impl<const N: usize> Default for Controller<N> {
    fn default() -> Self {
        Self {
            robot: None,
            configured: None,
            procedure: Procedure::default(),
            session: None,
            drive: Actuation::default(),
            answer: AnswerWatch::default(),
            shown: 0,
            period_s: 1e-3,
            safety: SafetyMonitor::default(),
            instability: Instability::default(),
            pressing: Pressing::default(),
            observer: Observer::default(),
            shaper: TorqueShaper::default(),
            torque_loop: TorqueLoop::default(),
            disturbance: Disturbance::default(),
            departed: None,
            activity: Activity::Idle,
            hold: JointSetpoint {
                q: [0.0; N],
                dq: [0.0; N],
            },
            giving: None,
            cartesian: CartesianState::default(),
            may_be_on_sphere: false,
            holding: false,
            snapshot: None,
            latest_q: [0.0; N],
            measured: [0.0; N],
            wrench: Wrench::default(),
            filtered_dq: [0.0; N],
            filtered_q: None,
            phase_ticks: 0,
            silent_ticks: 0,
            schedule: Schedule::default(),
            last: None,
            blind_ticks: 0,
            keep_brakes: false,
            ticks: 0,
            now_us: 0,
            tick: 0,
            since_sample: 0,
            outbox: Deque::new(),
            samples: Deque::new(),
            overflow: 0,
            costs: Costs::default(),
            timing: LoopTiming::default(),
        }
    }
}

impl<const N: usize> Controller<N> {
    /// The present phase.
    pub fn phase(&self) -> Phase {
        self.activity.phase()
    }

    /// The present procedure.
    pub fn procedure(&self) -> &Procedure {
        &self.procedure
    }

    /// Estimated force of the environment at the TCP, F0, in N, less the tare if
    /// one was taken.
    pub fn contact_force(&self) -> Vector3<f64> {
        self.wrench.force - self.cartesian.tare.force
    }

    /// Records that something has come from the host.
    pub fn host_heard(&mut self) {
        self.silent_ticks = 0;
    }

    /// Records `ticks` control periods without a tick, 0 for a tick in time.
    pub fn record_missed(&mut self, ticks: u32) {
        if let Some(violation) = self.safety.overrun(ticks, &self.procedure.limits) {
            self.fail(violation);
        }
    }

    /// The next event for the host.
    pub fn next_event(&mut self) -> Option<Event> {
        self.next_report().map(Event::from)
    }

    /// The next event for the host, as queues hold it.
    pub(crate) fn next_report(&mut self) -> Option<Report> {
        self.outbox.pop_front()
    }

    /// The next telemetry sample for the host.
    pub fn next_sample(&mut self) -> Option<Sample> {
        self.samples.pop_front()
    }

    /// Number of telemetry samples that wait.
    pub(crate) fn samples_waiting(&self) -> usize {
        self.samples.len()
    }

    /// Measures the cycles with the board's `stopwatch` from now on.
    pub fn set_stopwatch(&mut self, stopwatch: Stopwatch) {
        self.costs.set_stopwatch(stopwatch);
    }

    /// States how punctual the loop was until now, as the process that runs it measures it.
    pub fn record_timing(&mut self, timing: LoopTiming) {
        self.timing = timing;
    }

    /// A control cycle begins.
    pub(crate) fn begin_cycle(&mut self) {
        self.costs.begin();
    }

    /// The host's commands are taken.
    pub(crate) fn commands_taken(&mut self) {
        self.costs.end_of(Stage::Commands);
    }

    /// A control cycle ends: its command and reports are passed on.
    pub(crate) fn end_cycle(&mut self) {
        self.costs.end_of(Stage::Report);
        self.costs.end();
    }

    /// Counters of the control path; the host link adds its own.
    pub fn statistics(&self) -> Statistics {
        let mut statistics = Statistics {
            ticks: self.ticks,
            missed: self.safety.missed(),
            late: self.schedule.late(),
            simulated: self.session.as_ref().is_some_and(|session| session.simulated),
            cost: self.costs.stated(),
            timing: self.timing,
            ..Statistics::default()
        };
        statistics.link.overflow = self.overflow;
        statistics
    }

    /// One control period: takes the joint state, returns the joint torque. `now`
    /// is the device time. It stamps events and starts commands; the law does not
    /// use it.
    pub fn tick(&mut self, now: Instant, state: &DriveState) -> DriveCommand {
        self.now_us = now.as_micros();
        self.ticks += 1;
        self.phase_ticks = self.phase_ticks.saturating_add(1);
        // A command that starts now belongs to this tick. The safety monitor judges
        // any other tick number.
        if state.tick == self.tick.wrapping_add(1) {
            self.tick = state.tick;
        }
        self.start_due_command();
        let Some(session) = self.session.filter(|session| session.number == state.session) else {
            // A drive without handshake, or one that has started again.
            self.session_lost();
            return self.disabled(NO_SESSION, state.tick);
        };
        let sent = self.last.as_ref().map_or(&[][..], |last| &last.tau);
        let admission = self
            .safety
            .admit(self.now_us, state, sent, &self.procedure.limits, self.period_s);
        self.costs.end_of(Stage::Admission);
        if self.configured.is_none() {
            return self.disabled(session.number, state.tick);
        }
        match admission {
            Admission::Fresh(mut admitted) => {
                if session.torque_reversed {
                    admitted.tau = admitted.tau.map(|tau| -tau);
                }
                self.control(state.tick, &admitted)
            }
            Admission::Bridged => self.bridge(state.tick),
            Admission::Refused(violation) => {
                self.fail(violation);
                if violation.fault == Fault::PositionJump || violation.is_stuck_encoder() {
                    // The arm is not where the last torque was meant for.
                    return self.disabled(session.number, state.tick);
                }
                self.bridge(state.tick)
            }
        }
    }
}

#[cfg(test)]
mod tests;
