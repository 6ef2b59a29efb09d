//! Hosts of a controller in real time: whatever they do, each period is carried out.

use std::io::{ErrorKind, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use spherecal_budget::link::{BACKLOG_BYTES, FRAMES_DOWN, SILENT};
use spherecal_shared::protocol::frame::{self, MAX_FRAME, Message as _};
use spherecal_shared::protocol::host::Downlink;

use super::TcpError;
use super::lobby::{Candidate, Lobby, Look};
use super::progress::FrameWatch;
use super::stream::read_some;
use crate::{Device as _, LinkError, LocalDevice};

/// Bytes that the controller sends in one period, with room to spare.
const UP: usize = 16 * MAX_FRAME;

/// Serves one host after the other in real time, one control period at a time. While no host is connected, and whatever
/// a host does, each period is carried out. Apart from a host that connects or is disconnected, a period allocates
/// nothing here.
pub struct HostService<'a> {
    listener: &'a TcpListener,
    lobby: Lobby,
    greeting: Vec<u8>,
    host: Option<Host>,
    silent: Option<Duration>,
    reason: Option<TcpError>,
    down: Vec<u8>,
    up: Vec<u8>,
}

impl<'a> HostService<'a> {
    /// No host is connected yet. A host that sends no valid frame for 5 s is disconnected.
    ///
    /// # Errors
    /// The listener fails.
    pub fn new(listener: &'a TcpListener) -> Result<Self, LinkError> {
        Self::with_patience(listener, Some(SILENT))
    }

    pub(super) fn with_patience(listener: &'a TcpListener, silent: Option<Duration>) -> Result<Self, LinkError> {
        listener
            .set_nonblocking(true)
            .map_err(|e| TcpError::of("the host link", e))?;
        Ok(Self {
            listener,
            lobby: Lobby::new(WHO, Some(Downlink::KEY)),
            greeting: Vec::new(),
            host: None,
            silent,
            reason: None,
            down: Vec::with_capacity(FRAMES_DOWN * MAX_FRAME + MAX_FRAME),
            up: Vec::with_capacity(UP),
        })
    }

    /// Why the last host was disconnected, once; `None` if it disconnected by itself.
    pub fn reason(&mut self) -> Option<TcpError> {
        self.reason.take()
    }

    /// One control period. Returns whether a host has disconnected that had sent anything: one that has not only looked
    /// whether the controller is there got no place.
    ///
    /// # Errors
    /// The cell fails, or the listener fails.
    pub fn turn(&mut self, cell: &mut LocalDevice) -> Result<bool, LinkError> {
        self.admit(cell)?;
        self.down.clear();
        self.up.clear();
        let mut left = self.host.as_mut().and_then(|host| host.read(&mut self.down).err());
        cell.step(&self.down, &mut self.up)?;
        if let Some(host) = self.host.as_mut().filter(|_| left.is_none()) {
            left = host.write(&self.up).err();
        }
        let Some(reason) = left else {
            return Ok(false);
        };
        self.host = None;
        self.reason = Some(reason).filter(|reason| !reason.is_closed());
        Ok(true)
    }

    /// Gives the place to a host that has sent a valid frame, or else to one that has sent anything.
    fn admit(&mut self, cell: &LocalDevice) -> Result<(), LinkError> {
        if self.host.as_ref().is_some_and(|host| host.proven) {
            return Ok(());
        }
        if self.greeting.is_empty() {
            self.greeting = hello_frame(cell)?;
        }
        if self.silent.is_none() {
            // The host of this process, which may say nothing.
            match self.listener.accept() {
                Ok((mut stream, address)) => {
                    let failed = |e| TcpError::of(WHO, e);
                    stream.set_nodelay(true).map_err(failed)?;
                    stream.write_all(&self.greeting).map_err(failed)?;
                    stream.set_nonblocking(true).map_err(failed)?;
                    self.host = Some(Host::new(
                        Candidate::new(stream, address, Some(Downlink::KEY)),
                        self.silent,
                    ));
                }
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(e) => return Err(TcpError::of(WHO, e).into()),
            }
            return Ok(());
        }
        match self.lobby.look(self.listener, &self.greeting)? {
            Look::Spoke(candidate) => {
                if let Some(unproven) = self.host.replace(Host::new(candidate, self.silent)) {
                    self.reason = Some(gives_way(&unproven.peer, unproven.heard));
                }
            }
            Look::Left(reason) => self.reason = reason,
            Look::Nothing if self.host.is_none() => {
                let first = self.lobby.first_that_sent();
                self.host = first.map(|candidate| Host::new(candidate, self.silent));
            }
            Look::Nothing => {}
        }
        Ok(())
    }
}

/// A host in real time. Nothing waits for it.
struct Host {
    stream: TcpStream,
    peer: String,
    silent: Option<Duration>,
    backlog: Vec<u8>,
    watch: FrameWatch,
    heard: Instant,
    /// Since when the backlog has not become shorter.
    stuck: Option<Instant>,
    /// What it sent before it got its place.
    early: Vec<u8>,
    /// Whether a valid frame came from it.
    proven: bool,
}

impl Host {
    /// A host that has been greeted. Its connection does not wait.
    fn new(candidate: Candidate, silent: Option<Duration>) -> Self {
        Self {
            stream: candidate.stream,
            backlog: Vec::with_capacity(BACKLOG_BYTES + UP + 1),
            peer: format!("{WHO} at {}", candidate.address),
            silent,
            watch: FrameWatch::of::<Downlink>(),
            heard: Instant::now(),
            stuck: None,
            early: candidate.bytes,
            proven: silent.is_none(),
        }
    }

    fn read(&mut self, down: &mut Vec<u8>) -> Result<(), TcpError> {
        let mut buffer = [0; MAX_FRAME];
        down.append(&mut self.early);
        while down.len() < FRAMES_DOWN * MAX_FRAME {
            match read_some(&mut self.stream, &mut buffer).map_err(|e| TcpError::of(&self.peer, e))? {
                0 => break,
                count => down.extend_from_slice(buffer.get(..count).unwrap_or_default()),
            }
        }
        if self.watch.look(down) {
            (self.heard, self.proven) = (Instant::now(), true);
        }
        self.watch.progress.check(&self.peer)?;
        let noisy = self.watch.progress.left().is_some();
        if !noisy && self.silent.is_some_and(|most| self.heard.elapsed() >= most) {
            return Err(TcpError::Gone {
                peer: self.peer.clone(),
                what: "the controller holds the arm and waits for another host",
                seconds: self.heard.elapsed().as_secs(),
            });
        }
        Ok(())
    }

    fn write(&mut self, up: &[u8]) -> Result<(), TcpError> {
        self.backlog.extend_from_slice(up);
        self.backlog.push(0);
        while !self.backlog.is_empty() {
            match self.stream.write(&self.backlog) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => {
                    drop(self.backlog.drain(..count));
                    self.stuck = None;
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
        if self.backlog.is_empty() {
            return Ok(());
        }
        let stuck = self.stuck.get_or_insert_with(Instant::now).elapsed();
        let hangs = self.silent.is_some_and(|most| stuck >= most);
        if hangs || self.backlog.len() > BACKLOG_BYTES {
            return Err(TcpError::Deaf {
                peer: self.peer.clone(),
                seconds: stuck.as_secs(),
            });
        }
        Ok(())
    }
}

/// What the peers are called.
pub(super) const WHO: &str = "the host";

/// The reason of a host that gave way.
pub(super) fn gives_way(peer: &str, heard: Instant) -> TcpError {
    TcpError::Gone {
        peer: peer.to_owned(),
        what: "it gives way to another host",
        seconds: heard.elapsed().as_secs(),
    }
}

/// The drive's hello, framed for the host.
pub(super) fn hello_frame(cell: &LocalDevice) -> Result<Vec<u8>, TcpError> {
    let mut bytes = vec![0; MAX_FRAME];
    let length = frame::encode(cell.hello(), 0, cell.now_us(), &mut bytes)?;
    bytes.truncate(length);
    Ok(bytes)
}
