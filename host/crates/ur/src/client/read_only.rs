//! The RTDE client that only reads.

use std::collections::VecDeque;

use super::rtde::Rtde;
use super::state::FIELDS;
use super::{ClientConfig, ClientError, RobotState};
use crate::wire::{Answer, ControllerVersion, PackageKind, Reader, Series, TextMessage};

/// A connection that only reads. After the negotiation it sends nothing, so a person can guide the arm.
pub struct ReadOnlyClient {
    rtde: Rtde,
    /// Number of the recipe on the wire.
    number: u8,
    /// States that have come and were not handed out.
    states: VecDeque<RobotState>,
    skipped: u64,
}

impl ReadOnlyClient {
    /// Connects to the robot and starts its stream: 500 Hz, or 125 Hz from a CB3.
    ///
    /// # Errors
    /// A [`ClientError`] if the robot cannot be reached, is silent, or lacks a field.
    pub fn connect(config: &ClientConfig) -> Result<Self, ClientError> {
        let mut rtde = Rtde::connect(config)?;
        let number = rtde.outputs(&FIELDS)?;
        rtde.start()?;
        Ok(Self {
            rtde,
            number,
            states: VecDeque::new(),
            skipped: 0,
        })
    }

    /// Waits for the robot's next state. None is left out while the caller is late by less than a second: a mean over a
    /// rest needs them all.
    ///
    /// # Errors
    /// [`ClientError::Silent`] or [`ClientError::Closed`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self) -> Result<RobotState, ClientError> {
        let after = self.rtde.config.state_timeout;
        let deadline = self.rtde.channel.now() + after;
        let most = self.series().rate_hz() as usize;
        // What has come already; a robot that sends without a pause must not keep the client here.
        for _ in 0..2 * most {
            let wait = self.states.is_empty().then_some(deadline);
            match self.rtde.next(wait)? {
                Some(Answer::Data(number, values)) if number == self.number => {
                    let mut bytes = Reader::new(&values, PackageKind::Data.name());
                    self.states.push_back(RobotState::read(&mut bytes)?);
                    bytes.end()?;
                    if self.states.len() > most {
                        self.states.pop_front();
                        self.skipped += 1;
                    }
                }
                // An answer that comes late, or data of another recipe.
                Some(_) => {}
                None => break,
            }
        }
        self.states.pop_front().ok_or(ClientError::Silent { after })
    }

    /// The version of the robot's software.
    pub fn version(&self) -> ControllerVersion {
        self.rtde.version
    }

    /// The robot's generation.
    pub fn series(&self) -> Series {
        self.rtde.series()
    }

    /// States that were not handed out because they were older than a second.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The oldest message for people that was not read yet.
    pub fn message(&mut self) -> Option<TextMessage> {
        self.rtde.messages.pop_front()
    }
}
