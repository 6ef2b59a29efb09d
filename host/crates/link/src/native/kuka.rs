//! An LBR iiwa or LBR Med behind KUKA's Fast Robot Interface.

use std::sync::Arc;
use std::time::{Duration, Instant};

use spherecal_cyclic::Machine;
use spherecal_fri::client::{
    Client, ClientConfig, ClientError, MeasuredSign, MonitoredState, TorqueLimits, measured_sign,
};
use spherecal_fri::wire::{SafetyState, SessionState};
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus, TorqueSign};
use spherecal_shared::protocol::host::LoopTiming;
use spherecal_shared::robot::{Arm, Dynamics as _, Robot, Tool};

use super::monitor::{DriveRecorder, Monitor};
use super::{DriveEvent, JOINTS, PAUSE_TICKS, Undeclared, fill, periods, torques};
use crate::{Drive, LinkError};
use spherecal_budget::robot::{FIRST, GIVE_UP, START};

/// Session number of the drive: a lost connection ends the run, or goes on in the
/// same session.
const SESSION: u32 = 1;
/// States that are averaged for the sign of the torques.
const SIGN_STATES: u32 = 100;

/// How the cabinet is reached, and which arm it moves.
#[derive(Clone, Debug)]
pub struct KukaOptions {
    /// The connection. Its limits are replaced by the robot's torques and `torque_rate`.
    pub config: ClientConfig,
    /// Largest change of a torque, in N m/s.
    pub torque_rate: f64,
    /// The nominal robot.
    pub robot: Robot,
    /// The calibration tool, as declared in the load data of the application.
    pub tool: Tool,
    /// What the handshake adds to what the robot says.
    pub undeclared: Undeclared,
}

/// Why a cabinet cannot be used.
#[derive(Debug, thiserror::Error)]
pub enum KukaError {
    /// The client failed.
    #[error(transparent)]
    Client(#[from] ClientError),
    /// The connection did not become good enough for commands.
    #[error(
        "the cabinet's session stays in {session} (quality {quality}): check the network, and that this computer \
         answers within a period (`spherecal doctor --realtime`)"
    )]
    NotReady {
        /// Its session.
        session: SessionState,
        /// The connection's quality.
        quality: spherecal_fri::wire::Quality,
    },
    /// The sign of the measured torques cannot be told.
    #[error(
        "the sign of the measured torques cannot be told in this pose: measured {measured:.1?} N m, gravity by the \
         model {gravity:.1?} N m; move the arm so that it is stretched forwards, and check robot, tool and load data"
    )]
    Sign {
        /// Measured torques, in N m.
        measured: [f64; JOINTS],
        /// The model's gravity torques, in N m.
        gravity: [f64; JOINTS],
    },
    /// The cabinet expects fewer answers than messages.
    #[error("the application's receive multiplier is {multiplier}: set it to 1, and the send period to 1 ms")]
    Multiplier {
        /// As sent.
        multiplier: u32,
    },
    /// The robot's description is of no use here.
    #[error("the robot's description: {0}")]
    Robot(#[from] spherecal_shared::robot::RobotError),
}

/// A KUKA arm as a drive.
///
/// - A command with `enable` permits commanding. The drive then waits until the application on the cabinet has started
///   its motion; a person may have to confirm it there.
/// - A command without `enable`, or none, ends commanding: the drive does not answer any more, and the cabinet stops the
///   arm with its brakes.
/// - Velocities are differentiated and filtered by the client.
/// - The sign of the measured torques is found at the start, by the gravity of the arm at rest.
pub struct KukaDrive {
    machine: Arc<dyn Machine>,
    client: Client,
    hello: DriveHello,
    state: MonitoredState,
    tick: u64,
    missed: u32,
    /// The command for this period was carried out.
    answered: bool,
    /// The start of the motion has read its first message.
    begun: bool,
    /// Commanding is not permitted before this tick.
    resume_at: u64,
    silent: Duration,
    recorder: DriveRecorder,
}

impl KukaDrive {
    /// Listens for the cabinet, and waits until the connection is good. Nothing moves.
    ///
    /// # Errors
    /// The port is in use, no cabinet sends, or the sign of the torques cannot be told.
    pub fn listen(options: &KukaOptions) -> Result<Self, LinkError> {
        let KukaOptions { robot, tool, .. } = options;
        if robot.dof() != JOINTS {
            return Err(LinkError::OtherRobot {
                drive: JOINTS,
                robot: robot.dof(),
            });
        }
        Self::open(options, robot, tool).map_err(LinkError::device)
    }

    fn open(options: &KukaOptions, robot: &Robot, tool: &Tool) -> Result<Self, KukaError> {
        let arm = Arm::<f64, JOINTS>::new(robot, tool)?;
        let torque = std::array::from_fn(|j| robot.joints.get(j).map_or(0.0, |joint| joint.limits.torque_nm));
        let config = ClientConfig {
            limits: TorqueLimits {
                torque,
                torque_rate: options.torque_rate,
            },
            ..options.config.clone()
        };
        let mut client = Client::listen(&config)?;
        let state = first_state(&mut client, config.machine.as_ref())?;
        let multiplier = state.receive_multiplier.unwrap_or(1);
        if multiplier > 1 {
            return Err(KukaError::Multiplier { multiplier });
        }
        let (state, torque_sign) = sign(&mut client, state, &arm)?;
        let period_us = state.send_period_ms.unwrap_or(1).max(1).saturating_mul(1000);
        // No cabinet is on this computer: what sends from here is a simulation.
        let simulated = client.cabinet().is_some_and(|address| address.is_loopback());
        Ok(Self {
            client,
            hello: DriveHello {
                period_us,
                compensates_gravity: true,
                motor_kg_m2: options.undeclared.motor_kg_m2.clone(),
                latency_us: options.undeclared.latency_us,
                torque_sign,
                simulated,
                ..DriveHello::new(SESSION, robot.joints.iter().map(|joint| joint.limits))
            },
            state,
            tick: 0,
            missed: 0,
            answered: false,
            begun: false,
            resume_at: 0,
            silent: Duration::ZERO,
            recorder: DriveRecorder::new(period_us, Arc::clone(&config.machine)),
            machine: config.machine,
        })
    }

    /// Carries out the command that answers the last state.
    fn carry_out(&mut self, command: Option<&DriveCommand>) -> Result<(), LinkError> {
        let Some(tau) = command.filter(|c| c.enable).map(|c| &c.tau) else {
            if self.client.is_enabled() {
                self.client.disable();
                self.recorder.pause();
            }
            return Ok(());
        };
        let tau = torques(tau)?;
        if !self.client.is_enabled() {
            return self.start();
        }
        match self.client.command(&tau) {
            Ok(cycle) => self.recorder.answered(cycle.rate_limited, cycle.torque_limited),
            // The newest message was answered before the cabinet fell silent.
            Err(ClientError::NothingToAnswer) => {}
            Err(error) => return Err(LinkError::device(error)),
        }
        Ok(())
    }

    /// Permits commanding, and mirrors until the application's motion runs.
    fn start(&mut self) -> Result<(), LinkError> {
        if self.status() != DriveStatus::Ready {
            return Ok(());
        }
        self.recorder.pause();
        if let Err(ClientError::NotReady(cause)) = self.client.enable() {
            self.refused(DriveEvent::KukaNotReady(cause));
            return Ok(());
        }
        let machine = Arc::clone(&self.machine);
        let begun = machine.now();
        let elapsed = || machine.now().saturating_duration_since(begun);
        let mut told = false;
        while !self.client.is_answerable() {
            match self.client.receive(&mut self.state) {
                Ok(_) | Err(ClientError::Silent { .. }) => {}
                Err(ClientError::Ended(end)) => {
                    self.refused(DriveEvent::KukaEnded(end));
                    return Ok(());
                }
                Err(error) => return Err(LinkError::device(error)),
            }
            if !told && elapsed() > Duration::from_secs(1) {
                told = true;
                self.recorder.event(DriveEvent::KukaWaits(self.state.session));
            }
            if elapsed() > START {
                self.client.disable();
                self.refused(DriveEvent::KukaWaits(self.state.session));
                return Ok(());
            }
        }
        self.begun = true;
        self.recorder.event(DriveEvent::Started);
        Ok(())
    }

    fn refused(&mut self, event: DriveEvent) {
        self.resume_at = self.tick + PAUSE_TICKS;
        self.recorder.event(event);
    }

    fn arrived(&mut self, missed: u64) {
        let active = self.client.is_answerable();
        // With closed brakes a message that was not read is no missed period.
        self.missed = if active {
            u32::try_from(missed).unwrap_or(u32::MAX)
        } else {
            0
        };
        self.recorder.state(active, self.missed);
        self.tick += 1 + u64::from(self.missed);
        if !std::mem::take(&mut self.silent).is_zero() {
            self.recorder.event(DriveEvent::Back);
        }
    }

    fn status(&self) -> DriveStatus {
        if self.state.safety != Some(SafetyState::NormalOperation) {
            return DriveStatus::EmergencyStop;
        }
        let may_start = self.tick >= self.resume_at;
        match self.state.session {
            SessionState::Idle => DriveStatus::Disabled,
            // In MONITORING_WAIT too: the start waits until the connection is good.
            _ if self.client.is_enabled() || may_start => DriveStatus::Ready,
            _ => DriveStatus::Disabled,
        }
    }
}

impl Drive for KukaDrive {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.missed = 0;
        if !std::mem::take(&mut self.answered) {
            self.carry_out(command)?;
        }
        let received = if std::mem::take(&mut self.begun) {
            Ok(0)
        } else {
            self.client.receive(&mut self.state).map(|cycle| cycle.missed)
        };
        match received {
            Ok(missed) => self.arrived(missed),
            Err(ClientError::Ended(end)) => {
                self.arrived(0);
                self.recorder.record.stops += 1;
                self.refused(DriveEvent::KukaEnded(end));
            }
            Err(ClientError::Silent { after }) => {
                if self.silent.is_zero() {
                    self.recorder.event(DriveEvent::Silent(after));
                }
                self.recorder.pause();
                self.silent += after;
                let periods = periods(after, self.hello.period_us);
                self.missed = periods - 1;
                self.tick += u64::from(periods);
                if self.silent > GIVE_UP {
                    return Err(LinkError::device(ClientError::Silent { after: self.silent }));
                }
                return Ok(());
            }
            Err(error) => return Err(LinkError::device(error)),
        }
        state.session = self.hello.session;
        state.tick = self.tick;
        fill(&mut state.q, &self.state.q);
        fill(&mut state.dq, &self.state.dq);
        fill(&mut state.tau, &self.state.measured_torque);
        state.status = self.status();
        Ok(())
    }

    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        self.carry_out(Some(command))?;
        self.answered = true;
        Ok(())
    }

    fn missed(&self) -> u32 {
        self.missed
    }

    fn monitor(&self) -> Option<Monitor> {
        Some(self.recorder.monitor())
    }

    fn timing(&self) -> Option<LoopTiming> {
        Some(LoopTiming::from(&self.recorder.record))
    }
}

/// Mirrors until the connection is good enough for commands.
fn first_state(client: &mut Client, machine: &dyn Machine) -> Result<MonitoredState, KukaError> {
    let mut state = MonitoredState::default();
    let mut begun = machine.now();
    let since = |begun: Instant| machine.now().saturating_duration_since(begun);
    let mut heard = false;
    loop {
        match client.receive(&mut state) {
            Ok(_) => {
                if !std::mem::replace(&mut heard, true) {
                    begun = machine.now();
                }
                if !matches!(state.session, SessionState::Idle | SessionState::MonitoringWait) {
                    return Ok(state);
                }
            }
            Err(ClientError::Silent { .. }) if since(begun) < FIRST => {}
            Err(ClientError::Silent { .. }) => return Err(ClientError::Silent { after: since(begun) }.into()),
            Err(error) => return Err(error.into()),
        }
        if heard && since(begun) > FIRST {
            return Err(KukaError::NotReady {
                session: state.session,
                quality: state.quality,
            });
        }
    }
}

/// Finds the sign of the measured torques from the gravity of the arm at rest.
fn sign(
    client: &mut Client,
    mut state: MonitoredState,
    arm: &Arm<f64, JOINTS>,
) -> Result<(MonitoredState, TorqueSign), KukaError> {
    let mut measured = [0.0; JOINTS];
    let mut silent = 0;
    let mut count = 0;
    while count < SIGN_STATES {
        match client.receive(&mut state) {
            Ok(_) => {
                for (sum, tau) in measured.iter_mut().zip(&state.measured_torque) {
                    *sum += tau / f64::from(SIGN_STATES);
                }
                count += 1;
            }
            Err(ClientError::Silent { .. }) if silent < SIGN_STATES => silent += 1,
            Err(error) => return Err(error.into()),
        }
    }
    let gravity: [f64; JOINTS] = arm.bodies(&arm.frames(&state.q)).gravity().into();
    match measured_sign(&measured, &gravity) {
        Some(MeasuredSign::Positive) => Ok((state, TorqueSign::OfActuator)),
        Some(MeasuredSign::Negative) => Ok((state, TorqueSign::OfLink)),
        None => Err(KukaError::Sign { measured, gravity }),
    }
}
