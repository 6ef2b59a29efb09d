//! One client of the robot side: its TCP connection and where its states go. Nothing here waits.

use std::net::{IpAddr, SocketAddr};

use spherecal_cyclic::{Stream, Wire};

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
    wire: Wire,
    peer: IpAddr,
    version: Version,
    /// Where states go, as soon as the client has connected.
    pub(super) states_to: Option<SocketAddr>,
}

impl ClientSession {
    pub(super) fn new(stream: Box<dyn Stream>, peer: SocketAddr, version: Version) -> Self {
        Self {
            wire: Wire::new(stream),
            peer: peer.ip(),
            version,
            states_to: None,
        }
    }

    pub(super) fn peer(&self) -> IpAddr {
        self.peer
    }

    /// Reads and writes what is possible without waiting. `false`: the connection is over.
    pub(super) fn poll(&mut self) -> bool {
        self.wire.poll()
    }

    /// The next request that has come completely.
    pub(super) fn next(&mut self) -> Result<Option<Incoming>, WireError> {
        let ends = self.wire.ends();
        let inbox = &mut self.wire.received;
        if ends || inbox.len() < HEADER_SIZE {
            return Ok(None);
        }
        let header = CommandHeader::decode(inbox, MAX_REQUEST)?;
        let size = header.size as usize;
        if inbox.len() < size {
            return Ok(None);
        }
        let request = Request::decode(self.version, header.command, &inbox[HEADER_SIZE..size]);
        inbox.drain(..size);
        match request {
            Ok(request) => Ok(Some(Incoming::Request(header.id, request))),
            Err(WireError::NotFinite { .. } | WireError::UnknownValue { .. }) => {
                let command = CommandKind::from_number(header.command, self.version)?;
                Ok(Some(Incoming::Invalid(header.id, command)))
            }
            Err(error) => Err(error),
        }
    }

    /// Sends a response as soon as the client takes it.
    pub(super) fn respond(&mut self, command: CommandKind, id: u32, status: Status, body: &[u8]) {
        let response = Response {
            command,
            id,
            status,
            body,
        };
        // The command was decoded in this version, so it exists in it.
        let mut bytes = Vec::new();
        let encoded = response.encode(self.version, &mut bytes);
        debug_assert!(encoded.is_ok());
        self.wire.send(&bytes);
    }

    /// Ends the connection as soon as everything is sent.
    pub(super) fn close(&mut self) {
        self.wire.finish();
    }
}
