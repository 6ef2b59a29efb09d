//! The robot side on the network: TCP, UDP and the 1 kHz clock, as a process of its own.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};
use std::time::{Duration, Instant};

use spherecal_cyclic::{Datagrams, Listener, PeriodClock, Process, Published, Side};

use super::arm::ArmHardware;
use super::config::RobotConfig;
use super::session::{ClientSession, Incoming};
use super::supervisor::RobotSupervisor;
use crate::wire::{
    CommandKind, ConnectAnswer, MAX_COMMAND_SIZE, MAX_STATE_SIZE, Request, RobotCommand, RobotMode, RobotState, Status,
    WireError,
};

const PERIOD: Duration = Duration::from_millis(1);
/// How often a patient robot looks for an answer that is late.
const LOOK: Duration = Duration::from_micros(100);

/// What the robot side counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RobotStatistics {
    /// Periods of 1 ms that the robot lived through.
    pub periods: u64,
    /// Periods by which the robot's clock fell behind the time, because its thread was late or waited.
    pub slipped: u64,
    /// Commands that answered their state in time.
    pub commands: u64,
    /// States of a motion without an answer in time.
    pub missing: u64,
    /// Commands that came too late: they answer an older state.
    pub late: u64,
    /// Datagrams that are no command of this version.
    pub malformed: u64,
    /// Commands that answer a state in which no motion ran any more. A client must never send one.
    pub commands_after_stop: u64,
    /// The most torque that a command asked for, N m.
    pub largest_torque: f64,
    /// The robot's mode now; `None` before the first period.
    pub mode: Option<RobotMode>,
    /// The load that the client has set, kg.
    pub load_kg: f64,
}

/// What a person at the robot does. Every change acts within a period.
#[derive(Debug, Default)]
pub struct Controls {
    /// The user stop is pressed.
    pub user_stop: AtomicBool,
    /// A safety function is active.
    pub safety_stop: AtomicBool,
    /// A person guides the arm by hand.
    pub guiding: AtomicBool,
}

/// A running robot side. It ends when it is dropped.
pub type RobotSide = Side<Controls, RobotStatistics>;

/// Listens and starts the robot's clock.
///
/// # Errors
/// What the system says if the address cannot be used.
pub fn start_robot(config: RobotConfig, arm: Box<dyn ArmHardware>) -> std::io::Result<RobotSide> {
    let machine = Arc::clone(&config.machine);
    let listener = machine.listen(config.address)?;
    let address = listener.address()?;
    let udp = machine.datagrams((address.ip(), 0).into())?;
    let clock = PeriodClock::start(PERIOD, machine.now());
    Side::start(machine.as_ref(), "fci-robot", address, |shared| RobotServer {
        supervisor: RobotSupervisor::new(config.clone(), arm.state()),
        model: config.model.clone().unwrap_or_else(|| super::FR3_URDF.to_owned()),
        config,
        listener,
        udp,
        arm,
        session: None,
        state: RobotState::default(),
        message_id: 0,
        answer: None,
        stopped_at: None,
        count: RobotStatistics::default(),
        clock,
        shared,
    })
}

struct RobotServer {
    config: RobotConfig,
    supervisor: RobotSupervisor,
    model: String,
    listener: Box<dyn Listener>,
    udp: Box<dyn Datagrams>,
    arm: Box<dyn ArmHardware>,
    session: Option<ClientSession>,
    state: RobotState,
    message_id: u64,
    /// The answer to the newest state, once it has come.
    answer: Option<RobotCommand>,
    /// The first state that showed the end of the last motion.
    stopped_at: Option<u64>,
    count: RobotStatistics,
    clock: PeriodClock,
    shared: Arc<Published<Controls, RobotStatistics>>,
}

impl Process for RobotServer {
    /// Waits for the end of the period, and in a motion as long as the robot is patient, for the answer to the newest
    /// state. Clients' requests are served meanwhile.
    fn turn(&mut self, now: Instant) -> Instant {
        if now < self.clock.end() {
            return self.clock.end();
        }
        let on = |flag: &AtomicBool| flag.load(Ordering::Relaxed);
        let controls = &self.shared.controls;
        let (user_stop, safety_stop, guiding) = (
            on(&controls.user_stop),
            on(&controls.safety_stop),
            on(&controls.guiding),
        );
        self.supervisor.set_person(user_stop, safety_stop, guiding);
        self.take_commands();
        let patience = self.config.tolerance.patience;
        if self.answer.is_none() && self.supervisor.is_moving() && self.clock.is_patient(now, patience) {
            self.serve();
            return now + LOOK;
        }
        self.clock.advance(now);
        self.period();
        self.clock.end()
    }
}

impl RobotServer {
    fn period(&mut self) {
        self.serve();
        let answer = self.answer.take();
        let was_moving = self.supervisor.is_moving();
        if was_moving && answer.is_none() {
            self.count.missing += 1;
        }
        let command = self.supervisor.decide(answer.as_ref());
        let measured = self.arm.step(command);
        self.supervisor.observe(&measured);
        self.message_id += 1;
        self.supervisor.fill(self.message_id, &mut self.state);
        if self.supervisor.is_moving() {
            self.stopped_at = None;
        } else if self.stopped_at.is_none() {
            self.stopped_at = Some(self.message_id);
        }
        for finished in self.supervisor.take_finished() {
            if let Some(session) = &mut self.session {
                session.respond(finished.command, finished.id, finished.status, &[]);
            }
        }
        self.send_state();
        self.count.periods += 1;
        self.count.mode = Some(self.state.robot_mode);
        self.count.load_kg = self.supervisor.load().mass;
        self.count.slipped = self.clock.slipped();
        self.shared.publish(self.count);
    }

    fn send_state(&mut self) {
        let Some(session) = &mut self.session else { return };
        // A response that is due leaves before the state.
        let alive = session.poll();
        if let Some(to) = session.states_to {
            let mut bytes = [0; MAX_STATE_SIZE];
            let size = self.state.encode(self.config.version, &mut bytes);
            // A network that refuses a datagram loses it.
            let _ = self.udp.send(&bytes[..size], to);
        }
        if !alive {
            self.session = None;
            self.supervisor.client_gone();
        }
    }

    /// Takes every command that has come. The answer to the newest state counts.
    fn take_commands(&mut self) {
        let mut bytes = [0; MAX_COMMAND_SIZE + 1];
        loop {
            let (size, from) = match self.udp.receive(&mut bytes) {
                Ok(received) => received,
                Err(error) if error.kind() == ErrorKind::Interrupted => continue,
                // Nothing more, or the last state met a closed port.
                Err(_) => return,
            };
            if self.session.as_ref().is_none_or(|s| s.peer() != from.ip()) {
                continue;
            }
            match RobotCommand::decode(self.config.version, &bytes[..size]) {
                Ok(command) => self.take_command(command),
                Err(WireError::NotFinite { .. }) => {
                    self.count.malformed += 1;
                    self.supervisor.invalid_command();
                }
                Err(_) => self.count.malformed += 1,
            }
        }
    }

    fn take_command(&mut self, command: RobotCommand) {
        if self.stopped_at.is_some_and(|stopped| command.message_id >= stopped) {
            self.count.commands_after_stop += 1;
        }
        if command.message_id == self.message_id {
            self.count.commands += u64::from(self.answer.is_none());
            let most = command.tau_J_d.iter().fold(0.0_f64, |most, t| most.max(t.abs()));
            self.count.largest_torque = self.count.largest_torque.max(most);
            self.answer = Some(command);
        } else {
            self.count.late += 1;
        }
    }

    /// Accepts a client and answers its requests.
    fn serve(&mut self) {
        if let Ok((stream, peer)) = self.listener.accept() {
            // A client that has left before this one came makes room for it.
            if self.session.as_mut().is_some_and(|session| !session.poll()) {
                self.session = None;
                self.supervisor.client_gone();
            }
            match &self.session {
                // One client at a time: a second one is turned away.
                Some(_) => drop(stream),
                None => self.session = Some(ClientSession::new(stream, peer, self.config.version)),
            }
        }
        let Some(mut session) = self.session.take() else { return };
        let mut alive = session.poll();
        loop {
            match session.next() {
                Ok(Some(Incoming::Request(id, request))) => self.answer_request(&mut session, id, &request),
                Ok(Some(Incoming::Invalid(id, command))) => {
                    session.respond(command, id, Status::InvalidArgument, &[]);
                }
                Ok(None) => break,
                Err(_) => {
                    alive = false;
                    break;
                }
            }
        }
        alive &= session.poll();
        if alive {
            self.session = Some(session);
        } else {
            self.supervisor.client_gone();
        }
    }

    fn answer_request(&mut self, session: &mut ClientSession, id: u32, request: &Request) {
        if let Request::Connect { version, udp_port } = request {
            let ours = self.config.version.number();
            let accepted = *version == ours;
            let status = if accepted {
                Status::Success
            } else {
                Status::IncompatibleVersion
            };
            let answer = ConnectAnswer { status, version: ours };
            session.respond(CommandKind::Connect, id, status, &answer.body());
            if accepted {
                session.states_to = Some(SocketAddr::new(session.peer(), *udp_port));
            } else {
                session.close();
            }
            return;
        }
        if session.states_to.is_none() {
            // No request before Connect.
            session.close();
            return;
        }
        let Some(status) = self.supervisor.request(id, request) else {
            return;
        };
        if let (Request::SetLoad(load), Status::Success) = (request, status) {
            self.arm.set_load(load);
        }
        // Of a Cartesian limit: two corners, a frame, inactive.
        const NO_LIMIT: [u8; 8 * 22 + 1] = [0; 8 * 22 + 1];
        let body: &[u8] = match request {
            Request::GetRobotModel => self.model.as_bytes(),
            Request::GetCartesianLimit { .. } => &NO_LIMIT,
            _ => &[],
        };
        session.respond(request.command(), id, status, body);
    }
}
