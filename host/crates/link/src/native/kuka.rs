//! An LBR iiwa or LBR Med behind KUKA's Fast Robot Interface.

use std::sync::Arc;
use std::time::{Duration, Instant};

use spherecal_cyclic::Machine;
use spherecal_fri::client::{
    Client, ClientConfig, ClientError, MeasuredSign, MonitoredState, TorqueLimits, measured_sign,
};
use spherecal_fri::wire::{SafetyState, SessionState};
use spherecal_shared::protocol::drive::{DriveHello, DriveStatus, TorqueSign};
use spherecal_shared::robot::{Arm, Dynamics as _, Robot, Tool};

use super::drive::{Course, Interface, InterfaceDrive, SESSION};
use super::{DriveEvent, JOINTS, PAUSE_TICKS, Undeclared};
use crate::LinkError;
use spherecal_budget::robot::{FIRST, START};

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
pub type KukaDrive = InterfaceDrive<Kuka, JOINTS>;

/// A KUKA arm behind its interface.
pub struct Kuka {
    machine: Arc<dyn Machine>,
    client: Client,
    state: MonitoredState,
    /// The start of the motion has read its first message.
    begun: bool,
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
        let multiplier = state.message.connection.receive_multiplier.unwrap_or(1);
        if multiplier > 1 {
            return Err(KukaError::Multiplier { multiplier });
        }
        let (state, torque_sign) = sign(&mut client, state, &arm)?;
        let period_us = state
            .message
            .connection
            .send_period_ms
            .unwrap_or(1)
            .max(1)
            .saturating_mul(1000);
        // No cabinet is on this computer: what sends from here is a simulation.
        let simulated = client.cabinet().is_some_and(|address| address.is_loopback());
        let hello = DriveHello {
            period_us,
            compensates_gravity: true,
            motor_kg_m2: options.undeclared.motor_kg_m2.clone(),
            latency_us: options.undeclared.latency_us,
            torque_sign,
            simulated,
            ..DriveHello::new(SESSION, robot.joints.iter().map(|joint| joint.limits))
        };
        let course = Course::new(period_us, PAUSE_TICKS, &config.machine);
        let robot = Kuka {
            machine: config.machine,
            client,
            state,
            begun: false,
        };
        Ok(Self::new(robot, hello, course))
    }
}

impl Kuka {
    /// Permits commanding, and mirrors until the application's motion runs.
    fn start(&mut self, course: &mut Course) -> Result<(), ClientError> {
        if self.status(course) != DriveStatus::Ready {
            return Ok(());
        }
        course.recorder.pause();
        if let Err(ClientError::NotReady(cause)) = self.client.enable() {
            course.refused(DriveEvent::KukaNotReady(cause));
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
                    course.refused(DriveEvent::KukaEnded(end));
                    return Ok(());
                }
                Err(error) => return Err(error),
            }
            if !told && elapsed() > Duration::from_secs(1) {
                told = true;
                course
                    .recorder
                    .event(DriveEvent::KukaWaits(self.state.message.connection.session));
            }
            if elapsed() > START {
                self.client.disable();
                course.refused(DriveEvent::KukaWaits(self.state.message.connection.session));
                return Ok(());
            }
        }
        self.begun = true;
        course.recorder.event(DriveEvent::Started);
        Ok(())
    }
}

impl Interface<JOINTS> for Kuka {
    type Error = ClientError;

    fn carry_out(&mut self, course: &mut Course, tau: Option<[f64; JOINTS]>) -> Result<(), ClientError> {
        let Some(tau) = tau else {
            if self.client.is_enabled() {
                self.client.disable();
                course.recorder.pause();
            }
            return Ok(());
        };
        if !self.client.is_enabled() {
            return self.start(course);
        }
        match self.client.command(&tau) {
            Ok(cycle) => course.recorder.answered(cycle.rate_limited, cycle.torque_limited),
            // The newest message was answered before the cabinet fell silent.
            Err(ClientError::NothingToAnswer) => {}
            Err(error) => return Err(error),
        }
        Ok(())
    }

    fn receive(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let received = if std::mem::take(&mut self.begun) {
            Ok(0)
        } else {
            self.client.receive(&mut self.state).map(|cycle| cycle.missed)
        };
        let active = self.client.is_answerable();
        match received {
            Ok(missed) => course.arrived(active, missed),
            Err(ClientError::Ended(end)) => {
                course.arrived(active, 0);
                course.recorder.record.stops += 1;
                course.refused(DriveEvent::KukaEnded(end));
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    fn measured(&self) -> [[f64; JOINTS]; 3] {
        [
            self.state.message.measured_position,
            self.state.dq,
            self.state.message.measured_torque,
        ]
    }

    fn status(&self, course: &Course) -> DriveStatus {
        if self.state.message.robot.safety != Some(SafetyState::NormalOperation) {
            return DriveStatus::EmergencyStop;
        }
        match self.state.message.connection.session {
            SessionState::Idle => DriveStatus::Disabled,
            // In MONITORING_WAIT too: the start waits until the connection is good.
            _ if self.client.is_enabled() || course.may_start() => DriveStatus::Ready,
            _ => DriveStatus::Disabled,
        }
    }

    fn silence(error: &mut ClientError) -> Option<&mut Duration> {
        match error {
            ClientError::Silent { after } => Some(after),
            _ => None,
        }
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
                if !matches!(
                    state.message.connection.session,
                    SessionState::Idle | SessionState::MonitoringWait
                ) {
                    return Ok(state);
                }
            }
            Err(ClientError::Silent { .. }) if since(begun) < FIRST => {}
            Err(ClientError::Silent { .. }) => return Err(ClientError::Silent { after: since(begun) }.into()),
            Err(error) => return Err(error.into()),
        }
        if heard && since(begun) > FIRST {
            return Err(KukaError::NotReady {
                session: state.message.connection.session,
                quality: state.message.connection.quality,
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
                for (sum, tau) in measured.iter_mut().zip(&state.message.measured_torque) {
                    *sum += tau / f64::from(SIGN_STATES);
                }
                count += 1;
            }
            Err(ClientError::Silent { .. }) if silent < SIGN_STATES => silent += 1,
            Err(error) => return Err(error.into()),
        }
    }
    let gravity: [f64; JOINTS] = arm
        .bodies(&arm.frames(&state.message.measured_position))
        .gravity()
        .into();
    match measured_sign(&measured, &gravity) {
        Some(MeasuredSign::Positive) => Ok((state, TorqueSign::OfActuator)),
        Some(MeasuredSign::Negative) => Ok((state, TorqueSign::OfLink)),
        None => Err(KukaError::Sign { measured, gravity }),
    }
}
