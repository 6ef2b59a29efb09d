//! How torques over the interfaces of Universal Robots begin: the connection, the program, and the delay of the wire.

use spherecal_shared::robot::{Inertia, Robot, Tool};
use spherecal_ur::client::{ClientConfig, ClientError, DashboardCommand, TorqueClient, TorqueState};
use spherecal_ur::wire::{Load, Order};

use super::Undeclared;

/// States of which the delay of the wire is the median.
const STATES: usize = 200;
/// States that a robot has to start the program, and to end one that still runs: 2 s.
const START_STATES: u32 = 1000;
/// Numbers whose times are kept. An acknowledgement that is older (128 ms) has no use.
const KEPT: usize = 64;

/// How the robot is reached, and which arm it is.
#[derive(Clone, Debug)]
pub struct UrOptions {
    /// The connection.
    pub config: ClientConfig,
    /// The nominal robot.
    pub robot: Robot,
    /// The calibration tool in the last frame of the robot's table.
    pub tool: Tool,
    /// The same load in the frame of the flange: the program tells the robot to carry it.
    pub load: Inertia,
    /// What the handshake adds to what the robot says. A latency that is longer than the measured one counts.
    pub undeclared: Undeclared,
}

impl UrOptions {
    /// Connects, and takes the registers. Nothing is started.
    pub(super) fn open(&self) -> Result<TorqueClient, ClientError> {
        let load = Load {
            mass_kg: self.load.mass_kg,
            com_m: self.load.com_m,
            inertia_kg_m2: self.load.inertia_kg_m2,
        };
        TorqueClient::connect(&self.config, load)
    }
}

/// Why a robot cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum UrError {
    /// The client failed.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// A program runs that is not ours.
    #[error("a program runs on the robot (runtime_state is {words}): stop it at the teach pendant")]
    Program {
        /// The robot's word for what it does.
        words: String,
    },
    /// The robot does not run our program.
    #[error(
        "the robot did not run the program that was sent to its primary interface ({said}): choose remote control at the \
         teach pendant (Settings, System, Remote Control; PolyScope X: in the safety overview, in automatic mode), and enable the \
         primary interface under Settings, Security, Services"
    )]
    NotStarted {
        /// What its dashboard or its Robot API says of remote control.
        said: String,
    },
    /// The robot's description is of no use here.
    #[error("the robot's description: {0}")]
    Robot(#[from] spherecal_shared::robot::RobotError),
}

/// When each number was sent, in the robot's time.
#[derive(Debug)]
pub(super) struct Sent {
    times: [f64; KEPT],
}

impl Default for Sent {
    fn default() -> Self {
        let times = [f64::NEG_INFINITY; KEPT];
        Self { times }
    }
}

impl Sent {
    /// The robot's state at `timestamp` (s) was answered with this number.
    pub(super) fn note(&mut self, number: i32, timestamp: f64) {
        self.times[number as usize % KEPT] = timestamp;
    }

    /// Time from the state that was answered with the acknowledged number to this state, s.
    fn age(&self, state: &TorqueState) -> f64 {
        state.robot.timestamp - self.times[state.acknowledged as usize % KEPT]
    }
}

/// Sends the program and waits until it acknowledges a number. Nothing moves. Whether it runs.
pub(super) fn start(client: &mut TorqueClient, state: &mut TorqueState, sent: &mut Sent) -> Result<bool, ClientError> {
    client.receive(state)?;
    let first = client.send(&Order::Listen)?;
    client.upload()?;
    for _ in 0..START_STATES {
        client.receive(state)?;
        if state.acknowledged.wrapping_sub(first) >= 0 && state.robot.program().is_some() {
            return Ok(true);
        }
        if state.robot.ready().is_err() {
            return Ok(false);
        }
        sent.note(client.send(&Order::Listen)?, state.robot.timestamp);
    }
    Ok(false)
}

/// Starts the program on a robot that is ready, and measures the delay of the wire: the median age of the acknowledged number,
/// in µs. Nothing moves.
pub(super) fn begin(client: &mut TorqueClient, state: &mut TorqueState, sent: &mut Sent) -> Result<u32, UrError> {
    client.receive(state)?;
    // The program of a session that has just died ends by itself.
    for _ in 0..START_STATES {
        if state.robot.program().is_none() {
            break;
        }
        client.receive(state)?;
    }
    if let Some(words) = state.robot.program() {
        return Err(UrError::Program { words });
    }
    state.robot.ready().map_err(ClientError::from)?;
    if !start(client, state, sent)? {
        state.robot.ready().map_err(ClientError::from)?;
        let asked = client.ask(&[DashboardCommand::IsInRemoteControl]);
        let said = asked.map_or_else(
            |_| "it does not say whether it is in remote control".to_owned(),
            |answer| format!("remote control: {answer}"),
        );
        return Err(UrError::NotStarted { said });
    }
    let mut ages = [0.0; STATES];
    // The first numbers were sent before the program ran.
    for k in 0..KEPT + STATES {
        sent.note(client.send(&Order::Listen)?, state.robot.timestamp);
        client.receive(state)?;
        ages[k % STATES] = sent.age(state);
    }
    ages.sort_unstable_by(f64::total_cmp);
    Ok((ages[STATES / 2] * 1e6).round() as u32)
}
