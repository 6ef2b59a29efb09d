//! What the client knows of the robot after a message.

use crate::JOINTS;
use crate::wire::{IpoData, MonitoringMessage, SessionState};

/// The robot after one monitoring message.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MonitoredState {
    /// The message. What the cabinet did not send is `None`: unknown.
    pub message: MonitoringMessage,
    /// Joint velocities, differentiated and filtered by the client (see [`VelocityFilter`](super::VelocityFilter)),
    /// rad/s.
    pub dq: [f64; JOINTS],
}

impl MonitoredState {
    /// The cabinet's interpolator; it sends one while commanding.
    pub fn ipo(&self) -> IpoData {
        self.message.ipo.unwrap_or_default()
    }

    /// Whether the robot follows commands, or is about to.
    pub fn is_commanding(&self) -> bool {
        matches!(
            self.message.connection.session,
            SessionState::CommandingWait | SessionState::CommandingActive
        )
    }

    /// The time between two messages, s. The cabinet sends it; 1 ms where it does not.
    pub fn period_s(&self) -> f64 {
        f64::from(self.message.connection.send_period_ms.unwrap_or(1).max(1)) * 1e-3
    }
}
