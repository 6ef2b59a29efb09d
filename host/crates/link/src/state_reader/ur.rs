//! Reads the joints of a robot of Universal Robots, and commands nothing.

use spherecal_ur::client as ur;
use spherecal_ur::wire::KinematicsInfo;

use super::{JointReading, SILENCE, StateReader};
use crate::LinkError;

/// Reads a CB3 or an e-Series robot by RTDE. There are no torque sensors in its joints: readings have no torques.
pub struct UrReader {
    observer: ur::ReadOnlyClient,
    config: ur::ClientConfig,
    first: Option<f64>,
}

impl UrReader {
    /// Connects to the robot at `host`.
    ///
    /// # Errors
    /// The robot cannot be reached, or lacks a field.
    pub fn connect(host: &str, port: u16) -> Result<Self, LinkError> {
        Self::with(ur::ClientConfig {
            port,
            state_timeout: SILENCE,
            ..ur::ClientConfig::new(host)
        })
    }

    /// As [`connect`](Self::connect), with these settings.
    ///
    /// # Errors
    /// Those of [`connect`](Self::connect).
    pub fn with(config: ur::ClientConfig) -> Result<Self, LinkError> {
        Ok(Self {
            observer: ur::ReadOnlyClient::connect(&config).map_err(LinkError::device)?,
            config,
            first: None,
        })
    }

    /// What the robot says of its own calibration.
    ///
    /// # Errors
    /// Its primary interface cannot be reached, or does not say it.
    pub fn kinematics(&self) -> Result<KinematicsInfo, LinkError> {
        ur::read_kinematics(&self.config).map_err(LinkError::device)
    }

    /// The version of the robot's software.
    pub fn version(&self) -> String {
        self.observer.version().to_string()
    }
}

impl StateReader for UrReader {
    fn joints(&self) -> usize {
        spherecal_ur::JOINTS
    }

    fn has_torques(&self) -> bool {
        false
    }

    fn read(&mut self, reading: &mut JointReading) -> Result<(), LinkError> {
        let state = self.observer.receive().map_err(LinkError::device)?;
        state
            .ready()
            .map_err(|unready| LinkError::device(ur::ClientError::from(unready)))?;
        let first = *self.first.get_or_insert(state.timestamp);
        reading.time_s = state.timestamp - first;
        reading.set(&state.actual_q, &[], &[]);
        reading.commanded = state
            .program()
            .map(|words| format!("a program runs on the robot (runtime_state is {words})"));
        Ok(())
    }
}
