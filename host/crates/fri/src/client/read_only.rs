//! Watches and commands nothing.

use std::net::SocketAddr;

use super::link::ClientLink;
use super::{ClientConfig, ClientError, LinkStatistics, MonitoredState};

/// A session that only watches. In the monitoring states it mirrors positions back, so that the cabinet rates the
/// connection. It answers no commanding state, so a motion that waits for the client cannot begin.
pub struct ReadOnlyClient {
    link: ClientLink,
}

impl ReadOnlyClient {
    /// Listens for the cabinet.
    ///
    /// # Errors
    /// [`ClientError::Listen`] if the port cannot be opened.
    pub fn listen(config: &ClientConfig) -> Result<Self, ClientError> {
        Ok(Self {
            link: ClientLink::open(config)?,
        })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> Result<SocketAddr, ClientError> {
        self.link.address()
    }

    /// What went over the wire so far.
    pub fn statistics(&self) -> LinkStatistics {
        self.link.statistics
    }

    /// Waits for the cabinet's next message and mirrors it where the session is monitoring. Returns how many periods
    /// went by without an answer before it. Allocates nothing.
    ///
    /// # Errors
    /// [`ClientError::Silent`] if none comes, [`ClientError::Wire`] if it is invalid.
    pub fn receive(&mut self, state: &mut MonitoredState) -> Result<u64, ClientError> {
        let received = self.link.receive()?;
        state.clone_from(&self.link.state);
        self.link.mirror_monitoring()?;
        Ok(received.missed)
    }
}
