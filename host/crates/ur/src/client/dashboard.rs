//! The dashboard server: lines of text, which software 3 and 5 have and PolyScope X has not.

use std::time::Duration;

use super::channel::Channel;
use super::{ClientConfig, ClientError};
use spherecal_budget::robot::{LINE, LINE_BYTES};

/// What this client asks for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum DashboardCommand {
    /// Closes the message of a safety stop.
    CloseSafetyPopup,
    /// Ends a protective stop. The robot refuses it for the first 5 s of the stop.
    UnlockProtectiveStop,
    /// Whether programs from outside are accepted.
    IsInRemoteControl,
}

impl DashboardCommand {
    /// The line on the wire.
    pub const fn line(self) -> &'static str {
        match self {
            Self::CloseSafetyPopup => "close safety popup",
            Self::UnlockProtectiveStop => "unlock protective stop",
            Self::IsInRemoteControl => "is in remote control",
        }
    }
}

/// Asks for these things, one after the other, and returns the last answer.
///
/// # Errors
/// A [`ClientError`] if the dashboard cannot be reached or does not answer in time.
pub fn ask_dashboard(config: &ClientConfig, commands: &[DashboardCommand]) -> Result<String, ClientError> {
    let after = config.response_timeout.min(LINE);
    let mut channel = Channel::connect(config, &config.addresses(config.dashboard_port())?)?;
    let mut answer = line(&mut channel, "greeting", after)?;
    for command in commands {
        channel.send(format!("{}\n", command.line()).as_bytes())?;
        answer = line(&mut channel, command.line(), after)?;
    }
    Ok(answer)
}

fn line(channel: &mut Channel, request: &'static str, after: Duration) -> Result<String, ClientError> {
    let deadline = channel.now() + after;
    loop {
        if let Some(end) = channel.received.iter().position(|byte| *byte == b'\n') {
            let line: Vec<u8> = channel.received.drain(..=end).collect();
            return Ok(String::from_utf8_lossy(&line).trim().to_owned());
        }
        if channel.received.len() > LINE_BYTES || !channel.receive(Some(deadline))? {
            return Err(ClientError::NoAnswer {
                request,
                interface: "dashboard",
                after,
            });
        }
    }
}
