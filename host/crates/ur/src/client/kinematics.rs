//! Reads the robot's own calibration.

use super::channel::Channel;
use super::{ClientConfig, ClientError};
use crate::wire::KinematicsInfo;
use crate::wire::primary::take_primary;

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
