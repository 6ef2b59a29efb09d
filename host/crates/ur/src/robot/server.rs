//! The robot side on the network: its ports, its clock and its program, as a process of its own.

use std::collections::VecDeque;
use std::sync::Arc;
use std::sync::atomic::Ordering;
use std::time::{Duration, Instant};

use spherecal_cyclic::{Listener, PeriodClock, Process, Published, Side};

use super::controls::{ArmCommand, ArmHardware, Controls, RobotConfig, RobotStatistics, Step};
use super::outputs::{Outputs, known};
use super::ports::{Ports, Session, Wanted, open};
use super::programs::{Program, moving_order};
use super::registers::Registers;
use crate::JOINTS;
use crate::wire::{
    Answer, MAX_NAMES, MAX_REQUEST, NOT_FOUND, PROTOCOL, Recipe, Request, RobotMode, RuntimeState, SafetyMode, Setup,
    TextLevel, TextMessage, Value, WireError, program_name, take_package,
};
use spherecal_budget::robot::{CLIENTS, RECIPES};

/// Packages of inputs that a client may send before it sees that the program has ended: those of 16 ms.
const SEES_END: i32 = 8;

/// A running robot side. It ends when it is dropped.
pub type RobotSide = Side<Controls, RobotStatistics>;

/// Listens at all ports and starts the robot's clock.
///
/// # Errors
/// What the system says if an address cannot be used.
pub fn start_robot(config: RobotConfig, arm: Box<dyn ArmHardware>) -> std::io::Result<RobotSide> {
    let machine = Arc::clone(&config.machine);
    let (rtde, ports) = open(&config)?;
    let address = rtde.address()?;
    let period = Duration::from_secs_f64(1.0 / config.series().rate_hz());
    let clock = PeriodClock::start(period, machine.now());
    Side::start(machine.as_ref(), "ur-robot", address, |shared| RobotServer {
        calibration: config.kinematics.encode(),
        config,
        rtde,
        ports,
        arm,
        sessions: Vec::new(),
        registers: Registers::default(),
        written: VecDeque::new(),
        program: None,
        ended: 0,
        seen: 0,
        stopped_at: None,
        next: 0,
        count: RobotStatistics::default(),
        clock,
        shared,
    })
}

struct RobotServer {
    config: RobotConfig,
    rtde: Box<dyn Listener>,
    ports: Ports,
    arm: Box<dyn ArmHardware>,
    sessions: Vec<Session>,
    registers: Registers,
    /// Inputs that no program can read yet, with the period from which on one can.
    written: VecDeque<(u64, Arc<Recipe>, Vec<Value>)>,
    program: Option<Program>,
    /// The last number that the program read which ended, and the last one that came.
    ended: i32,
    seen: i32,
    /// The period in which a protective stop began.
    stopped_at: Option<u64>,
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
    /// A control period: what came, a step of the program, what is sent, and then the arm moves.
    fn period(&mut self) {
        self.count.periods += 1;
        self.accept();
        self.serve();
        while let Some((_, recipe, values)) = self.written.pop_front_if(|(due, ..)| *due <= self.count.periods) {
            self.registers.write(&recipe, &values);
        }
        let command = self.run();
        self.send();
        let arm = self.arm.step(command, self.clock.period().as_secs_f64());
        let limits = &self.config.limits;
        if self.program.is_some() && arm.qd.iter().zip(limits).any(|(speed, limit)| speed.abs() > limit.0) {
            self.protective_stop();
        }
        self.count.followed += u64::from(matches!(command, ArmCommand::Torque(_)));
        self.count.clients = self.sessions.len();
        self.count.slipped = self.clock.slipped();
        self.count.runs = self.program.is_some();
        self.shared.publish(self.count);
    }

    fn accept(&mut self) {
        while let Ok((stream, _)) = self.rtde.accept() {
            if self.sessions.len() < CLIENTS {
                self.next += 1;
                self.sessions.push(Session::new(self.next, stream));
            }
        }
        let stopped_s = self.stopped_at.map_or(0.0, |since| {
            (self.count.periods - since) as f64 * self.clock.period().as_secs_f64()
        });
        for script in self.ports.serve(&self.calibration, &self.shared.controls, stopped_s) {
            self.start(&script);
        }
    }

    /// Whether the robot lets a program run.
    fn permits(&self) -> bool {
        let controls = &self.shared.controls;
        let safety = SafetyMode::from_number(controls.safety_mode.load(Ordering::Relaxed));
        matches!(safety, Ok(SafetyMode::Normal | SafetyMode::Reduced))
            && controls.robot_mode.load(Ordering::Relaxed) == RobotMode::Running.number()
    }

    /// A script came. It takes the place of the one that runs, if this side knows it.
    fn start(&mut self, script: &str) {
        if !self.shared.controls.remote.load(Ordering::Relaxed) || !self.permits() {
            return;
        }
        let Some((program, load)) = Program::recognise(script, &self.registers) else {
            self.count.refused += 1;
            let name = program_name(script).unwrap_or("without a name");
            let words = format!("the program {name} is none of those that this simulated robot runs");
            self.sessions
                .iter_mut()
                .for_each(|session| session.answer(&text(&words)));
            return;
        };
        if let Some(load) = load {
            self.arm.set_load(&load);
        }
        self.count.programs += 1;
        self.program = Some(program);
        self.shared.controls.stop_program.store(false, Ordering::Relaxed);
        self.tell(RuntimeState::Playing);
    }

    fn tell(&self, state: RuntimeState) {
        self.shared
            .controls
            .runtime_state
            .store(state.number(), Ordering::Relaxed);
    }

    fn end(&mut self) {
        if let Some(program) = self.program.take() {
            self.ended = program.number();
            self.tell(RuntimeState::Stopped);
        }
    }

    fn protective_stop(&mut self) {
        self.count.limits += 1;
        let safety = &self.shared.controls.safety_mode;
        safety.store(SafetyMode::ProtectiveStop.number(), Ordering::Relaxed);
        self.end();
    }

    /// A step of the program: what the arm does until the next one.
    fn run(&mut self) -> ArmCommand {
        let controls = &self.shared.controls;
        let stopped = controls.safety_mode.load(Ordering::Relaxed) == SafetyMode::ProtectiveStop.number();
        self.stopped_at = self.stopped_at.or(Some(self.count.periods)).filter(|_| stopped);
        if controls.stop_program.swap(false, Ordering::Relaxed) || !self.permits() {
            self.end();
        }
        let order = moving_order(&self.registers).filter(|number| *number != self.seen);
        self.seen = order.unwrap_or(self.seen);
        let Some(program) = &mut self.program else {
            let after = order.is_some_and(|number| number.wrapping_sub(self.ended) > SEES_END);
            self.count.after_stop += u64::from(after);
            return ArmCommand::Hold;
        };
        let (arm, step_s) = (self.arm.state(), self.clock.period().as_secs_f64());
        match program.step(&mut self.registers, &arm, step_s) {
            Step::Runs(command) if beyond(&command, &self.config.limits) => {
                self.protective_stop();
                ArmCommand::Hold
            }
            Step::Runs(command) => command,
            Step::Ends(words) => {
                self.count.silent += 1;
                if let Some(words) = words {
                    self.sessions
                        .iter_mut()
                        .for_each(|session| session.answer(&text(&words)));
                }
                self.end();
                ArmCommand::Hold
            }
        }
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
                if length(&names) > MAX_NAMES || number > RECIPES {
                    Answer::SetupInputs(Setup::default())
                } else {
                    let (setup, recipe) = self.registers.claim(session.number, &names, number as u8);
                    session.inputs.extend(recipe.map(Arc::new));
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
                    let due = self.count.periods + u64::from(self.config.input_delay);
                    self.written
                        .push_back((due, Arc::clone(recipe), recipe.decode(&values)?));
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

/// Whether a program asks for more speed or torque than these limits, or for what is no number.
fn beyond(command: &ArmCommand, limits: &[(f64, f64); JOINTS]) -> bool {
    let over = |value: f64, limit: f64| value.is_nan() || value.abs() > limit;
    match command {
        ArmCommand::Hold => false,
        ArmCommand::Torque(torque) => (0..JOINTS).any(|j| over(torque[j], limits[j].1)),
        ArmCommand::Follow(q, qd) => (0..JOINTS).any(|j| q[j].is_nan() || over(qd[j], limits[j].0)),
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
