//! The robot side on the network: two ports and the clock, as a process of its own.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::{AtomicI32, Ordering};
use std::time::{Duration, Instant};

use spherecal_cyclic::{Listener, Machine, PeriodClock, Process, Published, Side, Wire};

use super::arm::ArmHardware;
use super::config::RobotConfig;
use super::outputs::{Outputs, known};
use super::registers::Registers;
use super::session::{Session, Wanted};
use crate::PRIMARY_BELOW_RTDE;
use crate::wire::{
    Answer, MAX_NAMES, MAX_REQUEST, NOT_FOUND, PROTOCOL, Request, RobotMode, RuntimeState, SafetyMode, Setup,
    TextLevel, TextMessage, WireError, take_package,
};

/// Clients of each port.
const MOST_CLIENTS: usize = 8;
/// Recipes of inputs that a client may have.
const MOST_RECIPES: usize = 255;
/// Pairs of free ports that are tried.
const TRIALS: usize = 64;

/// What the robot side counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotStatistics {
    /// Periods that the robot lived through.
    pub periods: u64,
    /// Periods by which its clock fell behind the time, because its thread was late.
    pub slipped: u64,
    /// Data packages that were sent.
    pub packages: u64,
    /// Data packages with inputs that came.
    pub inputs: u64,
    /// Connections that ended by a package that is none, or by a client that does not read.
    pub broken: u64,
    /// Clients of RTDE now.
    pub clients: usize,
}

/// What persons and safety functions do. Every change acts within a period.
#[derive(Debug)]
pub struct Controls {
    /// Number of the [`RobotMode`]; at the start `RUNNING`.
    pub robot_mode: AtomicI32,
    /// Number of the [`SafetyMode`]; at the start `NORMAL`.
    pub safety_mode: AtomicI32,
    /// Number of the [`RuntimeState`]; at the start `STOPPED`.
    pub runtime_state: AtomicI32,
}

impl Default for Controls {
    fn default() -> Self {
        Self {
            robot_mode: RobotMode::Running.number().into(),
            safety_mode: SafetyMode::Normal.number().into(),
            runtime_state: RuntimeState::Stopped.number().into(),
        }
    }
}

/// A running robot side. It ends when it is dropped.
pub struct RobotSide {
    address: SocketAddr,
    side: Side<Controls, RobotStatistics>,
}

impl RobotSide {
    /// Listens at both ports and starts the robot's clock.
    ///
    /// # Errors
    /// What the system says if an address cannot be used.
    pub fn start(config: RobotConfig, arm: Box<dyn ArmHardware>) -> std::io::Result<Self> {
        let machine = Arc::clone(&config.machine);
        let (rtde, primary) = listeners(machine.as_ref(), config.address)?;
        let address = rtde.address()?;
        let period = Duration::from_secs_f64(1.0 / config.series().rate_hz());
        let clock = PeriodClock::start(period, machine.now());
        let side = Side::start(machine.as_ref(), "ur-robot", |shared| RobotServer {
            calibration: config.kinematics.encode(),
            config,
            rtde,
            primary,
            arm,
            sessions: Vec::new(),
            observers: Vec::new(),
            registers: Registers::default(),
            next: 0,
            count: RobotStatistics::default(),
            clock,
            shared,
        })?;
        Ok(Self { address, side })
    }

    /// Where RTDE listens.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What persons and safety functions do.
    pub fn controls(&self) -> &Controls {
        self.side.controls()
    }

    /// What the robot counted so far.
    pub fn statistics(&self) -> RobotStatistics {
        self.side.statistics()
    }

    /// Switches the robot off.
    pub fn shut_down(self) -> RobotStatistics {
        self.side.shut_down()
    }
}

/// The ports of RTDE and of the primary interface.
fn listeners(machine: &dyn Machine, at: SocketAddr) -> std::io::Result<(Box<dyn Listener>, Box<dyn Listener>)> {
    let mut refused = ErrorKind::AddrNotAvailable.into();
    for _ in 0..TRIALS {
        let rtde = machine.listen(at)?;
        let port = rtde.address()?.port();
        let below = port.checked_sub(PRIMARY_BELOW_RTDE).filter(|port| *port > 0);
        let primary = SocketAddr::new(at.ip(), below.ok_or(ErrorKind::AddrNotAvailable)?);
        match machine.listen(primary) {
            Ok(primary) => return Ok((rtde, primary)),
            Err(error) if at.port() != 0 => return Err(error),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

struct RobotServer {
    config: RobotConfig,
    rtde: Box<dyn Listener>,
    primary: Box<dyn Listener>,
    arm: Box<dyn ArmHardware>,
    sessions: Vec<Session>,
    observers: Vec<Wire>,
    registers: Registers,
    /// The robot state that each client of the primary interface gets.
    calibration: Vec<u8>,
    /// Number of the next client.
    next: u64,
    count: RobotStatistics,
    clock: PeriodClock,
    shared: Arc<Published<Controls, RobotStatistics>>,
}

impl Process for RobotServer {
    fn turn(&mut self, now: Instant) -> Instant {
        if now >= self.clock.end() {
            self.clock.advance(now);
            self.period();
        }
        self.clock.end()
    }
}

impl RobotServer {
    fn period(&mut self) {
        self.accept();
        self.serve();
        self.arm.step(self.clock.period().as_secs_f64());
        self.count.periods += 1;
        self.send();
        self.count.clients = self.sessions.len();
        self.count.slipped = self.clock.slipped();
        self.shared.publish(self.count);
    }

    fn accept(&mut self) {
        while let Ok((stream, _)) = self.rtde.accept() {
            if self.sessions.len() < MOST_CLIENTS {
                self.next += 1;
                self.sessions.push(Session::new(self.next, stream));
            }
        }
        while let Ok((stream, _)) = self.primary.accept() {
            if self.observers.len() < MOST_CLIENTS {
                let mut wire = Wire::new(stream);
                wire.send(&self.calibration);
                self.observers.push(wire);
            }
        }
        self.observers.retain_mut(|wire| {
            // Scripts are read and forgotten.
            let alive = wire.poll();
            wire.received.clear();
            alive
        });
    }

    fn serve(&mut self) {
        for mut session in std::mem::take(&mut self.sessions) {
            let mut alive = session.wire.poll();
            loop {
                match self.serve_one(&mut session) {
                    Ok(true) => {}
                    Ok(false) => break,
                    Err(error) => {
                        self.count.broken += 1;
                        session.answer(&text(&error.to_string()));
                        session.wire.close();
                        alive = false;
                        break;
                    }
                }
            }
            if alive {
                self.sessions.push(session);
            } else {
                self.registers.release(session.number);
            }
        }
    }

    /// Answers the next request of a client. Whether there was one.
    fn serve_one(&mut self, session: &mut Session) -> Result<bool, WireError> {
        let Some((kind, payload)) = take_package(&mut session.wire.received, MAX_REQUEST)? else {
            return Ok(false);
        };
        let answer = match Request::decode(kind, &payload)? {
            Request::ProtocolVersion(version) => {
                session.agreed = version == PROTOCOL;
                Answer::ProtocolVersion(session.agreed)
            }
            Request::ControllerVersion => Answer::ControllerVersion(self.config.version),
            _ if !session.agreed => text("only protocol 2 is spoken here: ask for it first"),
            Request::SetupOutputs { rate_hz, names } => Answer::SetupOutputs(self.outputs(session, rate_hz, names)),
            Request::SetupInputs { names } => {
                let number = session.inputs.len() + 1;
                if length(&names) > MAX_NAMES || number > MOST_RECIPES {
                    Answer::SetupInputs(Setup::default())
                } else {
                    let (setup, recipe) = self.registers.claim(session.number, &names, number as u8);
                    session.inputs.extend(recipe);
                    Answer::SetupInputs(setup)
                }
            }
            Request::Start => {
                // The answer must leave before the first data package.
                session.started = session.outputs.is_some() || !session.inputs.is_empty();
                Answer::Start(session.started)
            }
            Request::Pause => {
                session.started = false;
                Answer::Pause(true)
            }
            Request::Data(number, values) => {
                let recipe = usize::from(number).checked_sub(1).and_then(|k| session.inputs.get(k));
                if let Some(recipe) = recipe {
                    self.registers.write(recipe, recipe.decode(&values)?);
                    self.count.inputs += 1;
                }
                return Ok(true);
            }
            Request::Text(_) => return Ok(true),
        };
        session.answer(&answer);
        Ok(true)
    }

    /// Takes a client's wish for outputs, and says their types. Unknown names refuse it.
    fn outputs(&self, session: &mut Session, rate_hz: f64, names: Vec<String>) -> Setup {
        if length(&names) > MAX_NAMES {
            return Setup::default();
        }
        let series = self.config.series();
        let kinds: Vec<_> = names.iter().map(|name| known(series, name)).collect();
        let types = kinds
            .iter()
            .map(|kind| kind.map_or(NOT_FOUND, |kind| kind.name()).to_owned())
            .collect();
        let fields: Option<Vec<_>> = names
            .into_iter()
            .zip(kinds)
            .map(|(name, kind)| Some((name, kind?)))
            .collect();
        let fastest = series.rate_hz();
        // A rate that is no part of the robot's own one is rounded to one; above it the robot's own one is used.
        let every = (fastest / rate_hz.clamp(1.0, fastest)).round().max(1.0) as u64;
        session.outputs = fields
            .filter(|fields| !fields.is_empty())
            .map(|fields| Wanted { fields, every });
        let recipe = session.outputs.is_some().into();
        Setup { recipe, types }
    }

    fn send(&mut self) {
        let controls = &self.shared.controls;
        let outputs = Outputs {
            time_s: self.count.periods as f64 * self.clock.period().as_secs_f64(),
            arm: self.arm.state(),
            kinematics: &self.config.kinematics,
            robot_mode: controls.robot_mode.load(Ordering::Relaxed),
            safety_mode: controls.safety_mode.load(Ordering::Relaxed),
            runtime_state: controls.runtime_state.load(Ordering::Relaxed),
            registers: &self.registers,
        };
        for session in self.sessions.iter_mut().filter(|session| session.started) {
            let Some(wanted) = &session.outputs else { continue };
            if self.count.periods.is_multiple_of(wanted.every) {
                let mut values = Vec::new();
                for (name, kind) in &wanted.fields {
                    outputs.value(name, *kind).encode(&mut values);
                }
                session.answer(&Answer::Data(1, values));
                self.count.packages += 1;
            }
        }
    }
}

/// Bytes of a list of names on the wire.
fn length(names: &[String]) -> usize {
    names.iter().map(|name| name.len() + 1).sum::<usize>().saturating_sub(1)
}

fn text(message: &str) -> Answer {
    Answer::Text(TextMessage {
        message: message.to_owned(),
        source: "RTDE".to_owned(),
        level: TextLevel::Error,
    })
}
