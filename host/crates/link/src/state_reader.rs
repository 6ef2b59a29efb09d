//! Reads the joints of an arm that somebody else moves, and commands no torque.
//!
//! | link | what is sent |
//! |---|---|
//! | `franka:` | the version when it connects; then nothing |
//! | `fri:` | in the monitoring states, the measured positions; in a commanding state, nothing |
//! | `ur:` | RTDE's negotiation when it connects; then nothing |
//! | `tcp:` | to each state, a command with `enable` 0 and zero torques |

mod ur;

use spherecal_fci::client as fci;
use spherecal_fci::wire::{RobotMode, RobotState};
use spherecal_fri::client as fri;
use spherecal_shared::Joints;
use spherecal_shared::protocol::PROTOCOL_VERSION;
use spherecal_shared::protocol::drive::{DriveCommand, DriveState, TorqueSign};

use crate::tcp::RemoteDrive;
use crate::{Drive, LinkError};
use spherecal_budget::robot::SILENCE;

pub use ur::UrReader;

/// Joints of the arms behind a robot's own interface.
const NATIVE_JOINTS: usize = crate::native::JOINTS;

/// The joints at one instant.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct JointReading {
    /// Time of the robot since the first reading, in s.
    pub time_s: f64,
    /// Joint angles, base to flange, in rad.
    pub q: Vec<f64>,
    /// Torques of the actuators on the joints, in N m; empty where their sign is not known.
    pub tau: Vec<f64>,
    /// Torques whose sign the interface does not tell, in N m; empty where `tau` has them.
    pub unsigned_tau: Vec<f64>,
    /// What commands torques or positions, if anything does: the arm is not guided then.
    pub commanded: Option<String>,
}

impl JointReading {
    /// Takes over angles (rad) and torques (N m), in the memory that it has.
    fn set(&mut self, q: &[f64], tau: &[f64], unsigned_tau: &[f64]) {
        for (own, values) in [
            (&mut self.q, q),
            (&mut self.tau, tau),
            (&mut self.unsigned_tau, unsigned_tau),
        ] {
            own.clear();
            own.extend_from_slice(values);
        }
    }
}

/// Reads joints and never moves them.
pub trait StateReader: Send {
    /// Joints of the arm.
    fn joints(&self) -> usize;

    /// Whether readings contain torques.
    fn has_torques(&self) -> bool;

    /// Waits for the next state and writes it to `reading`.
    ///
    /// # Errors
    /// The connection is lost, or no state came for 3 s.
    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError>;
}

/// Reads a Panda or an FR3.
pub struct FrankaReader {
    observer: fci::ReadOnlyClient,
    state: RobotState,
    first: Option<u64>,
}

impl FrankaReader {
    /// Connects to the robot at `host`.
    ///
    /// # Errors
    /// The robot cannot be reached or speaks no known version.
    pub fn connect(host: &str, port: u16) -> Result<Self, LinkError> {
        let config = fci::ClientConfig {
            port,
            state_timeout: SILENCE,
            ..fci::ClientConfig::new(host)
        };
        Ok(Self {
            observer: fci::ReadOnlyClient::connect(&config).map_err(LinkError::device)?,
            state: RobotState::default(),
            first: None,
        })
    }

    /// The robot, by the name of its built-in file.
    pub fn robot(&self) -> &'static str {
        self.observer.version().robot()
    }
}

impl StateReader for FrankaReader {
    fn joints(&self) -> usize {
        NATIVE_JOINTS
    }

    fn has_torques(&self) -> bool {
        true
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        self.observer.receive(&mut self.state).map_err(LinkError::device)?;
        let id = self.state.message_id;
        let first = *self.first.get_or_insert(id);
        reading.time_s = id.saturating_sub(first) as f64 * spherecal_fci::PERIOD_S;
        reading.set(&self.state.q, &self.state.tau_J, &[]);
        reading.commanded =
            (self.state.robot_mode == RobotMode::Move).then(|| format!("the robot's mode is \"{}\"", RobotMode::Move));
        Ok(())
    }
}

/// Reads an LBR behind a KUKA cabinet. The sign of its torques depends on the software: a reading has them without it.
pub struct KukaReader {
    observer: fri::ReadOnlyClient,
    state: fri::MonitoredState,
    first: Option<u32>,
}

impl KukaReader {
    /// Listens for the cabinet at `address`.
    ///
    /// # Errors
    /// The port cannot be opened.
    pub fn listen(address: std::net::SocketAddr) -> Result<Self, LinkError> {
        let config = fri::ClientConfig {
            address,
            timeout: SILENCE,
            ..fri::ClientConfig::new(fri::TorqueLimits::IIWA_7)
        };
        Ok(Self {
            observer: fri::ReadOnlyClient::listen(&config).map_err(LinkError::device)?,
            state: fri::MonitoredState::default(),
            first: None,
        })
    }
}

impl StateReader for KukaReader {
    fn joints(&self) -> usize {
        NATIVE_JOINTS
    }

    fn has_torques(&self) -> bool {
        false
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        self.observer.receive(&mut self.state).map_err(LinkError::device)?;
        let first = *self.first.get_or_insert(self.state.message.sequence);
        let messages = self.state.message.sequence.wrapping_sub(first);
        reading.time_s = f64::from(messages) * self.state.period_s();
        let message = &self.state.message;
        reading.set(&message.measured_position, &[], &message.measured_torque);
        reading.commanded = self
            .state
            .is_commanding()
            .then(|| format!("the cabinet's session is in {}", self.state.message.connection.session));
        Ok(())
    }
}

/// Reads the drive at the other end of a drive link. The drive never gets an enabled command.
pub struct DriveReader {
    drive: Box<dyn Drive>,
    state: DriveState,
    first: Option<u64>,
}

impl DriveReader {
    /// Connects to the drive at `HOST:PORT`.
    ///
    /// # Errors
    /// No drive answers there, or it speaks another protocol.
    pub fn connect(address: &str) -> Result<Self, LinkError> {
        Self::new(Box::new(RemoteDrive::connect(address)?))
    }

    /// Reads a drive that is already there.
    ///
    /// # Errors
    /// It speaks another protocol.
    pub fn new(drive: Box<dyn Drive>) -> Result<Self, LinkError> {
        let found = drive.hello().protocol;
        if found != PROTOCOL_VERSION {
            return Err(LinkError::Protocol {
                found,
                expected: PROTOCOL_VERSION,
            });
        }
        Ok(Self {
            drive,
            state: DriveState::default(),
            first: None,
        })
    }
}

impl StateReader for DriveReader {
    fn joints(&self) -> usize {
        self.drive.hello().limits.len()
    }

    fn has_torques(&self) -> bool {
        true
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        let joints = self.joints();
        let mut tau = Joints::new();
        // As many values as the hello has limits, so they fit.
        let _ = tau.resize(joints, 0.0);
        let command = DriveCommand {
            session: self.drive.hello().session,
            tick: self.state.tick,
            tau,
            enable: false,
            ..DriveCommand::default()
        };
        let command = self.first.is_some().then_some(&command);
        self.drive.exchange(command, &mut self.state)?;
        let first = *self.first.get_or_insert(self.state.tick);
        let periods = self.state.tick.saturating_sub(first) as f64;
        reading.time_s = periods * f64::from(self.drive.hello().period_us) * 1e-6;
        reading.set(&self.state.q, &self.state.tau, &[]);
        let sign = match self.drive.hello().torque_sign {
            TorqueSign::OfActuator => 1.0,
            TorqueSign::OfLink => -1.0,
        };
        reading.tau.iter_mut().for_each(|tau| *tau *= sign);
        reading.commanded = None;
        Ok(())
    }
}
