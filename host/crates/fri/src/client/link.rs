//! The socket: what [`Client`](super::Client) and [`ReadOnlyClient`](super::ReadOnlyClient) share.

use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;

use spherecal_cyclic::Inbox;

use super::{ClientConfig, ClientError, VelocityFilter};
use crate::JOINTS;
use crate::wire::{
    Checksum, CommandMessage, Framing, IpoData, MAX_DATAGRAM_SIZE, MAX_MESSAGE_SIZE, MonitoringMessage, SessionState,
};

/// Cut-off frequency of the velocity filter, Hz: see [`VelocityFilter`].
const VELOCITY_CUTOFF_HZ: f64 = 100.0;
/// Messages older than the newest by no more than this are late or out of order. What is older still comes from a
/// restarted cabinet.
const REORDERED: u32 = 100;

/// What went over the wire since the client listens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct LinkStatistics {
    /// Messages received in order.
    pub messages: u64,
    /// Messages that never came, by the gaps of the sequence counter.
    pub missed: u64,
    /// The longest gap: missed messages in a row.
    pub longest_gap: u64,
    /// Messages that came, but only together with a newer one: they were not answered.
    pub superseded: u64,
    /// Messages skipped because a newer one had come: late, repeated or out of order.
    pub stale: u64,
    /// Datagrams from another host than the cabinet.
    pub foreign: u64,
    /// Messages whose checksum differs from ours.
    pub checksum_differs: u64,
    /// Restarts of the cabinet.
    pub restarts: u64,
    /// Commands sent, mirrored ones included.
    pub commands: u64,
    /// Commands that the cabinet did not receive, by the gaps of the reflected sequence counter.
    pub commands_lost: u64,
    /// Commands of which a torque changed too fast and was clamped.
    pub rate_limited: u64,
    /// Commands of which a torque exceeded its limit and was clamped.
    pub torque_limited: u64,
}

/// What a receive found out.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Received {
    /// Periods without an answer before this message.
    pub(super) missed: u64,
    /// The cabinet was restarted.
    pub(super) restarted: bool,
}

pub(super) struct ClientLink {
    pub(super) statistics: LinkStatistics,
    pub(super) state: MonitoredState,
    inbox: Inbox<{ MAX_DATAGRAM_SIZE + 1 }>,
    cabinet: Option<IpAddr>,
    answer_to: Option<SocketAddr>,
    newest: Option<MonitoringMessage>,
    /// How the cabinet frames its messages: the answers have the same frame.
    framing: Framing,
    filter: VelocityFilter,
    /// Messages since the last answer.
    unanswered: u32,
    sequence: u32,
    reflected: Option<u32>,
    checksum: bool,
}

impl ClientLink {
    pub(super) fn open(config: &ClientConfig) -> Result<Self, ClientError> {
        let address = config.address;
        let machine = &config.machine;
        let udp = machine.datagrams(address);
        let udp = udp.map_err(|source| ClientError::Listen { address, source })?;
        let inbox = Inbox::new(
            Arc::clone(machine),
            udp,
            config.timeout,
            config.spin,
            config.busy_poll_us,
        )?;
        Ok(Self {
            statistics: LinkStatistics::default(),
            state: MonitoredState::default(),
            inbox,
            cabinet: config.cabinet,
            answer_to: None,
            newest: None,
            framing: Framing::default(),
            filter: VelocityFilter::new(VELOCITY_CUTOFF_HZ),
            unanswered: 0,
            sequence: 0,
            reflected: None,
            checksum: config.checksum,
        })
    }

    pub(super) fn address(&self) -> Result<SocketAddr, ClientError> {
        Ok(self.inbox.address()?)
    }

    /// The cabinet's address, once it is known.
    pub(super) fn cabinet(&self) -> Option<IpAddr> {
        self.cabinet
    }

    /// Waits for a message that is newer than the last one, takes the newest that has come, and updates `self.state`.
    /// Allocates nothing.
    pub(super) fn receive(&mut self) -> Result<Received, ClientError> {
        let mut found = Received::default();
        let messages_before = self.statistics.messages;
        let mut taken = false;
        let mut wait = self.inbox.wait()?;
        while let Some((size, from)) = self.inbox.next(&mut wait, taken)? {
            taken |= self.take(size, from, &mut found)?;
        }
        if !taken {
            let after = self.inbox.waited(&wait);
            return Err(ClientError::Silent { after });
        }
        let superseded = self.statistics.messages - messages_before - 1;
        self.statistics.superseded += superseded;
        found.missed += superseded;
        Ok(found)
    }

    /// Takes a datagram if it is a message newer than the last one.
    fn take(&mut self, size: usize, from: SocketAddr, found: &mut Received) -> Result<bool, ClientError> {
        if self.cabinet.is_some_and(|cabinet| cabinet != from.ip()) {
            self.statistics.foreign += 1;
            return Ok(false);
        }
        let (framing, bytes, checksum) = Framing::open(self.inbox.bytes(size));
        let message = MonitoringMessage::decode(bytes)?;
        let mut steps = 1;
        if let Some(last) = &self.newest {
            let ahead = message.sequence.wrapping_sub(last.sequence);
            let behind = last.sequence.wrapping_sub(message.sequence);
            if behind <= REORDERED {
                self.statistics.stale += 1;
                return Ok(false);
            }
            if ahead > u32::MAX / 2 {
                found.restarted = true;
                self.statistics.restarts += 1;
                self.filter.reset();
                self.reflected = None;
            } else {
                let gap = u64::from(ahead - 1);
                steps = ahead;
                found.missed += gap;
                self.statistics.missed += gap;
                self.statistics.longest_gap = self.statistics.longest_gap.max(gap);
            }
        }
        self.statistics.messages += 1;
        self.framing = framing;
        let ends = [Some(checksum), message.end.map(|end| end.checksum)];
        if ends.contains(&Some(Checksum::Differs)) {
            self.statistics.checksum_differs += 1;
        }
        self.cabinet.get_or_insert(from.ip());
        self.answer_to = Some(from);
        self.count_reflected(message.reflected_sequence);
        self.unanswered = self.unanswered.saturating_add(1);
        let period = f64::from(message.connection.send_period_ms.unwrap_or(1).max(1)) * 1e-3;
        let dq = self
            .filter
            .update(&message.measured_position, f64::from(steps) * period);
        self.state = MonitoredState { message, dq };
        self.newest = Some(message);
        Ok(true)
    }

    /// Counts the commands that the cabinet did not receive.
    fn count_reflected(&mut self, reflected: u32) {
        // Before the first command there is nothing to reflect.
        if self.statistics.commands == 0 {
            return;
        }
        if let Some(before) = self.reflected {
            let steps = reflected.wrapping_sub(before);
            if (2..u32::MAX / 2).contains(&steps) {
                self.statistics.commands_lost += u64::from(steps - 1);
            }
        }
        self.reflected = Some(reflected);
    }

    /// Whether the newest message is due for an answer: each n-th is.
    pub(super) fn answer_is_due(&self) -> bool {
        let multiplier = self.state.message.connection.receive_multiplier.unwrap_or(1).max(1);
        self.newest.is_some() && self.unanswered >= multiplier
    }

    /// The answer of the monitoring states: the commanded position back, or where the cabinet does not send one, the
    /// measured one.
    pub(super) fn mirror_monitoring(&mut self) -> Result<bool, ClientError> {
        let monitoring = matches!(
            self.state.message.connection.session,
            SessionState::MonitoringWait | SessionState::MonitoringReady
        );
        if !monitoring || !self.answer_is_due() {
            return Ok(false);
        }
        let position = self
            .state
            .message
            .commanded_position
            .unwrap_or(self.state.message.measured_position);
        self.send(position, None)?;
        Ok(true)
    }

    /// Answers the newest message. Allocates nothing.
    pub(super) fn send(&mut self, position: [f64; JOINTS], torque: Option<[f64; JOINTS]>) -> Result<(), ClientError> {
        let (Some(to), Some(newest)) = (self.answer_to, &self.newest) else {
            return Err(ClientError::NothingToAnswer);
        };
        let command = CommandMessage {
            sequence: self.sequence,
            reflected_sequence: newest.sequence,
            joint_position: Some(position),
            wrench: None,
            joint_torque: torque,
            end: None,
        };
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        let size = command.encode(&mut bytes, self.checksum)?;
        let mut datagram = [0; MAX_DATAGRAM_SIZE];
        let size = self.framing.close(&bytes[..size], &mut datagram);
        self.inbox.send(&datagram[..size], to)?;
        self.sequence = self.sequence.wrapping_add(1);
        self.unanswered = 0;
        self.statistics.commands += 1;
        Ok(())
    }
}

/// The robot after one monitoring message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MonitoredState {
    /// The message. What the cabinet did not send is `None`: unknown.
    pub message: MonitoringMessage,
    /// Joint velocities, differentiated and filtered by the client (see [`VelocityFilter`](super::VelocityFilter)),
    /// rad/s.
    pub dq: [f64; JOINTS],
}

impl MonitoredState {
    /// The cabinet's interpolator; it sends one while commanding.
    pub fn ipo(&self) -> IpoData {
        self.message.ipo.unwrap_or_default()
    }

    /// Whether the robot follows commands, or is about to.
    pub fn is_commanding(&self) -> bool {
        matches!(
            self.message.connection.session,
            SessionState::CommandingWait | SessionState::CommandingActive
        )
    }

    /// The time between two messages, s. The cabinet sends it; 1 ms where it does not.
    pub fn period_s(&self) -> f64 {
        f64::from(self.message.connection.send_period_ms.unwrap_or(1).max(1)) * 1e-3
    }
}

/// A session that only watches. In the monitoring states it mirrors positions back, so that the cabinet rates the
/// connection. It answers no commanding state, so a motion that waits for the client cannot begin.
pub struct ReadOnlyClient {
    link: ClientLink,
}

impl ReadOnlyClient {
    /// Listens for the cabinet.
    ///
    /// # Errors
    /// [`ClientError::Listen`] if the port cannot be opened.
    pub fn listen(config: &ClientConfig) -> Result<Self, ClientError> {
        Ok(Self {
            link: ClientLink::open(config)?,
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> Result<SocketAddr, ClientError> {
        self.link.address()
    }

    /// What went over the wire so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.link.statistics
    }

    /// Waits for the cabinet's next message and mirrors it where the session is monitoring. Returns how many periods
    /// went by without an answer before it. Allocates nothing.
    ///
    /// # Errors
    /// [`ClientError::Silent`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self, state: &mut MonitoredState) -> Result<u64, ClientError> {
        let received = self.link.receive()?;
        state.clone_from(&self.link.state);
        self.link.mirror_monitoring()?;
        Ok(received.missed)
    }
}
