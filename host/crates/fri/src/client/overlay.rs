//! The client that commands a torque overlay.

use std::net::{IpAddr, SocketAddr};

use super::link::ClientLink;
use super::{ClientConfig, ClientError, CommandingEnd, EndCause, LinkStatistics, MonitoredState, TorqueLimits};
use crate::JOINTS;
use crate::wire::{ClientCommandMode, DriveState, SafetyState, SessionState};

/// What one exchange did.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cycle {
    /// Periods before this one that went by without an answer.
    pub missed: u64,
    /// An answer was sent.
    pub answered: bool,
    /// The answer carried the torques of the control law.
    pub commanded: bool,
    /// A torque changed too fast and was clamped.
    pub rate_limited: bool,
    /// A torque exceeded its limit and was clamped.
    pub torque_limited: bool,
}

/// A session that can command.
pub struct Client {
    link: ClientLink,
    limits: TorqueLimits,
    enabled: bool,
    /// The session's state while the client was enabled, to tell a fall from a rise.
    before: SessionState,
    sent: [f64; JOINTS],
    /// The newest message may be answered with torques.
    answerable: bool,
}

impl Client {
    /// Listens for the cabinet. Nothing is commanded until [`enable`](Self::enable).
    ///
    /// # Errors
    /// [`ClientError::Listen`] if the port cannot be opened.
    pub fn listen(config: &ClientConfig) -> Result<Self, ClientError> {
        Ok(Self {
            link: ClientLink::open(config)?,
            limits: config.limits,
            enabled: false,
            before: SessionState::Idle,
            sent: [0.0; JOINTS],
            answerable: false,
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> Result<SocketAddr, ClientError> {
        self.link.address()
    }

    /// The cabinet's address; `None` before its first message.
    pub fn cabinet(&self) -> Option<IpAddr> {
        self.link.cabinet()
    }

    /// What went over the wire so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.link.statistics
    }

    /// Whether the client answers commanding states.
    pub fn is_enabled(&self) -> bool {
        self.enabled
    }

    /// Permits commands from the next message on. Call it after a first [`exchange`](Self::exchange).
    ///
    /// # Errors
    /// [`ClientError::NotReady`] if the newest message shows a safety stop or does not tell.
    pub fn enable(&mut self) -> Result<(), ClientError> {
        match self.link.state.message.robot.safety {
            Some(SafetyState::NormalOperation) => {}
            Some(stop) => return Err(ClientError::NotReady(EndCause::SafetyStop(stop))),
            None => return Err(ClientError::NotReady(EndCause::SafetyUnknown)),
        }
        self.enabled = true;
        self.before = self.link.state.message.connection.session;
        self.sent = [0.0; JOINTS];
        Ok(())
    }

    /// Forbids commands from now on. A running motion is not answered any more: the cabinet ends it with its brakes.
    pub fn disable(&mut self) {
        self.enabled = false;
        self.answerable = false;
        self.sent = [0.0; JOINTS];
    }

    /// Waits for the newest message. Answers it by the rules of the session where the answer carries no torque: the
    /// monitoring states, and COMMANDING_WAIT if enabled. A message of COMMANDING_ACTIVE waits for
    /// [`command`](Self::command). Allocates nothing.
    ///
    /// # Errors
    /// - [`ClientError::Ended`] if the client was enabled and the robot may not be commanded any more;
    /// - [`ClientError::Silent`] if no message comes; the client stays enabled, and the next message decides;
    /// - [`ClientError::Wire`] if the cabinet sends an invalid message.
    pub fn receive(&mut self, state: &mut MonitoredState) -> Result<Cycle, ClientError> {
        self.answerable = false;
        let received = self.link.receive()?;
        state.clone_from(&self.link.state);
        let mut cycle = Cycle {
            missed: received.missed,
            ..Cycle::default()
        };
        if self.enabled
            && let Some(cause) = self.end_cause(received.restarted)
        {
            self.disable();
            // The connection goes on: the monitoring states are answered as ever.
            self.link.mirror_monitoring()?;
            return Err(CommandingEnd {
                cause,
                session: state.message.connection.session,
                quality: state.message.connection.quality,
            }
            .into());
        }
        self.before = state.message.connection.session;
        if state.message.connection.session == SessionState::CommandingActive {
            self.answerable = self.enabled && self.link.answer_is_due();
            return Ok(cycle);
        }
        self.sent = [0.0; JOINTS];
        if state.message.connection.session == SessionState::CommandingWait {
            if self.enabled && self.link.answer_is_due() {
                self.link.send(mirrored(state), Some(self.sent))?;
                cycle.answered = true;
            }
        } else {
            cycle.answered = self.link.mirror_monitoring()?;
        }
        Ok(cycle)
    }

    /// Whether the newest message may be answered with torques: enabled, in COMMANDING_ACTIVE, an answer is due.
    pub fn is_answerable(&self) -> bool {
        self.answerable
    }

    /// Answers the newest message with these torques, without gravity, N m. Each message is answered once. Allocates
    /// nothing.
    ///
    /// # Errors
    /// [`ClientError::TorqueNotFinite`] for a torque that is not finite: nothing is sent, and the message can still be
    /// answered. [`ClientError::NothingToAnswer`] if no torque may be sent now.
    pub fn command(&mut self, torque: &[f64; JOINTS]) -> Result<Cycle, ClientError> {
        if !self.answerable {
            return Err(ClientError::NothingToAnswer);
        }
        if let Some(joint) = torque.iter().position(|t| !t.is_finite()) {
            return Err(ClientError::TorqueNotFinite { joint: joint + 1 });
        }
        let mut cycle = Cycle {
            answered: true,
            commanded: true,
            ..Cycle::default()
        };
        self.answerable = false;
        self.clamp(torque, &mut cycle);
        self.link.send(mirrored(&self.link.state), Some(self.sent))?;
        Ok(cycle)
    }

    /// One period: waits for the newest message and answers it by the rules of the session. `law` is called only where
    /// its torques are sent: enabled, in COMMANDING_ACTIVE, when an answer is due. Allocates nothing.
    ///
    /// # Errors
    /// Those of [`receive`](Self::receive) and [`command`](Self::command).
    pub fn exchange(
        &mut self,
        state: &mut MonitoredState,
        law: impl FnOnce(&MonitoredState) -> [f64; JOINTS],
    ) -> Result<Cycle, ClientError> {
        let cycle = self.receive(state)?;
        if !self.answerable {
            return Ok(cycle);
        }
        let commanded = self.command(&law(state))?;
        Ok(Cycle {
            missed: cycle.missed,
            ..commanded
        })
    }

    /// Why the robot may not be commanded any more.
    fn end_cause(&self, restarted: bool) -> Option<EndCause> {
        let state = &self.link.state;
        if restarted {
            return Some(EndCause::Restarted);
        }
        match state.message.robot.safety {
            Some(SafetyState::NormalOperation) => {}
            Some(stop) => return Some(EndCause::SafetyStop(stop)),
            None => return Some(EndCause::SafetyUnknown),
        }
        let rank = |session: SessionState| match session {
            SessionState::Idle | SessionState::MonitoringWait | SessionState::MonitoringReady => 0,
            SessionState::CommandingWait => 1,
            SessionState::CommandingActive => 2,
        };
        if rank(state.message.connection.session) < rank(self.before) {
            return Some(EndCause::SessionFell {
                from: self.before,
                to: state.message.connection.session,
            });
        }
        if state.message.connection.session == SessionState::CommandingActive {
            if state
                .message
                .robot
                .drives
                .is_some_and(|drives| drives.contains(&DriveState::Off))
            {
                return Some(EndCause::DrivesOff);
            }
            if let Some(mode) = state.ipo().command_mode
                && mode != ClientCommandMode::Torque
            {
                return Some(EndCause::CommandMode(mode));
            }
        }
        None
    }

    /// Brings the torques within the limits and keeps them as the last ones sent.
    fn clamp(&mut self, wanted: &[f64; JOINTS], cycle: &mut Cycle) {
        let state = &self.link.state;
        let answers_apart = f64::from(state.message.connection.receive_multiplier.unwrap_or(1).max(1));
        let step = self.limits.torque_rate * state.period_s() * answers_apart;
        for joint in 0..JOINTS {
            let limit = self.limits.torque[joint];
            let within = wanted[joint].max(-limit).min(limit);
            let next = within.max(self.sent[joint] - step).min(self.sent[joint] + step);
            cycle.torque_limited |= within != wanted[joint];
            cycle.rate_limited |= next != within;
            self.sent[joint] = next;
        }
        self.link.statistics.rate_limited += u64::from(cycle.rate_limited);
        self.link.statistics.torque_limited += u64::from(cycle.torque_limited);
    }
}

/// The position to answer with. The interpolated position must be mirrored, or the session falls back.
fn mirrored(state: &MonitoredState) -> [f64; JOINTS] {
    state.ipo().joint_position.unwrap_or(state.message.measured_position)
}
