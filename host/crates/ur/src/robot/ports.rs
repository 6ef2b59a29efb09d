//! The ports of the robot side, and what people and programs say at those that are not RTDE's.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;
use std::sync::atomic::Ordering;

use spherecal_budget::robot::{CLIENTS, SCRIPT_BYTES};
use spherecal_cyclic::{Listener, Machine, Stream, Wire};

use super::controls::Controls;
use crate::wire::{Answer, FieldType, Recipe, RobotMode, RuntimeState, SafetyMode, words};
use crate::{DASHBOARD_BELOW_RTDE, PRIMARY_BELOW_RTDE};

/// Groups of free ports that are tried.
const TRIALS: usize = 64;
/// How far the ports that take scripts are below RTDE's: primary, secondary and realtime interface.
const SCRIPTS_BELOW_RTDE: [u16; 3] = [PRIMARY_BELOW_RTDE, 2, 1];

/// A client that may send a script.
struct Sender {
    wire: Wire,
    script: Vec<u8>,
}

/// All ports but RTDE's.
pub(super) struct Ports {
    scripts: [Box<dyn Listener>; 3],
    dashboard: Box<dyn Listener>,
    senders: Vec<Sender>,
    people: Vec<Wire>,
}

/// RTDE's port, and the others below it. Port 0 takes any free group of such ports.
pub(super) fn open(machine: &dyn Machine, at: SocketAddr) -> std::io::Result<(Box<dyn Listener>, Ports)> {
    let mut refused = ErrorKind::AddrNotAvailable.into();
    for _ in 0..TRIALS {
        let rtde = machine.listen(at)?;
        let port = rtde.address()?.port();
        let below = |by: u16| {
            let port = port.checked_sub(by).filter(|port| *port > 0);
            machine.listen(SocketAddr::new(at.ip(), port.ok_or(ErrorKind::AddrNotAvailable)?))
        };
        let [primary, secondary, realtime] = SCRIPTS_BELOW_RTDE;
        let others = || Ok([below(primary)?, below(secondary)?, below(realtime)?]);
        match others().and_then(|scripts| Ok((scripts, below(DASHBOARD_BELOW_RTDE)?))) {
            Ok((scripts, dashboard)) => {
                let ports = Ports {
                    scripts,
                    dashboard,
                    senders: Vec::new(),
                    people: Vec::new(),
                };
                return Ok((rtde, ports));
            }
            Err(error) if at.port() != 0 => return Err(error),
            Err(error) => refused = error,
        }
    }
    Err(refused)
}

impl Ports {
    /// Greets new clients, answers at the dashboard, and returns the scripts that came. `calibration` is what a client of the
    /// primary interface gets.
    pub(super) fn serve(&mut self, calibration: &[u8], controls: &Controls, stopped_s: f64) -> Vec<String> {
        for (k, listener) in self.scripts.iter().enumerate() {
            while let Ok((stream, _)) = listener.accept() {
                if self.senders.len() < 3 * CLIENTS {
                    let mut wire = Wire::new(stream);
                    if k == 0 {
                        wire.send(calibration);
                    }
                    let script = Vec::new();
                    self.senders.push(Sender { wire, script });
                }
            }
        }
        while let Ok((stream, _)) = self.dashboard.accept() {
            if self.people.len() < CLIENTS {
                let mut wire = Wire::new(stream);
                wire.send(b"Connected: Universal Robots Dashboard Server\n");
                self.people.push(wire);
            }
        }
        self.people.retain_mut(|wire| {
            let alive = wire.poll();
            while let Some(line) = line(&mut wire.received) {
                let answer = answer(&line, controls, stopped_s);
                wire.send(format!("{answer}\n").as_bytes());
            }
            alive
        });
        let mut scripts = Vec::new();
        self.senders.retain_mut(|sender| {
            let mut alive = sender.wire.poll();
            sender.script.append(&mut sender.wire.received);
            // A robot runs a program when its last line has come, or the connection ends.
            let whole = sender.script.ends_with(b"\nend\n");
            if whole || (!alive && !sender.script.is_empty()) {
                scripts.push(String::from_utf8_lossy(&std::mem::take(&mut sender.script)).into_owned());
            }
            if sender.script.len() > SCRIPT_BYTES {
                sender.wire.close();
                alive = false;
            }
            alive
        });
        scripts
    }
}

/// The first line that has come, without its end.
fn line(received: &mut Vec<u8>) -> Option<String> {
    let end = received.iter().position(|byte| *byte == b'\n')?;
    let line: Vec<u8> = received.drain(..=end).collect();
    Some(String::from_utf8_lossy(&line).trim().to_owned())
}

/// For how long a robot refuses to end a protective stop, s.
const LOCKED_S: f64 = 5.0;

/// What the dashboard says, and does. `stopped_s`: how long the robot has been stopped.
fn answer(line: &str, controls: &Controls, stopped_s: f64) -> String {
    let mode = controls.robot_mode.load(Ordering::Relaxed);
    let safety = controls.safety_mode.load(Ordering::Relaxed);
    let state = controls.runtime_state.load(Ordering::Relaxed);
    let runs = state == RuntimeState::Playing.number();
    match line.to_ascii_lowercase().as_str() {
        "robotmode" => format!(
            "Robotmode: {}",
            words(RobotMode::from_number(mode).map(RobotMode::name), mode)
        ),
        "safetystatus" | "safetymode" => {
            format!(
                "Safetystatus: {}",
                words(SafetyMode::from_number(safety).map(SafetyMode::name), safety)
            )
        }
        "running" => format!("Program running: {runs}"),
        "programstate" => format!("{} spherecal", if runs { "PLAYING" } else { "STOPPED" }),
        "is in remote control" => controls.remote.load(Ordering::Relaxed).to_string(),
        "close safety popup" => "closing safety popup".to_owned(),
        "stop" => {
            controls.stop_program.store(true, Ordering::Relaxed);
            "Stopped".to_owned()
        }
        "unlock protective stop" => {
            if safety != SafetyMode::ProtectiveStop.number() {
                return "Protective stop releasing".to_owned();
            }
            if stopped_s < LOCKED_S {
                return "Cannot unlock protective stop until 5s after occurrence. Always inspect cause of protective stop \
                        before unlocking"
                    .to_owned();
            }
            controls
                .safety_mode
                .store(SafetyMode::Normal.number(), Ordering::Relaxed);
            "Protective stop releasing".to_owned()
        }
        "polyscopeversion" => "URSoftware 5.25.1.0 (simulated by spherecal)".to_owned(),
        "get robot model" => "UR5".to_owned(),
        "get serial number" => "00000000000".to_owned(),
        "quit" => "Disconnected".to_owned(),
        other => format!("could not understand: '{other}'"),
    }
}

pub(super) struct Wanted {
    pub(super) fields: Vec<(String, FieldType)>,
    /// Periods between two data packages.
    pub(super) every: u64,
}

/// A client of RTDE.
pub(super) struct Session {
    pub(super) number: u64,
    pub(super) wire: Wire,
    /// Protocol 2 is agreed.
    pub(super) agreed: bool,
    pub(super) outputs: Option<Wanted>,
    pub(super) inputs: Vec<Arc<Recipe>>,
    pub(super) started: bool,
}

impl Session {
    pub(super) fn new(number: u64, stream: Box<dyn Stream>) -> Self {
        Self {
            number,
            wire: Wire::new(stream),
            agreed: false,
            outputs: None,
            inputs: Vec::new(),
            started: false,
        }
    }

    pub(super) fn answer(&mut self, answer: &Answer) {
        self.wire.send(&answer.encode());
    }
}
