//! The ports of the robot side, and what people and programs say at those that are not RTDE's.

use std::io::ErrorKind;
use std::net::SocketAddr;
use std::sync::Arc;

use spherecal_budget::robot::{CLIENTS, SCRIPT_BYTES};
use spherecal_cyclic::{Listener, Machine, Stream, Wire};

use super::controls::{Controls, RobotConfig};
use super::{dashboard, robot_api};
use crate::wire::{Answer, ControllerVersion, FieldType, HttpRequest, Recipe};
use crate::{DASHBOARD_BELOW_RTDE, PRIMARY_BELOW_RTDE, robot_api_port};

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
    /// The dashboard, or the Robot API of a PolyScope X.
    people_at: Box<dyn Listener>,
    version: ControllerVersion,
    senders: Vec<Sender>,
    people: Vec<Wire>,
}

/// RTDE's port, and the others, below it but for the Robot API's. Port 0 takes any free group of such ports.
pub(super) fn open(config: &RobotConfig) -> std::io::Result<(Box<dyn Listener>, Ports)> {
    let (machine, at): (&dyn Machine, _) = (config.machine.as_ref(), config.address);
    let mut refused = ErrorKind::AddrNotAvailable.into();
    for _ in 0..TRIALS {
        let rtde = machine.listen(at)?;
        let port = rtde.address()?.port();
        let listen = |port: Option<u16>| {
            let port = port.filter(|port| *port > 0).ok_or(ErrorKind::AddrNotAvailable)?;
            machine.listen(SocketAddr::new(at.ip(), port))
        };
        let below = |by: u16| listen(port.checked_sub(by));
        let people = || {
            if config.version.is_polyscope_x() {
                listen(Some(robot_api_port(port)))
            } else {
                below(DASHBOARD_BELOW_RTDE)
            }
        };
        let [primary, secondary, realtime] = SCRIPTS_BELOW_RTDE;
        let others = || Ok([below(primary)?, below(secondary)?, below(realtime)?]);
        match others().and_then(|scripts| Ok((scripts, people()?))) {
            Ok((scripts, people_at)) => {
                let ports = Ports {
                    scripts,
                    people_at,
                    version: config.version,
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
    /// Greets new clients, answers at the dashboard or the Robot API, and returns the scripts that came. `calibration` is what a
    /// client of the primary interface gets.
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
        while let Ok((stream, _)) = self.people_at.accept() {
            if self.people.len() < CLIENTS {
                let mut wire = Wire::new(stream);
                if !self.version.is_polyscope_x() {
                    wire.send(dashboard::GREETING);
                }
                self.people.push(wire);
            }
        }
        self.people.retain_mut(|wire| {
            let alive = wire.poll();
            if self.version.is_polyscope_x() {
                // One request on a connection.
                let request = HttpRequest::decode(&wire.received).transpose().filter(|_| !wire.ends());
                if let Some(request) = request {
                    wire.send(&robot_api::answer(request.as_ref(), self.version, controls, stopped_s).encode());
                    wire.finish();
                }
            } else {
                while let Some(line) = dashboard::line(&mut wire.received) {
                    let answer = dashboard::answer(&line, self.version, controls, stopped_s);
                    wire.send(format!("{answer}\n").as_bytes());
                }
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
