//! The negotiation of RTDE, and the packages that come afterwards.

use std::collections::VecDeque;
use std::time::Instant;

use super::channel::Channel;
use super::{ClientConfig, ClientError};
use crate::wire::{
    Answer, ControllerVersion, FieldType, IN_USE, MAX_ANSWER, NOT_FOUND, PROTOCOL, Request, Series, Setup, TextMessage,
    take_package,
};

/// Text messages that are kept for the caller.
const MESSAGES: usize = 16;

/// Names and types of fields, in the order of a recipe.
pub(super) type Fields = [(&'static str, FieldType)];

/// A connection that has agreed on the protocol.
pub(super) struct Rtde {
    pub(super) config: ClientConfig,
    pub(super) channel: Channel,
    pub(super) version: ControllerVersion,
    pub(super) messages: VecDeque<TextMessage>,
}

impl Rtde {
    /// Connects, and agrees on protocol 2.
    pub(super) fn connect(config: &ClientConfig) -> Result<Self, ClientError> {
        let addresses = config.addresses(config.port)?;
        let mut this = Self {
            config: config.clone(),
            channel: Channel::connect(config, &addresses)?,
            version: ControllerVersion::default(),
            messages: VecDeque::with_capacity(MESSAGES),
        };
        let Answer::ProtocolVersion(true) = this.ask(&Request::ProtocolVersion(PROTOCOL), "protocol version")? else {
            return Err(ClientError::Protocol);
        };
        if let Answer::ControllerVersion(version) = this.ask(&Request::ControllerVersion, "controller version")? {
            this.version = version;
        }
        Ok(this)
    }

    /// The robot's generation.
    pub(super) fn series(&self) -> Series {
        Series::of(self.version.major)
    }

    /// Asks for these outputs at the robot's rate. Returns the number of the recipe.
    pub(super) fn outputs(&mut self, fields: &Fields) -> Result<u8, ClientError> {
        let rate_hz = self.series().rate_hz();
        let request = "setup outputs";
        match self.ask(
            &Request::SetupOutputs {
                rate_hz,
                names: names(fields),
            },
            request,
        )? {
            Answer::SetupOutputs(setup) => self.checked(&setup, fields, request),
            _ => Err(ClientError::Refused { request }),
        }
    }

    /// Takes these inputs: no other client may write them. Returns the number of the recipe.
    pub(super) fn inputs(&mut self, fields: &Fields) -> Result<u8, ClientError> {
        let request = "setup inputs";
        match self.ask(&Request::SetupInputs { names: names(fields) }, request)? {
            Answer::SetupInputs(setup) => self.checked(&setup, fields, request),
            _ => Err(ClientError::Refused { request }),
        }
    }

    pub(super) fn start(&mut self) -> Result<(), ClientError> {
        match self.ask(&Request::Start, "start")? {
            Answer::Start(true) => Ok(()),
            _ => Err(ClientError::Refused { request: "start" }),
        }
    }

    /// Compares the robot's types with those that are used here.
    fn checked(&self, setup: &Setup, fields: &Fields, request: &'static str) -> Result<u8, ClientError> {
        if setup.types.len() != fields.len() {
            return Err(ClientError::Refused { request });
        }
        for (found, &(field, expected)) in setup.types.iter().zip(fields) {
            if found == NOT_FOUND {
                let version = self.version;
                return Err(ClientError::Field { field, version });
            }
            if found == IN_USE {
                return Err(ClientError::InUse { field });
            }
            if FieldType::from_name(found) != Ok(expected) {
                return Err(ClientError::Type {
                    field,
                    found: found.clone(),
                    expected: expected.name(),
                });
            }
        }
        Ok(setup.recipe)
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
    pub(super) fn next(&mut self, deadline: Option<Instant>) -> Result<Option<Answer>, ClientError> {
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
}

fn names(fields: &Fields) -> Vec<String> {
    fields.iter().map(|(name, _)| (*name).to_owned()).collect()
}
