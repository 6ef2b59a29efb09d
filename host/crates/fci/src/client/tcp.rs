//! The TCP channel of the client: one request at a time, responses by id.

use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr};
use std::sync::Arc;
use std::time::{Duration, Instant};

use spherecal_cyclic::{Machine, Stream, io_error as io};

use super::{ClientConfig, ClientError};
use crate::wire::{CommandHeader, CommandKind, HEADER_SIZE, Request, Response, Status, Version};
use spherecal_budget::HANDSHAKE;
use spherecal_budget::robot::RESPONSE_BYTES;

/// A response with its body, copied out of the receive buffer.
pub(super) struct RawResponse {
    pub(super) status: Status,
    pub(super) body: Vec<u8>,
}

/// The TCP connection after the version is agreed.
pub(super) struct CommandChannel {
    machine: Arc<dyn Machine>,
    stream: Box<dyn Stream>,
    peer: IpAddr,
    version: Version,
    next_id: u32,
    received: Vec<u8>,
    /// The id of the Move request whose end has not been reported yet.
    move_id: Option<u32>,
    /// How the last motion ended, as soon as the robot said so.
    move_end: Option<Status>,
    /// The request that was posted last, until its response comes.
    posted: Option<(CommandKind, u32)>,
}

impl CommandChannel {
    /// Opens the connection and sends Connect. Returns the robot's payload: status and version.
    pub(super) fn connect(
        config: &ClientConfig,
        address: SocketAddr,
        version: Version,
        udp_port: u16,
    ) -> Result<(Self, Vec<u8>), ClientError> {
        let machine = Arc::clone(&config.machine);
        let after = config.response_timeout.min(HANDSHAKE);
        let stream = machine
            .connect(address, config.connect_timeout)
            .map_err(|source| ClientError::Connect { address, source })?;
        let mut tcp = Self {
            machine,
            stream,
            peer: address.ip(),
            version,
            next_id: 0,
            received: Vec::new(),
            move_id: None,
            move_end: None,
            posted: None,
        };
        let request = Request::Connect {
            version: version.number(),
            udp_port,
        };
        let id = tcp.send(&request)?;
        let deadline = tcp.machine.now() + after;
        loop {
            let Some((header, payload)) = tcp.frame(deadline)? else {
                return Err(ClientError::NoResponse {
                    command: CommandKind::Connect,
                    after,
                });
            };
            if header.command == 0 && header.id == id {
                return Ok((tcp, payload));
            }
        }
    }

    /// The robot's address.
    pub(super) fn peer(&self) -> IpAddr {
        self.peer
    }

    /// Sends a request; returns its id.
    fn send(&mut self, request: &Request) -> Result<u32, ClientError> {
        let id = self.next_id;
        self.next_id = id.wrapping_add(1);
        let mut bytes = Vec::with_capacity(512);
        request.encode(self.version, id, &mut bytes)?;
        self.stream.write_all(&bytes).map_err(|error| match error.kind() {
            ErrorKind::BrokenPipe | ErrorKind::ConnectionReset => ClientError::Closed,
            _ => io("send a request")(error).into(),
        })?;
        Ok(id)
    }

    /// Sends a request and waits for its response.
    pub(super) fn request(&mut self, request: &Request, timeout: Duration) -> Result<RawResponse, ClientError> {
        if matches!(request, Request::Move(_)) {
            self.move_end = None;
        }
        let id = self.send(request)?;
        if matches!(request, Request::Move(_)) {
            self.move_id = Some(id);
        }
        let deadline = self.machine.now() + timeout;
        while let Some((header, payload)) = self.frame(deadline)? {
            let response = Response::decode(self.version, header, &payload)?;
            if response.id == id && response.command == request.command() {
                if response.command == CommandKind::Move && response.status != Status::MotionStarted {
                    self.move_id = None;
                }
                return Ok(RawResponse {
                    status: response.status,
                    body: response.body.to_vec(),
                });
            }
            self.keep_move_end(&response);
        }
        Err(ClientError::NoResponse {
            command: request.command(),
            after: timeout,
        })
    }

    /// Sends a request without waiting for its response.
    pub(super) fn post(&mut self, request: &Request) -> Result<(), ClientError> {
        let id = self.send(request)?;
        self.posted = Some((request.command(), id));
        Ok(())
    }

    /// The response to what was posted, once; waits at most for `timeout`.
    pub(super) fn posted_answer(&mut self, timeout: Duration) -> Result<Option<Status>, ClientError> {
        let deadline = self.machine.now() + timeout;
        while let Some((command, id)) = self.posted {
            let Some((header, payload)) = self.frame(deadline)? else {
                break;
            };
            let response = Response::decode(self.version, header, &payload)?;
            if (response.command, response.id) == (command, id) {
                self.posted = None;
                return Ok(Some(response.status));
            }
            self.keep_move_end(&response);
        }
        Ok(None)
    }

    /// Waits for the response that says how the motion ended. `None` if it does not come in time.
    pub(super) fn motion_end(&mut self, timeout: Duration) -> Result<Option<Status>, ClientError> {
        let deadline = self.machine.now() + timeout;
        while self.move_end.is_none() && self.move_id.is_some() {
            let Some((header, payload)) = self.frame(deadline)? else {
                break;
            };
            let response = Response::decode(self.version, header, &payload)?;
            self.keep_move_end(&response);
        }
        Ok(self.move_end.take())
    }

    fn keep_move_end(&mut self, response: &Response<'_>) {
        let ours = response.command == CommandKind::Move && Some(response.id) == self.move_id;
        if ours && response.status != Status::MotionStarted {
            self.move_id = None;
            self.move_end = Some(response.status);
        }
    }

    /// Whether the robot has closed the connection. Does not wait.
    pub(super) fn is_closed(&self) -> bool {
        self.stream.is_closed()
    }

    /// The next message: header and payload. `None` at the deadline.
    fn frame(&mut self, deadline: Instant) -> Result<Option<(CommandHeader, Vec<u8>)>, ClientError> {
        loop {
            if self.received.len() >= HEADER_SIZE {
                let header = CommandHeader::decode(&self.received, RESPONSE_BYTES)?;
                let size = header.size as usize;
                if self.received.len() >= size {
                    let payload = self.received[HEADER_SIZE..size].to_vec();
                    self.received.drain(..size);
                    return Ok(Some((header, payload)));
                }
            }
            let left = deadline.saturating_duration_since(self.machine.now());
            if left.is_zero() {
                return Ok(None);
            }
            self.stream.set_wait(Some(left)).map_err(io("set a timeout"))?;
            let mut part = [0; 4096];
            match self.stream.read(&mut part) {
                Ok(0) => return Err(ClientError::Closed),
                Ok(count) => self.received.extend_from_slice(&part[..count]),
                Err(error) => match error.kind() {
                    ErrorKind::WouldBlock | ErrorKind::TimedOut => return Ok(None),
                    ErrorKind::Interrupted => {}
                    ErrorKind::ConnectionReset | ErrorKind::BrokenPipe => return Err(ClientError::Closed),
                    _ => return Err(io("read a response")(error).into()),
                },
            }
        }
    }

    pub(super) fn shut_down(&self) {
        self.stream.close();
    }
}
