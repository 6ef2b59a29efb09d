//! The RTDE client that only reads.

use std::collections::VecDeque;
use std::time::Instant;

use super::channel::Channel;
use super::state::FIELDS;
use super::{ClientConfig, ClientError, RobotState};
use crate::wire::{
    Answer, ControllerVersion, FieldType, MAX_ANSWER, NOT_FOUND, PROTOCOL, Recipe, Request, Series, Setup, TextMessage,
    WireError, take_package,
};

/// Text messages that are kept for [`ReadOnlyClient::message`].
const MESSAGES: usize = 16;

/// A connection that only reads. After the negotiation it sends nothing, so a person can guide the arm.
pub struct ReadOnlyClient {
    config: ClientConfig,
    channel: Channel,
    version: ControllerVersion,
    recipe: Recipe,
    /// Number of the recipe on the wire.
    number: u8,
    messages: VecDeque<TextMessage>,
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
        let addresses = config.addresses(config.port)?;
        let mut client = Self {
            config: config.clone(),
            channel: Channel::connect(config, &addresses)?,
            version: ControllerVersion::default(),
            recipe: Recipe::default(),
            number: 0,
            messages: VecDeque::new(),
            states: VecDeque::new(),
            skipped: 0,
        };
        client.negotiate()?;
        Ok(client)
    }

    fn negotiate(&mut self) -> Result<(), ClientError> {
        let Answer::ProtocolVersion(true) = self.ask(&Request::ProtocolVersion(PROTOCOL), "protocol version")? else {
            return Err(ClientError::Protocol);
        };
        if let Answer::ControllerVersion(version) = self.ask(&Request::ControllerVersion, "controller version")? {
            self.version = version;
        }
        let request = Request::SetupOutputs {
            rate_hz: self.series().rate_hz(),
            names: FIELDS.iter().map(|(name, _)| (*name).to_owned()).collect(),
        };
        if let Answer::SetupOutputs(setup) = self.ask(&request, "setup outputs")? {
            self.take_setup(&setup)?;
        }
        match self.ask(&Request::Start, "start")? {
            Answer::Start(true) => Ok(()),
            _ => Err(ClientError::Refused { request: "start" }),
        }
    }

    /// Checks the robot's types against those that are read here.
    fn take_setup(&mut self, setup: &Setup) -> Result<(), ClientError> {
        if setup.types.len() != FIELDS.len() {
            return Err(ClientError::Refused {
                request: "setup outputs",
            });
        }
        for (found, (field, expected)) in setup.types.iter().zip(FIELDS) {
            if found == NOT_FOUND {
                let version = self.version;
                return Err(ClientError::Field { field, version });
            }
            if FieldType::from_name(found) != Ok(expected) {
                return Err(ClientError::Type {
                    field,
                    found: found.clone(),
                    expected: expected.name(),
                });
            }
        }
        self.recipe.fields = FIELDS.iter().map(|(name, kind)| ((*name).to_owned(), *kind)).collect();
        self.number = setup.recipe;
        Ok(())
    }

    /// Sends a request and waits for its answer.
    fn ask(&mut self, request: &Request, name: &'static str) -> Result<Answer, ClientError> {
        self.channel.send(&request.encode())?;
        let after = self.config.response_timeout;
        let deadline = self.channel.now() + after;
        while let Some(answer) = self.next(Some(deadline))? {
            if answer.kind().name() == name {
                return Ok(answer);
            }
        }
        Err(ClientError::NoAnswer {
            request: name,
            interface: "RTDE",
            after,
        })
    }

    /// The next package that is no text message; `None` at the deadline, or when nothing has come and there is none.
    fn next(&mut self, deadline: Option<Instant>) -> Result<Option<Answer>, ClientError> {
        loop {
            while let Some((kind, payload)) = take_package(&mut self.channel.received, MAX_ANSWER)? {
                match Answer::decode(kind, &payload)? {
                    Answer::Text(message) => {
                        if self.messages.len() == MESSAGES {
                            self.messages.pop_front();
                        }
                        self.messages.push_back(message);
                    }
                    answer => return Ok(Some(answer)),
                }
            }
            if !self.channel.receive(deadline)? {
                return Ok(None);
            }
        }
    }

    /// Waits for the robot's next state. None is left out while the caller is late by less than a second: a mean over a
    /// rest needs them all.
    ///
    /// # Errors
    /// [`ClientError::Silent`] or [`ClientError::Closed`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self) -> Result<RobotState, ClientError> {
        let after = self.config.state_timeout;
        let deadline = self.channel.now() + after;
        let most = self.series().rate_hz() as usize;
        // What has come already; a robot that sends without a pause must not keep the client here.
        for _ in 0..2 * most {
            let wait = self.states.is_empty().then_some(deadline);
            match self.next(wait)? {
                Some(Answer::Data(number, values)) if number == self.number => {
                    let state = RobotState::of(&self.recipe.decode(&values)?);
                    self.states
                        .push_back(state.ok_or(WireError::NotFinite { field: "data package" })?);
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
        self.version
    }

    /// The robot's generation.
    pub fn series(&self) -> Series {
        Series::of(self.version.major)
    }

    /// States that were not handed out because they were older than a second.
    pub fn skipped(&self) -> u64 {
        self.skipped
    }

    /// The oldest message for people that was not read yet.
    pub fn message(&mut self) -> Option<TextMessage> {
        self.messages.pop_front()
    }
}
