//! A controller as a process: a cell on one side, hosts that come and go on the other.
//!
//! When a host connects, the server first sends the drive's hello frame, so that the host can check
//! joints, limits and period. After that the connection carries the bytes of the host link. Each
//! side ends its part of every period with an end mark (a zero byte with no frame before it).
//!
//! A host that sends bytes and no valid frame for 5 s, a turn without end, or a turn in parts for 5 s
//! is disconnected. In real time so is one that sends no valid frame for 5 s, or that does not read. In
//! lock-step a host may be silent, because nothing moves; it gives way to another one after 5 s.

use std::io::{ErrorKind, Read, Write};
use std::net::{SocketAddr, TcpListener, TcpStream};
use std::time::{Duration, Instant};

use spherecal_shared::protocol::frame::{self, MAX_FRAME};

use super::TcpError;
use super::progress::{FrameWatch, NO_FRAME};
use super::turns::Turns;
use crate::{Device, LinkError, LocalDevice};

/// Bytes that may wait for a host in real time. A host that falls behind further is disconnected.
const BACKLOG: usize = 1 << 20;
/// Bytes of a host that the controller takes in one period; further bytes wait.
const DOWN: usize = 4 * MAX_FRAME;
/// Bytes that the controller sends in one period, with room to spare.
const UP: usize = 16 * MAX_FRAME;
/// How long a host in real time may be silent, and one in lock-step if another one waits.
const SILENT: Duration = Duration::from_secs(5);
/// How long a host in lock-step may take to read.
const READ: Duration = Duration::from_secs(5);
/// How often a silent host in lock-step is looked after.
const LOOK: Duration = Duration::from_millis(250);

/// Serves one host after the other; with `once` it returns when the first that has sent anything has disconnected. `told`
/// is given the reason for which a host was disconnected.
///
/// In lock-step nothing moves while no host is connected. In real time the controller keeps running
/// every tick and holds the arm.
///
/// # Errors
/// The cell fails, or the listener fails. A host that disconnects is not an error.
pub fn serve_hosts(
    cell: &mut LocalDevice,
    listener: &TcpListener,
    once: bool,
    told: &mut dyn FnMut(&TcpError),
) -> Result<(), LinkError> {
    serve(cell, listener, once, Some(SILENT), told)
}

/// Serves the host of this process, which may be silent for any time, until it disconnects.
pub(super) fn serve_own_host(cell: &mut LocalDevice, listener: &TcpListener) -> Result<(), LinkError> {
    serve(cell, listener, true, None, &mut |_| ())
}

fn serve(
    cell: &mut LocalDevice,
    listener: &TcpListener,
    once: bool,
    silent: Option<Duration>,
    told: &mut dyn FnMut(&TcpError),
) -> Result<(), LinkError> {
    let failed = |e| TcpError::of("the host link", e);
    if cell.hello().lock_step {
        let mut next = None;
        loop {
            let (stream, address) = if let Some(waited) = next.take() {
                waited
            } else {
                listener.set_nonblocking(false).map_err(failed)?;
                listener.accept().map_err(failed)?
            };
            listener.set_nonblocking(true).map_err(failed)?;
            let mut host = TurnHost::new(stream, address, silent);
            let left = host.serve(cell, listener)?;
            next = left.next;
            if let Some(reason) = left.reason {
                told(&reason);
            }
            // The host of this process ends the service even if it has said nothing.
            if once && (host.spoke || silent.is_none()) {
                return Ok(());
            }
        }
    }
    let mut service = HostService::with_patience(listener, silent)?;
    loop {
        let left = service.turn(cell)?;
        if let Some(reason) = service.reason() {
            told(&reason);
        }
        if left && once {
            return Ok(());
        }
    }
}

/// Serves one host after the other in real time, one control period at a time. While no host is connected, and whatever
/// a host does, each period is carried out. Apart from a host that connects or is disconnected, a period allocates
/// nothing here.
pub struct HostService<'a> {
    listener: &'a TcpListener,
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

    fn with_patience(listener: &'a TcpListener, silent: Option<Duration>) -> Result<Self, LinkError> {
        listener
            .set_nonblocking(true)
            .map_err(|e| TcpError::of("the host link", e))?;
        Ok(Self {
            listener,
            host: None,
            silent,
            reason: None,
            down: Vec::with_capacity(DOWN + MAX_FRAME),
            up: Vec::with_capacity(UP),
        })
    }

    /// Why the last host was disconnected, once; `None` if it disconnected by itself.
    pub fn reason(&mut self) -> Option<TcpError> {
        self.reason.take()
    }

    /// One control period. Returns whether a host has disconnected that had sent anything: one that has not only looked
    /// whether the controller is there. The host of this process counts always.
    ///
    /// # Errors
    /// The cell fails, or the listener fails.
    pub fn turn(&mut self, cell: &mut LocalDevice) -> Result<bool, LinkError> {
        if self.host.is_none() {
            match self.listener.accept() {
                Ok((stream, address)) => self.host = Host::handshake(cell, stream, address, self.silent).ok(),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(e) => return Err(TcpError::of("the host link", e).into()),
            }
        }
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
        let spoke = self.host.take().is_some_and(|host| host.spoke);
        self.reason = Some(reason).filter(|reason| !reason.is_closed());
        Ok(spoke || self.silent.is_none())
    }
}

/// The drive's hello, framed for the host.
fn hello_frame(cell: &LocalDevice) -> std::io::Result<Vec<u8>> {
    let mut bytes = vec![0; MAX_FRAME];
    let length = frame::encode(cell.hello(), 0, cell.now_us(), &mut bytes).map_err(std::io::Error::other)?;
    bytes.truncate(length);
    Ok(bytes)
}

/// A host in lock-step: its bytes, one period, the controller's bytes; repeated until it leaves.
struct TurnHost {
    stream: TcpStream,
    peer: String,
    silent: Option<Duration>,
    turns: Turns,
    watch: FrameWatch,
    /// When the last turn was complete, or else the last byte came.
    heard: Instant,
    /// Since when a turn has been incomplete.
    begun: Option<Instant>,
    /// Whether a byte came from it.
    spoke: bool,
}

/// How a host in lock-step left.
#[derive(Default)]
struct Left {
    /// Why it was disconnected; `None` if it disconnected.
    reason: Option<TcpError>,
    /// Another host, to which it gave way.
    next: Option<(TcpStream, SocketAddr)>,
}

impl From<TcpError> for Left {
    fn from(reason: TcpError) -> Self {
        Self {
            reason: (!reason.is_closed()).then_some(reason),
            next: None,
        }
    }
}

impl TurnHost {
    fn new(stream: TcpStream, address: SocketAddr, silent: Option<Duration>) -> Self {
        Self {
            stream,
            peer: format!("the host at {address}"),
            silent,
            turns: Turns::default(),
            watch: FrameWatch::default(),
            heard: Instant::now(),
            begun: None,
            spoke: false,
        }
    }

    fn serve(&mut self, cell: &mut LocalDevice, listener: &TcpListener) -> Result<Left, LinkError> {
        let sent = self
            .stream
            .set_nonblocking(false)
            .and_then(|()| self.stream.set_nodelay(true))
            .and_then(|()| self.stream.set_write_timeout(Some(READ)))
            .and_then(|()| self.stream.set_read_timeout(Some(LOOK)))
            .and_then(|()| self.stream.write_all(&hello_frame(cell)?));
        if let Err(error) = sent {
            return Ok(self.broken(error).into());
        }
        let (mut up, mut buffer) = (Vec::new(), vec![0; 4 * MAX_FRAME]);
        loop {
            while let Some(down) = self.turns.next() {
                self.watch.look(down);
                if let Err(reason) = self.watch.progress.check(&self.peer) {
                    return Ok(reason.into());
                }
                up.clear();
                cell.step(down, &mut up)?;
                up.push(0);
                if let Err(error) = self.stream.write_all(&up) {
                    return Ok(self.broken(error).into());
                }
                // The drive may have taken any time.
                (self.heard, self.begun) = (Instant::now(), None);
            }
            match self.read(&mut buffer) {
                Ok(true) => {}
                Ok(false) => {
                    let waits = self.silent.is_some_and(|most| self.heard.elapsed() >= most);
                    if let Some(next) = waits.then(|| listener.accept().ok()).flatten() {
                        return Ok(Left {
                            reason: Some(TcpError::Gone {
                                peer: self.peer.clone(),
                                what: "it gives way to another host",
                                seconds: self.heard.elapsed().as_secs(),
                            }),
                            next: Some(next),
                        });
                    }
                }
                Err(reason) => return Ok(reason.into()),
            }
        }
    }

    /// Reads what comes next; whether anything came.
    fn read(&mut self, buffer: &mut [u8]) -> Result<bool, TcpError> {
        let came = match self.stream.read(buffer) {
            Ok(0) => {
                return Err(TcpError::Closed {
                    peer: self.peer.clone(),
                });
            }
            Ok(count) => {
                self.turns.push(buffer.get(..count).unwrap_or_default());
                self.spoke = true;
                self.turns.check(&self.peer)?;
                self.heard = Instant::now();
                true
            }
            Err(e) if matches!(e.kind(), ErrorKind::Interrupted) => true,
            Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => false,
            Err(e) => return Err(TcpError::of(&self.peer, e)),
        };
        if self.turns.waiting() > 0 {
            let begun = *self.begun.get_or_insert_with(Instant::now);
            if begun.elapsed() >= NO_FRAME {
                return Err(TcpError::Endless {
                    peer: self.peer.clone(),
                    bytes: self.turns.waiting(),
                });
            }
        }
        Ok(came)
    }

    fn broken(&self, error: std::io::Error) -> TcpError {
        broken(&self.peer, error)
    }
}

/// A write that failed.
fn broken(peer: &str, error: std::io::Error) -> TcpError {
    if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
        return TcpError::Deaf {
            peer: peer.to_owned(),
            seconds: READ.as_secs(),
        };
    }
    TcpError::of(peer, error)
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
    /// Whether a byte came from it.
    spoke: bool,
}

impl Host {
    fn handshake(
        cell: &LocalDevice,
        mut stream: TcpStream,
        address: SocketAddr,
        silent: Option<Duration>,
    ) -> std::io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(Duration::from_millis(1)))?;
        stream.write_all(&hello_frame(cell)?)?;
        stream.set_nonblocking(true)?;
        Ok(Self {
            stream,
            backlog: Vec::with_capacity(BACKLOG + UP + 1),
            peer: format!("the host at {address}"),
            silent,
            watch: FrameWatch::default(),
            heard: Instant::now(),
            stuck: None,
            spoke: false,
        })
    }

    fn read(&mut self, down: &mut Vec<u8>) -> Result<(), TcpError> {
        let mut buffer = [0; MAX_FRAME];
        while down.len() < DOWN {
            match self.stream.read(&mut buffer) {
                Ok(0) => {
                    return Err(TcpError::Closed {
                        peer: self.peer.clone(),
                    });
                }
                Ok(count) => {
                    self.spoke = true;
                    down.extend_from_slice(buffer.get(..count).unwrap_or_default());
                }
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(TcpError::of(&self.peer, e)),
            }
        }
        if self.watch.look(down) {
            self.heard = Instant::now();
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
        if hangs || self.backlog.len() > BACKLOG {
            return Err(TcpError::Deaf {
                peer: self.peer.clone(),
                seconds: stuck.as_secs(),
            });
        }
        Ok(())
    }
}
