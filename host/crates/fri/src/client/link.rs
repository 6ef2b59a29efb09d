//! The socket: what [`Client`](super::Client) and [`Observer`](super::Observer) share.

use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

use super::{ClientError, Config, State, VelocityFilter};
use crate::JOINTS;
use crate::wire::{Checksum, CommandMessage, MAX_MESSAGE_SIZE, MonitoringMessage, SessionState};

/// Messages older than the newest by no more than this are late or out of order. What is older still comes from a
/// restarted cabinet.
const REORDERED: u32 = 100;

/// What went over the wire since the client listens.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Statistics {
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

pub(super) struct Link {
    pub(super) statistics: Statistics,
    pub(super) state: State,
    udp: UdpSocket,
    cabinet: Option<IpAddr>,
    answer_to: Option<SocketAddr>,
    newest: Option<MonitoringMessage>,
    filter: VelocityFilter,
    /// Messages since the last answer.
    unanswered: u32,
    sequence: u32,
    reflected: Option<u32>,
    received: [u8; MAX_MESSAGE_SIZE + 1],
    timeout: Duration,
    spin: Duration,
    checksum: bool,
}

pub(super) fn io(action: &'static str) -> impl Fn(std::io::Error) -> ClientError {
    move |source| ClientError::Io { action, source }
}

impl Link {
    pub(super) fn open(config: &Config) -> Result<Self, ClientError> {
        let address = config.address;
        let udp = UdpSocket::bind(address).map_err(|source| ClientError::Listen { address, source })?;
        udp.set_read_timeout(Some(config.timeout.max(Duration::from_micros(1))))
            .map_err(io("set a timeout"))?;
        busy_poll(&udp, config)?;
        Ok(Self {
            statistics: Statistics::default(),
            state: State::default(),
            udp,
            cabinet: config.cabinet,
            answer_to: None,
            newest: None,
            filter: VelocityFilter::new(config.velocity_cutoff_hz),
            unanswered: 0,
            sequence: 0,
            reflected: None,
            received: [0; MAX_MESSAGE_SIZE + 1],
            timeout: config.timeout,
            spin: config.spin,
            checksum: config.checksum,
        })
    }

    pub(super) fn address(&self) -> Result<SocketAddr, ClientError> {
        self.udp.local_addr().map_err(io("read the port"))
    }

    /// Waits for a message that is newer than the last one, takes the newest that has come, and updates `self.state`.
    /// Allocates nothing.
    pub(super) fn receive(&mut self) -> Result<Received, ClientError> {
        let mut found = Received::default();
        let messages_before = self.statistics.messages;
        let start = Instant::now();
        let spin_end = start + self.spin;
        let mut taken = false;
        self.udp.set_nonblocking(true).map_err(io("use the UDP port"))?;
        loop {
            match self.udp.recv_from(&mut self.received) {
                Ok((size, from)) => taken |= self.take(size, from, &mut found)?,
                Err(error) if error.kind() == ErrorKind::WouldBlock => {
                    if taken || Instant::now() >= spin_end {
                        break;
                    }
                    std::hint::spin_loop();
                }
                Err(error) if retry(&error) => {}
                Err(error) => return Err(io("receive a message")(error)),
            }
        }
        if !taken {
            self.udp.set_nonblocking(false).map_err(io("use the UDP port"))?;
            while !taken {
                match self.udp.recv_from(&mut self.received) {
                    Ok((size, from)) => taken = self.take(size, from, &mut found)?,
                    Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                        return Err(ClientError::Silent { after: start.elapsed() });
                    }
                    Err(error) if retry(&error) => {}
                    Err(error) => return Err(io("receive a message")(error)),
                }
                // Old or foreign datagrams must not keep the client waiting for ever.
                if !taken && start.elapsed() > self.timeout {
                    return Err(ClientError::Silent { after: start.elapsed() });
                }
            }
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
        let message = MonitoringMessage::decode(&self.received[..size])?;
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
        if message.end.is_some_and(|end| end.checksum == Checksum::Differs) {
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
        self.state = State::new(&message, dq);
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
        let multiplier = self.state.receive_multiplier.unwrap_or(1).max(1);
        self.newest.is_some() && self.unanswered >= multiplier
    }

    /// The answer of the monitoring states: the commanded position back, or where the cabinet does not send one, the
    /// measured one.
    pub(super) fn mirror_monitoring(&mut self) -> Result<bool, ClientError> {
        let monitoring = matches!(
            self.state.session,
            SessionState::MonitoringWait | SessionState::MonitoringReady
        );
        if !monitoring || !self.answer_is_due() {
            return Ok(false);
        }
        let position = self.state.commanded_position.unwrap_or(self.state.q);
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
        self.udp.send_to(&bytes[..size], to).map_err(io("send a command"))?;
        self.sequence = self.sequence.wrapping_add(1);
        self.unanswered = 0;
        self.statistics.commands += 1;
        Ok(())
    }
}

/// Errors of a UDP socket after which it works on: a signal, or an answer that met a closed port.
fn retry(error: &std::io::Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset
    )
}

#[cfg(target_os = "linux")]
fn busy_poll(udp: &UdpSocket, config: &Config) -> Result<(), ClientError> {
    if let Some(us) = config.busy_poll_us {
        socket2::SockRef::from(udp)
            .set_busy_poll(us)
            .map_err(io("set SO_BUSY_POLL; it may need the right CAP_NET_ADMIN"))?;
    }
    Ok(())
}

#[cfg(not(target_os = "linux"))]
fn busy_poll(_udp: &UdpSocket, config: &Config) -> Result<(), ClientError> {
    match config.busy_poll_us {
        None => Ok(()),
        Some(_) => Err(io("set SO_BUSY_POLL")(std::io::Error::from(ErrorKind::Unsupported))),
    }
}
