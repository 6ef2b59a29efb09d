//! One client of the robot side: its TCP connection and where its states go. Nothing here waits.

use std::io::ErrorKind;
use std::net::{IpAddr, SocketAddr};

use spherecal_cyclic::Stream;

use crate::wire::{
    CommandHeader, CommandKind, HEADER_SIZE, MAX_REQUEST, Request, Response, Status, Version, WireError,
};

/// What came from a client.
#[allow(clippy::large_enum_variant, reason = "as Request itself")]
pub(super) enum Incoming {
    /// A request with its id.
    Request(u32, Request),
    /// A request whose arguments are invalid, with its id.
    Invalid(u32, CommandKind),
}

pub(super) struct ClientSession {
    stream: Box<dyn Stream>,
    peer: IpAddr,
    version: Version,
    inbox: Vec<u8>,
    outbox: Vec<u8>,
    /// Where states go, as soon as the client has connected.
    pub(super) states_to: Option<SocketAddr>,
    closing: bool,
}

impl ClientSession {
    pub(super) fn new(stream: Box<dyn Stream>, peer: SocketAddr, version: Version) -> Self {
        Self {
            stream,
            peer: peer.ip(),
            version,
            inbox: Vec::new(),
            outbox: Vec::new(),
            states_to: None,
            closing: false,
        }
    }

    pub(super) fn peer(&self) -> IpAddr {
        self.peer
    }

    /// Reads and writes what is possible without waiting. `false`: the connection is over.
    pub(super) fn poll(&mut self) -> bool {
        let mut part = [0; 4096];
        loop {
            match self.stream.read(&mut part) {
                Ok(0) => return false,
                Ok(count) => self.inbox.extend_from_slice(&part[..count]),
                Err(error) if error.kind() == ErrorKind::WouldBlock => break,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
            if self.inbox.len() > 16 * MAX_REQUEST {
                return false;
            }
        }
        while !self.outbox.is_empty() {
            match self.stream.write(&self.outbox) {
                Ok(count) => drop(self.outbox.drain(..count)),
                Err(error) if error.kind() == ErrorKind::WouldBlock => return true,
                Err(error) if error.kind() == ErrorKind::Interrupted => {}
                Err(_) => return false,
            }
        }
        !self.closing
    }

    /// The next request that has come completely.
    pub(super) fn next(&mut self) -> Result<Option<Incoming>, WireError> {
        if self.closing || self.inbox.len() < HEADER_SIZE {
            return Ok(None);
        }
        let header = CommandHeader::decode(&self.inbox, MAX_REQUEST)?;
        let size = header.size as usize;
        if self.inbox.len() < size {
            return Ok(None);
        }
        let request = Request::decode(self.version, header.command, &self.inbox[HEADER_SIZE..size]);
        self.inbox.drain(..size);
        match request {
            Ok(request) => Ok(Some(Incoming::Request(header.id, request))),
            Err(WireError::NotFinite { .. } | WireError::UnknownValue { .. }) => {
                let command = CommandKind::from_number(header.command, self.version)?;
                Ok(Some(Incoming::Invalid(header.id, command)))
            }
            Err(error) => Err(error),
        }
    }

    /// Queues a response; [`poll`](Self::poll) sends it.
    pub(super) fn respond(&mut self, command: CommandKind, id: u32, status: Status, body: &[u8]) {
        let response = Response {
            command,
            id,
            status,
            body,
        };
        // The command was decoded in this version, so it exists in it.
        let encoded = response.encode(self.version, &mut self.outbox);
        debug_assert!(encoded.is_ok());
    }

    /// Ends the connection as soon as everything is sent.
    pub(super) fn close(&mut self) {
        self.closing = true;
    }
}
