//! Reads states and moves nothing.

use super::link::ClientLink;
use super::{ClientConfig, ClientError, LinkStatistics};
use crate::wire::{ErrorSet, RobotMode, RobotState, Version};

/// A connection that only reads. It never sends a command and never asks for a motion, so a person can guide the arm.
pub struct ReadOnlyClient {
    link: ClientLink,
    mode: RobotMode,
    errors: ErrorSet,
}

/// What a received state says beside its numbers.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Reading {
    /// How many periods went by without a reading before this one.
    pub missed: u64,
    /// The robot's mode before, if it changed with this state.
    pub mode_before: Option<RobotMode>,
    /// Errors that were not active in the state before.
    pub new_errors: ErrorSet,
}

impl ReadOnlyClient {
    /// Connects to the robot.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot cannot be reached or speaks no permitted version.
    pub fn connect(config: &ClientConfig) -> Result<Self, ClientError> {
        let link = ClientLink::connect(config)?;
        Ok(Self {
            mode: link.newest.robot_mode,
            errors: link.newest.errors,
            link,
        })
    }

    /// The agreed version.
    pub fn version(&self) -> Version {
        self.link.version
    }

    /// What went over the wire so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.link.statistics
    }

    /// Waits for the robot's next state. Allocates nothing.
    ///
    /// # Errors
    /// [`ClientError::Silent`] or [`ClientError::Closed`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self, state: &mut RobotState) -> Result<Reading, ClientError> {
        let missed = self.link.receive()?;
        state.clone_from(&self.link.newest);
        let mode_before = (state.robot_mode != self.mode).then_some(self.mode);
        let mut new_errors = ErrorSet::NONE;
        for error in state.errors.iter().filter(|e| !self.errors.contains(*e)) {
            new_errors.insert(error);
        }
        self.mode = state.robot_mode;
        self.errors = state.errors;
        Ok(Reading {
            missed,
            mode_before,
            new_errors,
        })
    }

    /// The robot model in URDF; `None` before version 8, which has no such request.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot does not answer or refuses.
    pub fn robot_model(&mut self) -> Result<Option<String>, ClientError> {
        self.link.robot_model()
    }
}

impl Drop for ReadOnlyClient {
    fn drop(&mut self) {
        self.link.tcp.shut_down();
    }
}
