//! Where the robot is and how long the client waits.

use std::net::{SocketAddr, ToSocketAddrs as _};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Machine, this_machine};

use super::ClientError;
use crate::{DASHBOARD_BELOW_RTDE, PRIMARY_BELOW_RTDE, RTDE_PORT};
use spherecal_budget::robot as budget;

/// Settings of a connection.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Address or host name of the robot.
    pub host: String,
    /// TCP port of RTDE. A real robot has 30004. The primary interface is three below it, the dashboard five.
    pub port: u16,
    /// How long to wait for the TCP connection.
    pub connect_timeout: Duration,
    /// How long to wait for an answer.
    pub response_timeout: Duration,
    /// How long to wait for a data package before the robot counts as silent.
    pub state_timeout: Duration,
}

impl ClientConfig {
    /// The defaults for a robot at `host`.
    pub fn new(host: impl Into<String>) -> Self {
        Self {
            machine: this_machine(),
            host: host.into(),
            port: RTDE_PORT,
            connect_timeout: budget::CONNECT,
            response_timeout: budget::UR_ANSWER,
            state_timeout: Duration::from_secs(1),
        }
    }

    /// The robot's addresses at this port.
    pub(super) fn addresses(&self, port: u16) -> Result<Vec<SocketAddr>, ClientError> {
        let unknown = |source| ClientError::Name {
            host: self.host.clone(),
            source,
        };
        let found: Vec<_> = (self.host.as_str(), port).to_socket_addrs().map_err(unknown)?.collect();
        if found.is_empty() {
            return Err(unknown(std::io::ErrorKind::NotFound.into()));
        }
        Ok(found)
    }

    pub(super) fn dashboard_port(&self) -> u16 {
        self.port.saturating_sub(DASHBOARD_BELOW_RTDE)
    }

    pub(super) fn primary_port(&self) -> u16 {
        self.port.saturating_sub(PRIMARY_BELOW_RTDE)
    }
}
