//! The robot's rules, without sockets and clock.
//!
//! Each period the caller does three things in this order:
//! 1. [`RobotSupervisor::decide`]: the answer to the last state in, the command for the arm out;
//! 2. the arm's step;
//! 3. [`RobotSupervisor::observe`]: the arm's measurement in; then [`RobotSupervisor::fill`] makes the next state.
//!
//! Requests come in between by [`RobotSupervisor::request`]; responses that come later wait in
//! [`RobotSupervisor::take_finished`].

mod state;

use super::arm::{ArmCommand, ArmState};
use super::config::RobotConfig;
use super::generator::Desired;
use super::kinematics::product;
use super::limits::{ArmLimits, DEFAULT_THRESHOLDS};
use crate::wire::{
    CollisionBehavior, CommandKind, ErrorFlag, ErrorSet, FlangeLoad, MoveControllerMode, MoveGeneratorMode,
    MoveRequest, Request, RobotCommand, RobotMode, RobotState, Status, Version,
};
use crate::{JOINTS, PERIOD_S};

/// The torque rate at which a real robot stops, N m/s.
const TORQUE_RATE: f64 = 1000.0;
/// Rounding of the client's arithmetic that is no jump, N m.
const ROUNDING: f64 = 1e-5;
/// Periods that a client has for its first command of a motion.
const FIRST_COMMAND: u32 = 100;
/// Commands that the success rate counts.
const WINDOW: usize = 100;

/// A response to a request that took longer than its first answer.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Finished {
    /// The request.
    pub command: CommandKind,
    /// Its id.
    pub id: u32,
    /// How it ended.
    pub status: Status,
}

#[derive(Clone, Debug)]
struct RunningMotion {
    id: u32,
    request: MoveRequest,
    /// Whether a command has come.
    begun: bool,
    periods: u32,
    missing_in_row: u32,
    answered: [bool; WINDOW],
    desired: Desired,
}

impl RunningMotion {
    fn success_rate(&self) -> f64 {
        let due = (self.periods as usize).min(WINDOW);
        let hits = self.answered.iter().filter(|a| **a).count();
        if due == 0 { 1.0 } else { hits as f64 / due as f64 }
    }
}

/// The state machine of the robot.
pub struct RobotSupervisor {
    config: RobotConfig,
    limits: &'static ArmLimits,
    mode: RobotMode,
    errors: ErrorSet,
    reflex_reason: ErrorSet,
    motion: Option<RunningMotion>,
    recovery: Option<(u32, u32)>,
    torque: [f64; JOINTS],
    thresholds: CollisionBehavior,
    load: FlangeLoad,
    ee_in_ne: [f64; 16],
    k_in_ee: [f64; 16],
    user_stop: bool,
    safety_stop: bool,
    guiding: bool,
    arm: ArmState,
    finished: Vec<Finished>,
}

impl RobotSupervisor {
    /// An idle robot whose arm measures this.
    pub fn new(config: RobotConfig, arm: ArmState) -> Self {
        let identity = RobotState::default().O_T_EE;
        Self {
            limits: ArmLimits::of(config.version),
            config,
            mode: RobotMode::Idle,
            errors: ErrorSet::NONE,
            reflex_reason: ErrorSet::NONE,
            motion: None,
            recovery: None,
            torque: [0.0; JOINTS],
            thresholds: DEFAULT_THRESHOLDS,
            load: FlangeLoad {
                mass: 0.0,
                centre_of_mass: [0.0; 3],
                inertia: [0.0; 9],
            },
            ee_in_ne: identity,
            k_in_ee: identity,
            user_stop: false,
            safety_stop: false,
            guiding: false,
            arm,
            finished: Vec::new(),
        }
    }

    /// The version that the robot speaks.
    pub fn version(&self) -> Version {
        self.config.version
    }

    /// Whether a motion runs, so that an answer to each state is due.
    pub fn is_moving(&self) -> bool {
        self.motion.is_some()
    }

    /// The load that the client has set.
    pub fn load(&self) -> &FlangeLoad {
        &self.load
    }

    fn start(&mut self, id: u32, request: &MoveRequest) -> Status {
        if self.mode != RobotMode::Idle {
            return Status::NotPossible;
        }
        let torque = MoveRequest::torque(self.config.version);
        // Only a torque motion needs no generator, and only from version 7 on.
        let without = request.generator == MoveGeneratorMode::None;
        if without && (request.controller, request.generator) != (torque.controller, torque.generator) {
            return Status::InvalidArgument;
        }
        self.mode = RobotMode::Move;
        self.reflex_reason = ErrorSet::NONE;
        self.torque = [0.0; JOINTS];
        self.motion = Some(RunningMotion {
            id,
            request: *request,
            begun: false,
            periods: 0,
            missing_in_row: 0,
            answered: [false; WINDOW],
            desired: Desired::at_rest(self.arm.q),
        });
        Status::MotionStarted
    }

    fn stop(&mut self) -> Status {
        match self.mode {
            RobotMode::Idle => Status::Success,
            RobotMode::Move => {
                self.end(Status::Preempted, RobotMode::Idle);
                Status::Success
            }
            _ => Status::NotPossible,
        }
    }

    fn recover(&mut self, id: u32) -> Option<Status> {
        match self.mode {
            RobotMode::Reflex => {}
            RobotMode::Idle => return Some(Status::Success),
            _ => return Some(Status::NotPossible),
        }
        if (0..JOINTS).any(|j| self.beyond_limit(j)) {
            return Some(Status::ManualRecoveryRequired);
        }
        self.mode = RobotMode::AutomaticErrorRecovery;
        self.recovery = Some((id, self.config.recovery));
        None
    }

    /// Ends the motion, if one runs, and goes to this mode.
    fn end(&mut self, status: Status, mode: RobotMode) {
        if let Some(motion) = self.motion.take() {
            self.finished.push(Finished {
                command: CommandKind::Move,
                id: motion.id,
                status,
            });
        }
        self.torque = [0.0; JOINTS];
        self.mode = mode;
    }

    fn reflex(&mut self, error: ErrorFlag) {
        self.errors.insert(error);
        self.reflex_reason = self.errors;
        self.end(Status::ReflexAborted, RobotMode::Reflex);
    }

    /// The client is gone: the motion ends and the robot holds its pose.
    pub fn client_gone(&mut self) {
        if self.motion.is_some() {
            self.end(Status::Aborted, RobotMode::Idle);
        }
        self.finished.clear();
    }

    /// Sets what a person at the robot does: user stop pressed, safety function active, guiding the arm by hand.
    pub fn set_person(&mut self, user_stop: bool, safety_stop: bool, guiding: bool) {
        if (self.user_stop, self.safety_stop, self.guiding) == (user_stop, safety_stop, guiding) {
            return;
        }
        (self.user_stop, self.safety_stop, self.guiding) = (user_stop, safety_stop, guiding);
        let resting = if self.errors.is_empty() {
            RobotMode::Idle
        } else {
            RobotMode::Reflex
        };
        if user_stop {
            self.end(Status::EmergencyAborted, RobotMode::UserStopped);
        } else if safety_stop {
            self.end(Status::PreemptedBySafetyFunction, RobotMode::Other);
        } else if guiding {
            self.end(Status::Preempted, RobotMode::Guiding);
        } else {
            self.mode = resting;
        }
        if let Some((id, _)) = self.recovery.take() {
            self.finished.push(Finished {
                command: CommandKind::AutomaticErrorRecovery,
                id,
                status: Status::EmergencyAborted,
            });
        }
    }

    /// One period: takes the answer to the last state and says what the arm has to do. `None`: no answer came in time.
    pub fn decide(&mut self, answer: Option<&RobotCommand>) -> ArmCommand {
        if let Some((id, left)) = self.recovery.take() {
            if left > 1 {
                self.recovery = Some((id, left - 1));
            } else {
                self.errors = ErrorSet::NONE;
                self.mode = RobotMode::Idle;
                self.finished.push(Finished {
                    command: CommandKind::AutomaticErrorRecovery,
                    id,
                    status: Status::Success,
                });
            }
        }
        self.advance(answer);
        match self.mode {
            RobotMode::Move => match &self.motion {
                Some(motion) if motion.request.controller != MoveControllerMode::External => {
                    ArmCommand::Follow(motion.desired.q, motion.desired.dq)
                }
                _ => ArmCommand::Torque(self.torque),
            },
            RobotMode::Guiding => ArmCommand::Guide,
            RobotMode::UserStopped | RobotMode::Other => ArmCommand::Brake,
            _ => ArmCommand::Hold,
        }
    }

    fn advance(&mut self, answer: Option<&RobotCommand>) {
        let tolerance = self.config.tolerance;
        let Some(motion) = &mut self.motion else { return };
        if !motion.begun && answer.is_none() {
            motion.missing_in_row += 1;
            if motion.missing_in_row >= FIRST_COMMAND {
                self.reflex(ErrorFlag::CommunicationConstraintsViolation);
            }
            return;
        }
        let first = !std::mem::replace(&mut motion.begun, true);
        motion.answered[motion.periods as usize % WINDOW] = answer.is_some();
        motion.periods = motion.periods.saturating_add(1);
        let Some(command) = answer else {
            // The last torque is repeated, the last velocity stays.
            motion.missing_in_row += 1;
            motion.desired = motion.desired.extrapolated();
            let covered = motion.periods as usize >= WINDOW;
            if motion.missing_in_row >= tolerance.missing_in_row
                || (covered && motion.success_rate() < tolerance.success_rate)
            {
                self.reflex(ErrorFlag::CommunicationConstraintsViolation);
            }
            return;
        };
        motion.missing_in_row = 0;
        let ee = product(&RobotState::default().F_T_NE, &self.ee_in_ne);
        let (generator, external) = (
            motion.request.generator,
            motion.request.controller == MoveControllerMode::External,
        );
        match motion.desired.next(generator, command, &ee, self.limits, first) {
            Ok(desired) => motion.desired = desired,
            Err(error) => return self.reflex(error),
        }
        for joint in (0..JOINTS).filter(|_| external) {
            let step = (command.tau_J_d[joint] - self.torque[joint]).abs();
            if step > TORQUE_RATE * PERIOD_S + ROUNDING {
                self.reflex(ErrorFlag::ControllerTorqueDiscontinuity);
                return;
            }
            if command.tau_J_d[joint].abs() > self.limits.torque[joint] + ROUNDING {
                self.reflex(ErrorFlag::TauJRangeViolation);
                return;
            }
        }
        if command.finishes() {
            self.end(Status::Success, RobotMode::Idle);
        } else {
            self.torque = command.tau_J_d;
        }
    }

    /// The client sent a command that is none: the motion ends.
    pub fn invalid_command(&mut self) {
        if self.motion.is_some() {
            self.end(Status::InputErrorAborted, RobotMode::Idle);
        }
    }

    fn beyond_limit(&self, joint: usize) -> bool {
        let q = self.arm.q[joint];
        !(self.limits.lower[joint] <= q && q <= self.limits.upper[joint])
    }

    /// Takes what the arm measures and checks the robot's limits while a motion runs.
    pub fn observe(&mut self, arm: &ArmState) {
        self.arm = *arm;
        if self.motion.is_none() {
            return;
        }
        let over = |values: &[f64], limits: &[f64]| values.iter().zip(limits).any(|(v, l)| v.abs() > *l);
        for joint in 0..JOINTS {
            if self.beyond_limit(joint) {
                return self.reflex(ErrorFlag::JointPositionLimitsViolation);
            }
            let (slowest, fastest) = self.limits.velocity_at(joint, arm.q[joint]);
            // A joint at rest is within every limit, also at a stop.
            let dq = arm.dq[joint];
            if dq.abs() > 1e-3 && !(slowest <= dq && dq <= fastest) {
                return self.reflex(ErrorFlag::JointVelocityViolation);
            }
        }
        if over(&arm.tau_external, &self.thresholds.upper_torque_nominal) {
            self.reflex(ErrorFlag::JointReflex);
        } else if over(&arm.wrench_external, &self.thresholds.upper_force_nominal) {
            self.reflex(ErrorFlag::CartesianReflex);
        }
    }

    /// The responses that have become due.
    pub fn take_finished(&mut self) -> Vec<Finished> {
        std::mem::take(&mut self.finished)
    }
}
