//! Single requests: to the dashboard server (lines of text, which software 3 and 5 have and PolyScope X has not), and for the
//! robot's own calibration.

use std::time::Duration;

use spherecal_budget::robot::{LINE, LINE_BYTES};
use spherecal_cyclic::named_enum;

use super::channel::Channel;
use super::{ClientConfig, ClientError};
use crate::wire::KinematicsInfo;
use crate::wire::primary::take_primary;

named_enum! {
    /// What this client asks for, in the words of the dashboard.
    DashboardCommand {
        /// Closes the message of a safety stop.
        CloseSafetyPopup, "close safety popup";
        /// Ends a protective stop. The robot refuses it for the first 5 s of the stop.
        UnlockProtectiveStop, "unlock protective stop";
        /// Whether programs from outside are accepted.
        IsInRemoteControl, "is in remote control";
    }
}

impl DashboardCommand {}

/// Asks for these things, one after the other, and returns the last answer.
///
/// # Errors
/// A [`ClientError`] if the dashboard cannot be reached or does not answer in time.
pub fn ask_dashboard(config: &ClientConfig, commands: &[DashboardCommand]) -> Result<String, ClientError> {
    let after = config.response_timeout.min(LINE);
    let mut channel = Channel::connect(config, &config.addresses(config.dashboard_port())?)?;
    let mut answer = line(&mut channel, "greeting", after)?;
    for command in commands {
        channel.send(format!("{}\n", command.name()).as_bytes())?;
        answer = line(&mut channel, command.name(), after)?;
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

/// The Denavit-Hartenberg parameters that the robot computes with, its factory calibration included, from its primary
/// interface. Nothing is sent.
///
/// # Errors
/// A [`ClientError`] if the robot cannot be reached or does not say them in time.
pub fn read_kinematics(config: &ClientConfig) -> Result<KinematicsInfo, ClientError> {
    let addresses = config.addresses(config.primary_port())?;
    let mut channel = Channel::connect(config, &addresses)?;
    let after = config.response_timeout;
    let deadline = channel.now() + after;
    loop {
        while let Some((kind, payload)) = take_primary(&mut channel.received)? {
            if let Some(info) = KinematicsInfo::find(kind, &payload)? {
                return Ok(info);
            }
        }
        if !channel.receive(Some(deadline))? {
            return Err(ClientError::NoAnswer {
                request: "kinematics info",
                interface: "primary interface",
                after,
            });
        }
    }
}
