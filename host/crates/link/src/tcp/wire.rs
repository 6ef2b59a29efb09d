//! A TCP connection or a serial port as a stream of frames.

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpStream, ToSocketAddrs};
use std::time::{Duration, Instant};

use serde::Deserialize;
use spherecal_shared::protocol::drive::{DriveHello, TorqueSign};
use spherecal_shared::protocol::frame::{
    self, Accumulator, FrameError, Header, LinkCounters, MAX_FRAME, Message, SequenceWatch,
};
use spherecal_shared::robot::JointLimits;
use spherecal_shared::{Joints, MAX_JOINTS};

use super::TcpError;
use super::lobby::Candidate;
use super::progress::FrameGap;
use super::stream::Stream;
use spherecal_budget::CONNECT;
use spherecal_budget::link::READ;

/// Outcome of parsing one frame.
#[expect(clippy::large_enum_variant, reason = "frames are parsed without an allocation")]
pub(super) enum Parsed<T> {
    /// The expected message.
    Message(Header, T),
    /// A drive's hello that is not expected here: it may repeat the one of the session.
    Hello(DriveHello),
    /// A message of another type or version.
    Other([u8; 8]),
    /// A message of the expected type, with a valid checksum, one of whose fields has a value that the field
    /// cannot have.
    Field(&'static str),
}

/// One end of a connection.
pub(super) struct Wire {
    stream: Stream,
    pub(super) peer: String,
    accumulator: Accumulator,
    watch: SequenceWatch,
    counters: LinkCounters,
    buffer: Vec<u8>,
    at: usize,
    filled: usize,
    sent: u32,
    progress: FrameGap,
    /// How long a read waits; `None` waits for ever, or not at all where nothing waits.
    patience: Option<Duration>,
    /// The time limit of reads that the system has.
    limit: Option<Duration>,
    waits: bool,
    /// The rest of a frame that found no room, and since when it waits.
    rest: Vec<u8>,
    stuck: Option<Instant>,
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
        Ok(Self::over(Stream::Tcp(stream), peer))
    }

    /// Speaks over an open stream.
    pub(super) fn over(stream: Stream, peer: String) -> Self {
        Self {
            stream,
            peer,
            accumulator: Accumulator::new(),
            watch: SequenceWatch::new(),
            counters: LinkCounters::new(),
            buffer: vec![0; 4 * MAX_FRAME],
            at: 0,
            filled: 0,
            sent: 0,
            progress: FrameGap::default(),
            patience: None,
            limit: None,
            waits: true,
            rest: Vec::new(),
            stuck: None,
        }
    }

    /// Takes over a connection of which some bytes were read already.
    pub(super) fn resume(candidate: Candidate, who: &str) -> Result<Self, TcpError> {
        let mut wire = Self::new(candidate.stream, format!("{who} at {}", candidate.address))?;
        wire.buffer.resize(wire.buffer.len().max(candidate.bytes.len()), 0);
        if let Some(front) = wire.buffer.get_mut(..candidate.bytes.len()) {
            front.copy_from_slice(&candidate.bytes);
        }
        wire.filled = candidate.bytes.len();
        Ok(wire)
    }

    /// The number of the next frame, where earlier ones were sent before this side took the connection over.
    pub(super) fn has_sent(&mut self, frames: u32) {
        self.sent = frames;
    }

    /// Reads wait at most this long for the first byte of a message; `None` waits for ever. Bytes that
    /// come and are no valid frame for [`NO_FRAME`](spherecal_budget::link::NO_FRAME) are an error.
    pub(super) fn patience(&mut self, patience: Option<Duration>) -> Result<(), TcpError> {
        (self.patience, self.limit, self.waits) = (patience, patience, true);
        self.stream
            .wait(patience, READ)
            .map_err(|e| TcpError::of(&self.peer, e))
    }

    /// Neither reads nor writes wait.
    pub(super) fn never_wait(&mut self) -> Result<(), TcpError> {
        self.waits = false;
        self.stream.never_wait().map_err(|e| TcpError::of(&self.peer, e))
    }

    /// Whether bytes that were received wait to be looked at.
    pub(super) fn has_more(&self) -> bool {
        self.at < self.filled
    }

    /// Whether bytes came since the last valid frame.
    pub(super) fn is_noisy(&self) -> bool {
        self.progress.left().is_some()
    }

    pub(super) fn counters(&self) -> LinkCounters {
        self.counters
    }

    /// Sends a message. Where writes do not wait, a message that finds no room is dropped as a
    /// whole and counted as overflow; one that finds too little room is completed with the next.
    pub(super) fn send<M: Message>(&mut self, message: &M, time_us: u64) -> Result<(), TcpError> {
        let mut out = [0; MAX_FRAME];
        let length = frame::encode(message, self.sent, time_us, &mut out)?;
        self.sent = self.sent.wrapping_add(1);
        if !self.flush()? {
            self.counters.overflow = self.counters.overflow.wrapping_add(1);
            return Ok(());
        }
        let frame = out.get(..length).unwrap_or_default();
        let begun = self.write(frame)?;
        if begun == 0 {
            self.counters.overflow = self.counters.overflow.wrapping_add(1);
        } else if begun < frame.len() {
            self.rest.extend_from_slice(frame.get(begun..).unwrap_or_default());
        }
        Ok(())
    }

    /// Sends the rest of a frame that was begun; whether all of it is sent.
    fn flush(&mut self) -> Result<bool, TcpError> {
        if self.rest.is_empty() {
            return Ok(true);
        }
        let rest = std::mem::take(&mut self.rest);
        let begun = self.write(&rest)?;
        self.rest.extend_from_slice(rest.get(begun..).unwrap_or_default());
        Ok(self.rest.is_empty())
    }

    /// Writes as much as there is room for; returns how much. Fails if there has been no room for
    /// too long.
    fn write(&mut self, bytes: &[u8]) -> Result<usize, TcpError> {
        let mut at = 0;
        while at < bytes.len() {
            match self.stream.write(bytes.get(at..).unwrap_or_default()) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => {
                    at += count;
                    self.stuck = None;
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    let since = *self.stuck.get_or_insert_with(Instant::now);
                    // A write that waits has waited its whole time limit.
                    if self.waits || since.elapsed() >= READ {
                        return Err(TcpError::Deaf {
                            peer: self.peer.clone(),
                            seconds: READ.as_secs(),
                        });
                    }
                    break;
                }
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
        Ok(at)
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
                        self.progress.valid();
                        self.stream.heard();
                        if self.has_more() {
                            self.progress.came(self.filled - self.at);
                        }
                        self.watch.record(header.sequence, &mut self.counters);
                        return Ok(Some(Parsed::Message(header, message)));
                    }
                    Some(Ok(other)) => return Ok(Some(other)),
                    Some(Err(_)) => {
                        self.progress.damaged();
                        self.counters.crc_errors = self.counters.crc_errors.wrapping_add(1);
                    }
                }
            }
            self.progress.check(&self.peer)?;
            self.limit_read()?;
            match self.stream.read(&mut self.buffer) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => {
                    (self.at, self.filled) = (0, count);
                    self.progress.came(count);
                }
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    self.progress.check(&self.peer)?;
                    // The limit that the bytes so far left may end a little early.
                    if !self.waits || self.limit == self.patience {
                        return Ok(None);
                    }
                }
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
    }

    /// Gives the next read the time limit that the bytes received so far leave.
    fn limit_read(&mut self) -> Result<(), TcpError> {
        if !self.waits {
            return Ok(());
        }
        let left = self.progress.left().map(|left| left.max(Duration::from_millis(1)));
        let limit = match (left, self.patience) {
            (Some(left), Some(patience)) => Some(left.min(patience)),
            (left, patience) => left.or(patience),
        };
        if limit != self.limit {
            self.stream
                .wait_for_reads(limit)
                .map_err(|e| TcpError::of(&self.peer, e))?;
            self.limit = limit;
        }
        Ok(())
    }

    /// Like [`receive`](Self::receive), but any other message is an error.
    pub(super) fn expect<M: Message>(&mut self, what: &'static str) -> Result<Option<(Header, M)>, TcpError> {
        match self.receive::<M>()? {
            None => Ok(None),
            Some(Parsed::Message(header, message)) => Ok(Some((header, message))),
            Some(other) => Err(self.unexpected::<M>(what, other)),
        }
    }

    pub(super) fn unexpected<M: Message>(&self, what: &'static str, came: Parsed<M>) -> TcpError {
        let peer = self.peer.clone();
        let found = match came {
            Parsed::Field(field) => return TcpError::Field { peer, what, field },
            Parsed::Other(found) => found,
            Parsed::Hello(_) => DriveHello::KEY,
            Parsed::Message(..) => M::KEY,
        };
        TcpError::Schema {
            peer,
            what,
            found,
            expected: M::KEY,
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

    /// Returns the stream, for a caller that speaks plain bytes from here on, and the bytes that were already read.
    pub(super) fn into_stream(self) -> (Stream, Vec<u8>) {
        let rest = self.buffer.get(self.at..self.filled).unwrap_or_default().to_vec();
        (self.stream, rest)
    }
}

fn parse<M: Message>(bytes: &mut [u8]) -> Result<Parsed<M>, FrameError> {
    let (header, body) = frame::open(bytes)?;
    if header.key == M::KEY {
        return Ok(match postcard::from_bytes(body) {
            Ok(message) => Parsed::Message(header, message),
            Err(_) => Parsed::Field(wrong_field(header.key, body)),
        });
    }
    if header.key == DriveHello::KEY
        && let Ok(hello) = postcard::from_bytes(body)
    {
        return Ok(Parsed::Hello(hello));
    }
    Ok(Parsed::Other(header.key))
}

/// The first field of a drive's hello that does not decode; for other messages, that it is one of theirs.
fn wrong_field(key: [u8; 8], body: &[u8]) -> &'static str {
    if key != DriveHello::KEY {
        return "a field";
    }
    /// Decodes one field; the bytes behind it.
    fn behind<'a, T: Deserialize<'a>>(body: &'a [u8]) -> Option<&'a [u8]> {
        postcard::take_from_bytes::<T>(body).ok().map(|(_, rest)| rest)
    }
    type Field = for<'a> fn(&'a [u8]) -> Option<&'a [u8]>;
    let fields: [(&str, Field); 10] = [
        ("protocol", |body| behind::<u16>(body)),
        ("session", |body| behind::<u32>(body)),
        ("limits", |body| behind::<heapless::Vec<JointLimits, MAX_JOINTS>>(body)),
        ("period_us", |body| behind::<u32>(body)),
        ("compensates_gravity", |body| behind::<bool>(body)),
        ("torque_sign", |body| behind::<TorqueSign>(body)),
        ("lock_step", |body| behind::<bool>(body)),
        ("motor_kg_m2", |body| behind::<Joints>(body)),
        ("latency_us", |body| behind::<u32>(body)),
        ("simulated", |body| behind::<bool>(body)),
    ];
    let mut rest = body;
    for (name, field) in fields {
        match field(rest) {
            Some(behind) => rest = behind,
            None => return name,
        }
    }
    "a field"
}
