//! The cabinet's side on the network: UDP and the clock, as a process of its own.

use std::io::ErrorKind;
use std::net::{IpAddr, Ipv4Addr, Ipv6Addr};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, AtomicU8, Ordering};
use std::time::{Duration, Instant};

use spherecal_cyclic::{Datagrams, PeriodClock, Process, Published, Side};

use super::arm::ArmHardware;
use super::cabinet::Cabinet;
use super::config::CabinetConfig;
use crate::wire::{CommandMessage, Framing, MAX_DATAGRAM_SIZE, MAX_MESSAGE_SIZE, Quality, SafetyState, SessionState};

/// How often a patient cabinet looks for an answer that is late.
const LOOK: Duration = Duration::from_micros(100);

/// What the cabinet counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct CabinetStatistics {
    /// Periods that the cabinet lived through.
    pub periods: u64,
    /// Periods by which its clock fell behind the time, because its thread was late or waited.
    pub slipped: u64,
    /// Messages answered in time.
    pub answered: u64,
    /// Periods of COMMANDING_WAIT and COMMANDING_ACTIVE without an answer in time, where one was due.
    pub missing: u64,
    /// Answers that came too late: they answer an older message.
    pub late: u64,
    /// Datagrams that are no command message, or in another frame than the cabinet's.
    pub malformed: u64,
    /// Answers with a torque other than zero to a message outside COMMANDING_ACTIVE. A client must never send one.
    pub torques_after_stop: u64,
    /// The largest overlay, N m.
    pub largest_torque: f64,
    /// The session's state now; `None` before the first period.
    pub session: Option<SessionState>,
    /// The connection's quality now.
    pub quality: Option<Quality>,
}

/// What application, persons and safety functions do. Every change acts within a period.
#[derive(Debug, Default)]
pub struct Controls {
    /// The application wants its motion. After a motion has ended, off and on again starts the next.
    pub command: AtomicBool,
    /// The safety stop's level plus one, as in `safetyState`: 0 is normal operation.
    pub safety: AtomicU8,
    /// A person guides the arm by hand.
    pub guiding: AtomicBool,
}

/// A running cabinet. It ends when it is dropped.
pub type CabinetSide = Side<Controls, CabinetStatistics>;

/// Opens the session and starts the clock.
///
/// # Errors
/// What the system says if no port can be opened.
pub fn start_cabinet(config: CabinetConfig, arm: Box<dyn ArmHardware>) -> std::io::Result<CabinetSide> {
    let machine = Arc::clone(&config.machine);
    let any: IpAddr = match config.client.ip() {
        IpAddr::V4(_) => Ipv4Addr::UNSPECIFIED.into(),
        IpAddr::V6(_) => Ipv6Addr::UNSPECIFIED.into(),
    };
    let udp = machine.datagrams(config.address.unwrap_or((any, 0).into()))?;
    let address = udp.address()?;
    let period = Duration::from_millis(config.send_period_ms.max(1).into());
    let clock = PeriodClock::start(period, machine.now());
    Side::start(machine.as_ref(), "fri-cabinet", address, |shared| {
        let mut server = CabinetServer {
            cabinet: Cabinet::new(config.clone(), arm.state()),
            clock,
            config,
            udp,
            arm,
            answer: None,
            sent: SessionState::Idle,
            count: CabinetStatistics::default(),
            shared,
        };
        server.send();
        server
    })
}

struct CabinetServer {
    config: CabinetConfig,
    cabinet: Cabinet,
    clock: PeriodClock,
    udp: Box<dyn Datagrams>,
    arm: Box<dyn ArmHardware>,
    /// The answer to the newest message, once it has come.
    answer: Option<CommandMessage>,
    /// The session's state in the newest message.
    sent: SessionState,
    count: CabinetStatistics,
    shared: Arc<Published<Controls, CabinetStatistics>>,
}

impl Process for CabinetServer {
    /// Waits for the end of the period, and while commanding as long as the cabinet is patient, for the answer to the
    /// newest message.
    fn turn(&mut self, now: Instant) -> Instant {
        if now < self.clock.end() {
            return self.clock.end();
        }
        self.take_commands();
        let waits = self.cabinet.is_commanding() && self.cabinet.answer_is_due();
        if self.answer.is_none() && waits && self.clock.is_patient(now, self.config.tolerance.patience) {
            return now + LOOK;
        }
        self.clock.advance(now);
        self.period();
        self.clock.end()
    }
}

impl CabinetServer {
    fn period(&mut self) {
        let controls = &self.shared.controls;
        let safety = SafetyState::from_number(controls.safety.load(Ordering::Relaxed).into());
        self.cabinet.set_controls(
            controls.command.load(Ordering::Relaxed),
            // A level that does not exist is taken for the strictest stop.
            safety.unwrap_or(SafetyState::StopLevel0),
            controls.guiding.load(Ordering::Relaxed),
        );
        let answer = self.answer.take();
        let due = self.cabinet.answer_is_due();
        if answer.is_some() {
            self.count.answered += 1;
        } else if due && self.cabinet.is_commanding() {
            self.count.missing += 1;
        }
        let command = self.cabinet.decide(answer.as_ref());
        self.arm.step(command, self.clock.period().as_secs_f64());
        self.send();
        self.count.periods += 1;
        self.count.session = Some(self.cabinet.session());
        self.count.quality = Some(self.cabinet.quality());
        self.count.slipped = self.clock.slipped();
        self.shared.publish(self.count);
    }

    fn send(&mut self) {
        let message = self.cabinet.message(&self.arm.state());
        self.sent = message.connection.session;
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        if let Ok(size) = message.encode(&mut bytes, self.config.checksum) {
            let mut datagram = [0; MAX_DATAGRAM_SIZE];
            let size = self.config.framing.close(&bytes[..size], &mut datagram);
            // A network that refuses a datagram loses it.
            let _ = self.udp.send(&datagram[..size], self.config.client);
        }
    }

    /// Takes every command that has come. The answer to the newest message counts.
    fn take_commands(&mut self) {
        let mut bytes = [0; MAX_DATAGRAM_SIZE + 1];
        loop {
            let (size, from) = match self.udp.receive(&mut bytes) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::WouldBlock => return,
                // A signal, or the last message met a closed port.
                Err(error) if matches!(error.kind(), ErrorKind::Interrupted | ErrorKind::ConnectionRefused) => continue,
                Err(_) => return,
            };
            if from.ip() != self.config.client.ip() {
                continue;
            }
            let (framing, message, _) = Framing::open(&bytes[..size]);
            let command = CommandMessage::decode(message);
            let Some(command) = command.ok().filter(|_| framing == self.config.framing) else {
                self.count.malformed += 1;
                continue;
            };
            if command.reflected_sequence != self.cabinet.sequence() {
                self.count.late += 1;
                continue;
            }
            let torque = command.joint_torque.unwrap_or_default();
            let most = torque.iter().fold(0.0_f64, |most, t| most.max(t.abs()));
            if most > 0.0 && self.sent != SessionState::CommandingActive {
                self.count.torques_after_stop += 1;
            }
            self.count.largest_torque = self.count.largest_torque.max(most);
            self.answer = Some(command);
        }
    }
}
