//! The client that moves the robot.

use std::net::IpAddr;
use std::time::Duration;

use super::link::ClientLink;
use super::{ClientConfig, ClientError, EndCause, LinkStatistics, MotionEnd, TorqueLimits};
use crate::JOINTS;
use crate::wire::{
    CollisionBehavior, FlangeLoad, MoveRequest, Request, RobotCommand, RobotMode, RobotState, Status, Version,
};
use spherecal_budget::robot::TRANSITION;

/// How long to look for a response that may not have come yet.
const LOOK: Duration = Duration::from_millis(1);
/// Commands after which the robot's success rate covers its whole window.
const WINDOW: u64 = 100;

/// What one exchange did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cycle {
    /// Periods before this one that went by without an answer.
    pub missed: u64,
    /// A torque changed too fast and was clamped.
    pub rate_limited: bool,
    /// A torque exceeded its limit and was clamped.
    pub torque_limited: bool,
}

/// A connection that can move the robot.
pub struct Client {
    link: ClientLink,
    limits: TorqueLimits,
    moving: bool,
    /// The newest state may be answered.
    answerable: bool,
    /// The state that showed the motion's begin waits for the first [`receive`](Self::receive).
    pending: bool,
    sent: [f64; JOINTS],
    commands_at_start: u64,
}

impl Client {
    /// Connects to the robot. Nothing moves.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot cannot be reached, or speaks no permitted version or one that is only read.
    pub fn connect(config: &ClientConfig) -> Result<Self, ClientError> {
        let link = ClientLink::connect(config)?;
        if !link.version.can_move() {
            return Err(ClientError::ReadOnly { version: link.version });
        }
        Ok(Self {
            link,
            limits: config.limits,
            moving: false,
            answerable: false,
            pending: false,
            sent: [0.0; JOINTS],
            commands_at_start: 0,
        })
    }

    /// The agreed version.
    pub fn version(&self) -> Version {
        self.link.version
    }

    /// The robot's address.
    pub fn peer(&self) -> IpAddr {
        self.link.peer()
    }

    /// What went over the wire so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.link.statistics
    }

    /// Whether a motion of this client runs, as far as it knows.
    pub fn is_moving(&self) -> bool {
        self.moving
    }

    /// The robot model in URDF; `None` before version 8, which has no such request.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot does not answer or refuses.
    pub fn robot_model(&mut self) -> Result<Option<String>, ClientError> {
        self.link.robot_model()
    }

    /// Sets the thresholds of contact and collision. The robot keeps them until it is restarted.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot does not answer or refuses.
    pub fn set_collision_behavior(&mut self, behavior: &CollisionBehavior) -> Result<(), ClientError> {
        self.link.request(&Request::SetCollisionBehavior(*behavior)).map(|_| ())
    }

    /// Sets the load at the flange. Call it before the first motion: the robot's gravity compensation uses it.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot does not answer or refuses.
    pub fn set_load(&mut self, load: &FlangeLoad) -> Result<(), ClientError> {
        self.link.request(&Request::SetLoad(*load)).map(|_| ())
    }

    /// Clears the errors of a reflex and waits until the robot is idle.
    ///
    /// # Errors
    /// [`ClientError::Refused`] if a person must act first (user stop, joint beyond its limit), [`ClientError::NotReady`]
    /// if the robot does not become idle.
    pub fn recover(&mut self) -> Result<(), ClientError> {
        self.moving = false;
        self.answerable = false;
        self.link.request(&Request::AutomaticErrorRecovery)?;
        let deadline = self.link.machine.now() + TRANSITION;
        while self.link.newest.robot_mode != RobotMode::Idle {
            self.link.receive()?;
            if self.link.machine.now() > deadline {
                return Err(self.not_ready());
            }
        }
        Ok(())
    }

    /// Asks the robot to clear the errors of a reflex, and does not wait: the robot's mode in the coming states and
    /// [`recovery_answer`](Self::recovery_answer) tell how it went. No motion is taken to run afterwards.
    ///
    /// # Errors
    /// [`ClientError::Closed`] or [`ClientError::Io`] if the request cannot be sent.
    pub fn request_recovery(&mut self) -> Result<(), ClientError> {
        self.moving = false;
        self.answerable = false;
        self.link.tcp.post(&Request::AutomaticErrorRecovery)
    }

    /// How the robot answered [`request_recovery`](Self::request_recovery), once; `None` before. Waits for at most a
    /// millisecond, and allocates: not for the loop of a motion.
    ///
    /// # Errors
    /// A [`ClientError`] if the connection is lost or the response is none.
    pub fn recovery_answer(&mut self) -> Result<Option<Status>, ClientError> {
        self.link.tcp.posted_answer(LOOK)
    }

    /// Starts a torque motion and waits until the robot shows it. The next [`exchange`](Self::exchange) answers the
    /// first state of the motion.
    ///
    /// # Errors
    /// [`ClientError::NotReady`] if the robot is not idle, [`ClientError::Refused`] if it refuses the motion,
    /// [`ClientError::Ended`] if the motion ends at once.
    pub fn start_torque_motion(&mut self) -> Result<(), ClientError> {
        self.link.receive()?;
        if self.link.newest.robot_mode != RobotMode::Idle {
            return Err(self.not_ready());
        }
        self.link
            .request(&Request::Move(MoveRequest::torque(self.link.version)))?;
        // The robot moves from here on, whatever the states still show.
        self.moving = true;
        let deadline = self.link.machine.now() + TRANSITION;
        loop {
            self.link.receive()?;
            let state = &self.link.newest;
            if state.torque_motion_runs(self.link.version) {
                break;
            }
            // The states before the motion still show Idle.
            if !matches!(state.robot_mode, RobotMode::Idle | RobotMode::Move) {
                return Err(self.ended().into());
            }
            if self.link.machine.now() > deadline {
                self.moving = false;
                self.link.tcp.post(&Request::StopMove)?;
                return Err(self.not_ready());
            }
        }
        self.sent = self.link.newest.tau_J_d;
        self.commands_at_start = self.link.statistics.commands;
        self.answerable = true;
        self.pending = true;
        Ok(())
    }

    fn not_ready(&self) -> ClientError {
        ClientError::NotReady {
            mode: self.link.newest.robot_mode,
            errors: self.link.newest.errors.with(self.link.newest.reflex_reason),
        }
    }

    /// Waits for the robot's newest state. Works with and without a motion. Allocates nothing while a motion runs.
    ///
    /// # Errors
    /// - [`ClientError::Ended`] if a motion of this client ran and the state shows that it does not any more;
    /// - [`ClientError::Silent`] or [`ClientError::Closed`] if no state comes;
    /// - [`ClientError::Wire`] if the robot sends an invalid state.
    pub fn receive(&mut self, state: &mut RobotState) -> Result<u64, ClientError> {
        let mut missed = 0;
        if self.pending {
            self.pending = false;
        } else {
            self.answerable = false;
            missed = self.link.receive()?;
        }
        state.clone_from(&self.link.newest);
        if self.moving {
            if !state.torque_motion_runs(self.link.version) {
                return Err(self.ended().into());
            }
            let statistics = &mut self.link.statistics;
            if statistics.commands >= self.commands_at_start + WINDOW {
                let rate = state.control_command_success_rate;
                statistics.lowest_success_rate = statistics.lowest_success_rate.min(rate);
            }
            self.answerable = true;
        }
        Ok(missed)
    }

    /// Answers the newest state with these torques, without gravity and friction, N m. Each state is answered once.
    /// Allocates nothing.
    ///
    /// # Errors
    /// [`ClientError::TorqueNotFinite`] for a torque that is not finite: nothing is sent, and the state can still be
    /// answered. [`ClientError::NothingToAnswer`] if no motion runs or the newest state has been answered.
    pub fn command(&mut self, torque: &[f64; JOINTS]) -> Result<Cycle, ClientError> {
        self.answer(torque, false)
    }

    fn answer(&mut self, torque: &[f64; JOINTS], finished: bool) -> Result<Cycle, ClientError> {
        if !self.moving || !self.answerable {
            return Err(ClientError::NothingToAnswer);
        }
        if let Some(joint) = torque.iter().position(|t| !t.is_finite()) {
            return Err(ClientError::TorqueNotFinite { joint: joint + 1 });
        }
        let (torque, clamped) = self.limits.clamp(torque, &self.link.newest.tau_J_d, &self.sent);
        let mut command = RobotCommand::torque(self.link.newest.message_id, torque);
        if finished {
            command = command.finished(self.link.version);
        }
        self.answerable = false;
        self.link.send(&command)?;
        self.sent = torque;
        self.link.statistics.rate_limited += u64::from(clamped.rate);
        self.link.statistics.torque_limited += u64::from(clamped.torque);
        Ok(Cycle {
            missed: 0,
            rate_limited: clamped.rate,
            torque_limited: clamped.torque,
        })
    }

    /// One period: waits for the newest state, calls the control law with it and answers. Allocates nothing.
    ///
    /// # Errors
    /// Those of [`receive`](Self::receive) and [`command`](Self::command).
    pub fn exchange(
        &mut self,
        state: &mut RobotState,
        law: impl FnOnce(&RobotState) -> [f64; JOINTS],
    ) -> Result<Cycle, ClientError> {
        let missed = self.receive(state)?;
        let torque = law(state);
        let cycle = self.command(&torque)?;
        Ok(Cycle { missed, ..cycle })
    }

    /// Ends the motion in good order: the robot holds its pose. The arm must be at rest. The last torque is repeated
    /// with the flag that ends the motion until the robot shows the end.
    ///
    /// # Errors
    /// [`ClientError::Ended`] if the motion ends in another way, [`ClientError::NoResponse`] if the robot does not end
    /// it.
    pub fn finish(&mut self) -> Result<(), ClientError> {
        if !self.moving {
            return Ok(());
        }
        let deadline = self.link.machine.now() + TRANSITION;
        self.pending = false;
        loop {
            self.answerable = false;
            self.link.receive()?;
            if !self.link.newest.torque_motion_runs(self.link.version) {
                break;
            }
            if self.link.machine.now() > deadline {
                self.moving = false;
                self.link.tcp.post(&Request::StopMove)?;
                return Err(ClientError::NoResponse {
                    command: crate::wire::CommandKind::Move,
                    after: TRANSITION,
                });
            }
            self.answerable = true;
            let torque = self.sent;
            self.answer(&torque, true)?;
        }
        let end = self.ended();
        if end.status == Some(Status::Success) {
            Ok(())
        } else {
            Err(end.into())
        }
    }

    /// Stops the motion at once. From the call on no torque is sent. The robot brakes and holds its pose.
    ///
    /// # Errors
    /// [`ClientError::Refused`] if the robot is in a mode without a motion; other [`ClientError`]s if it cannot be
    /// reached. No motion is taken to run afterwards, whatever the result.
    pub fn stop(&mut self) -> Result<(), ClientError> {
        let was_moving = std::mem::replace(&mut self.moving, false);
        self.answerable = false;
        self.pending = false;
        if !was_moving {
            return Ok(());
        }
        self.link.request(&Request::StopMove)?;
        let deadline = self.link.machine.now() + TRANSITION;
        while self.link.newest.torque_motion_runs(self.link.version) && self.link.machine.now() < deadline {
            self.link.receive()?;
        }
        self.link.tcp.motion_end(TRANSITION).map(|_| ())
    }

    /// The motion has ended: asks how. Nothing is sent from here on until the next start.
    fn ended(&mut self) -> MotionEnd {
        self.moving = false;
        self.answerable = false;
        self.pending = false;
        // A connection that breaks just now is no reason to hide how the motion ended.
        let status = self.link.tcp.motion_end(TRANSITION).unwrap_or(None);
        let state = &self.link.newest;
        MotionEnd {
            cause: EndCause::new(status, state.robot_mode),
            errors: state.errors.with(state.reflex_reason),
            mode: state.robot_mode,
            status,
            success_rate: self.link.statistics.lowest_success_rate,
        }
    }
}

impl Drop for Client {
    /// Stops a motion that still runs, then closes the connection.
    fn drop(&mut self) {
        if self.moving {
            // The connection may be gone; then the robot stops by itself, because commands stay away.
            let _ = self.link.tcp.post(&Request::StopMove);
        }
        self.link.tcp.shut_down();
    }
}
