//! A TCP connection as a stream of frames.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::Duration;

use spherecal_shared::protocol::frame::{
    self, Accumulator, FrameError, Header, LinkCounters, MAX_FRAME, Message, SequenceWatch,
};

use super::TcpError;

/// How long it may take to connect.
const CONNECT: Duration = Duration::from_secs(5);

/// Outcome of parsing one frame.
pub(super) enum Parsed<T> {
    /// The expected message.
    Message(Header, T),
    /// A message of another type or version.
    Other([u8; 8]),
}

/// One end of a connection.
pub(super) struct Wire {
    stream: TcpStream,
    pub(super) peer: String,
    accumulator: Accumulator,
    watch: SequenceWatch,
    counters: LinkCounters,
    buffer: Vec<u8>,
    at: usize,
    filled: usize,
    sent: u32,
}

impl Wire {
    /// Connects to `address` (`HOST:PORT`).
    pub(super) fn connect(address: &str) -> Result<Self, TcpError> {
        let peer = format!("tcp:{address}");
        let unreachable = |source| TcpError::Unreachable {
            peer: peer.clone(),
            source,
        };
        let mut last = std::io::Error::from(ErrorKind::AddrNotAvailable);
        for candidate in address.to_socket_addrs().map_err(unreachable)? {
            match TcpStream::connect_timeout(&candidate, CONNECT) {
                Ok(stream) => return Self::new(stream, peer),
                Err(error) => last = error,
            }
        }
        Err(unreachable(last))
    }

    /// Takes over a connection.
    pub(super) fn new(stream: TcpStream, peer: String) -> Result<Self, TcpError> {
        // Small messages must not wait for later ones.
        stream.set_nodelay(true).map_err(|e| TcpError::of(&peer, e))?;
        Ok(Self {
            stream,
            peer,
            accumulator: Accumulator::new(),
            watch: SequenceWatch::new(),
            counters: LinkCounters::new(),
            buffer: vec![0; 4 * MAX_FRAME],
            at: 0,
            filled: 0,
            sent: 0,
        })
    }

    /// Reads wait at most this long; `None` waits for ever.
    pub(super) fn patience(&self, patience: Option<Duration>) -> Result<(), TcpError> {
        self.stream
            .set_nonblocking(false)
            .and_then(|()| self.stream.set_read_timeout(patience))
            .and_then(|()| self.stream.set_write_timeout(Some(Duration::from_secs(10))))
            .map_err(|e| TcpError::of(&self.peer, e))
    }

    /// Neither reads nor writes wait.
    pub(super) fn never_wait(&self) -> Result<(), TcpError> {
        self.stream
            .set_nonblocking(true)
            .map_err(|e| TcpError::of(&self.peer, e))
    }

    /// What was received.
    pub(super) fn counters(&self) -> LinkCounters {
        self.counters
    }

    /// Sends a message. Where writes do not wait, a message that finds no room is dropped as a
    /// whole and counted as overflow.
    pub(super) fn send<M: Message>(&mut self, message: &M, time_us: u64) -> Result<(), TcpError> {
        let mut out = [0; MAX_FRAME];
        let length = frame::encode(message, self.sent, time_us, &mut out)?;
        self.sent = self.sent.wrapping_add(1);
        let mut rest = out.get(..length).unwrap_or_default();
        let mut begun = false;
        while !rest.is_empty() {
            match self.stream.write(rest) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => {
                    begun = true;
                    rest = rest.get(count..).unwrap_or_default();
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if e.kind() == ErrorKind::WouldBlock && !begun => {
                    self.counters.overflow = self.counters.overflow.wrapping_add(1);
                    return Ok(());
                }
                // A frame that was begun must be completed; the buffer will drain soon.
                Err(e) if e.kind() == ErrorKind::WouldBlock => std::thread::yield_now(),
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
        Ok(())
    }

    /// Returns the next message of type `M`, or the key of another message that came instead;
    /// `None` when nothing came in time. Damaged frames are counted and skipped.
    pub(super) fn receive<M: Message>(&mut self) -> Result<Option<Parsed<M>>, TcpError> {
        loop {
            while self.at < self.filled {
                let byte = self.buffer.get(self.at).copied().unwrap_or_default();
                self.at += 1;
                let mut parsed = None;
                self.accumulator
                    .push(byte, &mut |frame| parsed = Some(frame.and_then(parse::<M>)));
                match parsed {
                    None => {}
                    Some(Ok(Parsed::Message(header, message))) => {
                        self.watch.record(header.sequence, &mut self.counters);
                        return Ok(Some(Parsed::Message(header, message)));
                    }
                    Some(Ok(other)) => return Ok(Some(other)),
                    Some(Err(_)) => self.counters.crc_errors = self.counters.crc_errors.wrapping_add(1),
                }
            }
            match self.stream.read(&mut self.buffer) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => (self.at, self.filled) = (0, count),
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Ok(None),
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
    }

    /// Like [`receive`](Self::receive), but any other message is an error.
    pub(super) fn expect<M: Message>(&mut self, what: &'static str) -> Result<Option<(Header, M)>, TcpError> {
        match self.receive::<M>()? {
            None => Ok(None),
            Some(Parsed::Message(header, message)) => Ok(Some((header, message))),
            Some(Parsed::Other(found)) => Err(TcpError::Schema {
                peer: self.peer.clone(),
                what,
                found,
                expected: M::KEY,
            }),
        }
    }

    /// Waits for a message, at most `patience`.
    pub(super) fn wait_for<M: Message>(&mut self, what: &'static str, patience: Duration) -> Result<M, TcpError> {
        self.patience(Some(patience))?;
        self.expect(what)?.map(|(_, message)| message).ok_or(TcpError::Silent {
            peer: self.peer.clone(),
            seconds: patience.as_secs(),
            damaged: self.counters.crc_errors,
        })
    }

    /// Returns the connection, for a caller that speaks plain bytes from here on, and the bytes
    /// that were already read.
    ///
    pub(super) fn into_stream(self) -> (TcpStream, Vec<u8>) {
        let rest = self.buffer.get(self.at..self.filled).unwrap_or_default().to_vec();
        (self.stream, rest)
    }
}

fn parse<M: Message>(bytes: &mut [u8]) -> Result<Parsed<M>, FrameError> {
    let (header, body) = frame::open(bytes)?;
    if header.key != M::KEY {
        return Ok(Parsed::Other(header.key));
    }
    let message = postcard::from_bytes(body).map_err(|_| FrameError::Body)?;
    Ok(Parsed::Message(header, message))
}
