//! Both channels of a connection: what [`Client`](super::Client) and [`ReadOnlyClient`](super::ReadOnlyClient) share.

use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr, ToSocketAddrs as _};
use std::sync::Arc;
use std::time::Duration;

use spherecal_cyclic::{Inbox, Machine, io_error as io};

use super::tcp::{CommandChannel, RawResponse};
use super::{ClientConfig, ClientError};
use crate::wire::{
    CommandKind, ConnectAnswer, MAX_COMMAND_SIZE, MAX_STATE_SIZE, Request, RobotCommand, RobotState, Status, Version,
};

/// What went over the wire since the connection was made.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LinkStatistics {
    /// States received in order.
    pub states: u64,
    /// States that never came, by the gaps of `message_id`.
    pub missed: u64,
    /// States that came, but only together with a newer one: they were not answered.
    pub superseded: u64,
    /// The longest gap: missed states in a row.
    pub longest_gap: u64,
    /// States skipped because a newer one had come: late, repeated or out of order.
    pub stale: u64,
    /// Datagrams from another host.
    pub foreign: u64,
    /// Commands sent.
    pub commands: u64,
    /// Commands of which a torque changed too fast and was clamped.
    pub rate_limited: u64,
    /// Commands of which a torque exceeded its limit and was clamped.
    pub torque_limited: u64,
    /// The lowest success rate that the robot reported during a motion, after its first 100 commands; 1 before.
    pub lowest_success_rate: f64,
}

pub(super) struct ClientLink {
    pub(super) machine: Arc<dyn Machine>,
    pub(super) tcp: CommandChannel,
    pub(super) version: Version,
    pub(super) statistics: LinkStatistics,
    pub(super) newest: RobotState,
    inbox: Inbox<{ MAX_STATE_SIZE + 1 }>,
    /// Where the newest state came from: the address that commands go to.
    robot: Option<SocketAddr>,
    last_id: Option<u64>,
    response_timeout: Duration,
}

impl ClientLink {
    /// Connects and agrees on a version: the robot's own if the configuration permits it.
    pub(super) fn connect(config: &ClientConfig) -> Result<Self, ClientError> {
        let host = |source| ClientError::Host {
            host: config.host.clone(),
            source,
        };
        let none = || std::io::Error::new(ErrorKind::NotFound, "no address");
        let address = (config.host.as_str(), config.port)
            .to_socket_addrs()
            .map_err(host)?
            .next()
            .ok_or_else(|| host(none()))?;
        let machine = &config.machine;
        let udp = machine.datagrams((config.local, 0).into());
        let udp = udp.map_err(io("open a UDP port"))?;
        let port = udp.address().map_err(io("open a UDP port"))?.port();
        let (timeout, spin) = (config.state_timeout, config.spin);
        let inbox = Inbox::new(Arc::clone(machine), udp, timeout, spin, config.busy_poll_us)?;

        let mut untried: Vec<Version> = config.versions.clone();
        let mut robot = 0;
        while !untried.is_empty() {
            let version = untried.remove(0);
            let (tcp, payload) = CommandChannel::connect(config, address, version, port)?;
            let answer = ConnectAnswer::decode(&payload)?;
            if answer.status == Status::Success {
                return Self::agreed(config, tcp, inbox, version);
            }
            tcp.shut_down();
            robot = answer.version;
            // The robot names its version: if it is permitted, the others need no trial.
            if untried.iter().any(|v| v.number() == robot) {
                untried.retain(|v| v.number() == robot);
            }
        }
        Err(ClientError::Version {
            robot,
            permitted: config.versions.iter().map(|v| v.number()).collect(),
        })
    }

    fn agreed(
        config: &ClientConfig,
        tcp: CommandChannel,
        inbox: Inbox<{ MAX_STATE_SIZE + 1 }>,
        version: Version,
    ) -> Result<Self, ClientError> {
        let mut link = Self {
            machine: Arc::clone(&config.machine),
            tcp,
            version,
            statistics: LinkStatistics {
                lowest_success_rate: 1.0,
                ..LinkStatistics::default()
            },
            newest: RobotState::default(),
            inbox,
            robot: None,
            last_id: None,
            response_timeout: config.response_timeout,
        };
        // The first state may take longer than the period: the robot has to start its transmission.
        let deadline = link.machine.now() + config.connect_timeout;
        loop {
            match link.receive() {
                Err(ClientError::Silent { .. }) if link.machine.now() < deadline => {}
                Err(error) => return Err(error),
                Ok(_) => return Ok(link),
            }
        }
    }

    /// Waits for a state that is newer than the last one and takes the newest that has come, into `self.newest`.
    /// Returns how many periods went by between the two. Allocates nothing.
    pub(super) fn receive(&mut self) -> Result<u64, ClientError> {
        let before = self.last_id;
        let states_before = self.statistics.states;
        let mut taken = false;
        let mut wait = self.inbox.wait()?;
        while let Some((size, from)) = self.inbox.next(&mut wait, taken)? {
            taken |= self.take(size, from)?;
        }
        if !taken {
            return Err(self.silent(self.inbox.waited(&wait)));
        }
        let (Some(before), Some(now)) = (before, self.last_id) else {
            return Ok(0);
        };
        self.statistics.superseded += self.statistics.states - states_before - 1;
        Ok(now.saturating_sub(before).saturating_sub(1))
    }

    fn silent(&self, after: Duration) -> ClientError {
        if self.tcp.is_closed() {
            ClientError::Closed
        } else {
            ClientError::Silent { after }
        }
    }

    /// Takes a datagram if it is a state newer than the last one.
    fn take(&mut self, size: usize, from: SocketAddr) -> Result<bool, ClientError> {
        if self.tcp.peer() != from.ip() {
            self.statistics.foreign += 1;
            return Ok(false);
        }
        let state = RobotState::decode(self.version, self.inbox.bytes(size))?;
        if self.last_id.is_some_and(|last| state.message_id <= last) {
            self.statistics.stale += 1;
            return Ok(false);
        }
        let gap = self.last_id.map_or(0, |last| state.message_id - last - 1);
        self.statistics.states += 1;
        self.statistics.missed += gap;
        self.statistics.longest_gap = self.statistics.longest_gap.max(gap);
        self.last_id = Some(state.message_id);
        self.robot = Some(from);
        self.newest = state;
        Ok(true)
    }

    /// Sends a command to the address that the newest state came from. Allocates nothing.
    pub(super) fn send(&mut self, command: &RobotCommand) -> Result<(), ClientError> {
        let Some(robot) = self.robot else {
            return Err(ClientError::NothingToAnswer);
        };
        let mut bytes = [0; MAX_COMMAND_SIZE];
        let size = command.encode(self.version, &mut bytes);
        self.inbox.send(&bytes[..size], robot)?;
        self.statistics.commands += 1;
        Ok(())
    }

    /// The robot's address.
    pub(super) fn peer(&self) -> IpAddr {
        self.tcp.peer()
    }

    /// Sends a request and takes any status but success for an error.
    pub(super) fn request(&mut self, request: &Request) -> Result<RawResponse, ClientError> {
        let answer = self.tcp.request(request, self.response_timeout)?;
        match answer.status {
            Status::Success | Status::MotionStarted => Ok(answer),
            status => Err(ClientError::Refused {
                command: request.command(),
                status,
                mode: self.newest.robot_mode,
            }),
        }
    }

    /// The robot model in URDF. `None` where the version has no such request.
    pub(super) fn robot_model(&mut self) -> Result<Option<String>, ClientError> {
        if CommandKind::GetRobotModel.number(self.version).is_err() {
            return Ok(None);
        }
        let answer = self.request(&Request::GetRobotModel)?;
        let text = String::from_utf8(answer.body).map_err(|_| crate::wire::WireError::NotText)?;
        Ok(Some(text))
    }
}
