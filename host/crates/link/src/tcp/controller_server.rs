//! A controller as a process: a cell on one side, hosts that come and go on the other.
//!
//! When a host connects, the server first sends the drive's hello frame, so that the host can check
//! joints, limits and period. After that the connection carries the bytes of the host link. Each
//! side ends its part of every period with an end mark (a zero byte with no frame before it).
//!
//! A host earns its place by a valid frame; hosts that connect meanwhile are greeted, and the first of them that sends one
//! takes the place of a host that has not. A host that sends bytes and no valid frame for 5 s, a turn without end, or a
//! turn in parts for 5 s is disconnected; end marks alone are no valid frame. In real time so is one that sends no valid
//! frame for 5 s, or that does not read. In lock-step a host that has earned its place may be silent, because nothing
//! moves; after 5 s it gives way to another one that sends a frame.

use std::io::{ErrorKind, Write as _};
use std::net::{TcpListener, TcpStream};
use std::time::{Duration, Instant};

use spherecal_shared::protocol::frame::{MAX_FRAME, Message as _};
use spherecal_shared::protocol::host::Downlink;

use super::TcpError;
use super::lobby::{Candidate, Lobby, Look};
use super::progress::FrameWatch;
use super::real_time_hosts::{WHO, gives_way, hello_frame};
use super::stream::read_some;
use super::turns::Turns;
use crate::{Device, LinkError, LocalDevice};
use spherecal_budget::link::{NO_FRAME, READ, SILENT};

pub use super::real_time_hosts::HostService;

/// How often a silent host in lock-step is looked after, once it has earned its place.
const LOOK: Duration = Duration::from_millis(250);
/// How often those who wait are looked after while no host has earned the place.
const IDLE: Duration = Duration::from_millis(5);

/// Serves one host after the other; with `once` it returns when the first that got the place has disconnected. `told`
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
    if cell.hello().lock_step {
        let mut lobby = Lobby::new(WHO, Some(Downlink::KEY));
        let mut next = None;
        loop {
            let candidate = match next.take() {
                Some(candidate) => candidate,
                None if silent.is_none() => own_host(cell, listener)?,
                None => speaking_host(cell, &mut lobby, listener, told)?,
            };
            let mut host = TurnHost::new(candidate, silent);
            let left = host.serve(cell, &mut lobby, listener)?;
            next = left.next;
            if let Some(reason) = left.reason {
                told(&reason);
            }
            // One that gave way to another was not the one.
            if once && next.is_none() {
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

/// The host of this process, which is greeted and may say nothing.
fn own_host(cell: &LocalDevice, listener: &TcpListener) -> Result<Candidate, LinkError> {
    let failed = |e| TcpError::of(WHO, e);
    listener.set_nonblocking(false).map_err(failed)?;
    let (mut stream, address) = listener.accept().map_err(failed)?;
    stream.set_nodelay(true).map_err(failed)?;
    stream.write_all(&hello_frame(cell)?).map_err(failed)?;
    Ok(Candidate::new(stream, address, Some(Downlink::KEY)))
}

/// Waits for a host that sends something: a valid frame, or else anything.
fn speaking_host(
    cell: &LocalDevice,
    lobby: &mut Lobby,
    listener: &TcpListener,
    told: &mut dyn FnMut(&TcpError),
) -> Result<Candidate, LinkError> {
    let greeting = hello_frame(cell)?;
    loop {
        match lobby.look(listener, &greeting)? {
            Look::Spoke(candidate) => return Ok(candidate),
            Look::Left(Some(reason)) => told(&reason),
            Look::Left(None) => {}
            Look::Nothing => match lobby.first_that_sent() {
                Some(candidate) => return Ok(candidate),
                None => std::thread::sleep(IDLE),
            },
        }
    }
}

/// A host in lock-step: its bytes, one period, the controller's bytes; repeated until it leaves.
struct TurnHost {
    stream: TcpStream,
    peer: String,
    silent: Option<Duration>,
    turns: Turns,
    watch: FrameWatch,
    /// When the last valid frame came.
    heard: Instant,
    /// Since when a turn has been incomplete.
    begun: Option<Instant>,
    /// Whether a valid frame came from it.
    proven: bool,
}

/// How a host in lock-step left.
#[derive(Default)]
struct Left {
    /// Why it was disconnected; `None` if it disconnected.
    reason: Option<TcpError>,
    /// Another host, to which it gave way.
    next: Option<Candidate>,
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
    fn new(candidate: Candidate, silent: Option<Duration>) -> Self {
        let mut turns = Turns::default();
        turns.push(&candidate.bytes);
        Self {
            stream: candidate.stream,
            peer: format!("{WHO} at {}", candidate.address),
            silent,
            turns,
            watch: FrameWatch::of::<Downlink>(),
            heard: Instant::now(),
            begun: None,
            proven: silent.is_none(),
        }
    }

    fn serve(&mut self, cell: &mut LocalDevice, lobby: &mut Lobby, listener: &TcpListener) -> Result<Left, LinkError> {
        let set = self
            .stream
            .set_nonblocking(false)
            .and_then(|()| self.stream.set_write_timeout(Some(READ)))
            .and_then(|()| {
                self.stream
                    .set_read_timeout(Some(if self.proven { LOOK } else { IDLE }))
            });
        if let Err(error) = set {
            return Ok(self.broken(error).into());
        }
        let greeting = hello_frame(cell)?;
        let (mut up, mut buffer) = (Vec::new(), vec![0; 4 * MAX_FRAME]);
        loop {
            while let Some(down) = self.turns.next() {
                if self.watch.look(down) {
                    self.heard = Instant::now();
                    if !std::mem::replace(&mut self.proven, true)
                        && let Err(error) = self.stream.set_read_timeout(Some(LOOK))
                    {
                        return Ok(self.broken(error).into());
                    }
                }
                if let Err(reason) = self.watch.progress.check(&self.peer) {
                    return Ok(reason.into());
                }
                up.clear();
                cell.step(down, &mut up)?;
                up.push(0);
                if let Err(error) = self.stream.write_all(&up) {
                    return Ok(self.broken(error).into());
                }
                self.begun = None;
            }
            if let Some(left) = self.gives_way(lobby, listener, &greeting)? {
                return Ok(left);
            }
            if let Err(reason) = self.read(&mut buffer) {
                return Ok(reason.into());
            }
        }
    }

    /// Whether it gives way to another host, or to nobody: one that has sent no valid frame earns no place.
    fn gives_way(&self, lobby: &mut Lobby, listener: &TcpListener, greeting: &[u8]) -> Result<Option<Left>, LinkError> {
        let Some(most) = self.silent else { return Ok(None) };
        let is_silent = self.heard.elapsed() >= most;
        if self.proven && !is_silent {
            return Ok(None);
        }
        if let Look::Spoke(next) = lobby.look(listener, greeting)? {
            return Ok(Some(Left {
                reason: Some(gives_way(&self.peer, self.heard)),
                next: Some(next),
            }));
        }
        Ok((!self.proven && is_silent).then(|| {
            TcpError::Gone {
                peer: self.peer.clone(),
                what: "a host earns its place by a valid frame",
                seconds: self.heard.elapsed().as_secs(),
            }
            .into()
        }))
    }

    /// Reads what comes next, for a while.
    fn read(&mut self, buffer: &mut [u8]) -> Result<(), TcpError> {
        let count = read_some(&mut self.stream, buffer).map_err(|e| TcpError::of(&self.peer, e))?;
        self.turns.push(buffer.get(..count).unwrap_or_default());
        self.turns.check(&self.peer)?;
        if self.turns.waiting() > 0 {
            let begun = *self.begun.get_or_insert_with(Instant::now);
            if begun.elapsed() >= NO_FRAME {
                return Err(TcpError::Endless {
                    peer: self.peer.clone(),
                    bytes: self.turns.waiting(),
                });
            }
        }
        Ok(())
    }

    /// The error of a write that failed.
    fn broken(&self, error: std::io::Error) -> TcpError {
        if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) {
            return TcpError::Deaf {
                peer: self.peer.clone(),
                seconds: READ.as_secs(),
            };
        }
        TcpError::of(&self.peer, error)
    }
}
