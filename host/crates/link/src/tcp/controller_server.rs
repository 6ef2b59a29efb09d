//! A controller as a process: a cell on one side, hosts that come and go on the other.
//!
//! When a host connects, the server first sends the drive's hello frame, so that the host can check
//! joints, limits and period. After that the connection carries the bytes of the host link. Each
//! side ends its part of every period with an end mark (a zero byte with no frame before it).

use std::io::{ErrorKind, Read, Write};
use std::net::{TcpListener, TcpStream};
use std::time::Duration;

use spherecal_shared::protocol::frame::{self, MAX_FRAME};

use super::TcpError;
use crate::{Device, LinkError, LocalDevice};

/// Bytes that may wait for a host in real time. A host that falls behind further is disconnected.
const BACKLOG: usize = 1 << 20;
/// Bytes of a host that the controller takes in one period; further bytes wait.
const DOWN: usize = 4 * MAX_FRAME;
/// Bytes that the controller sends in one period, with room to spare.
const UP: usize = 16 * MAX_FRAME;

/// Splits a byte stream into turns.
#[derive(Debug, Default)]
pub(super) struct Turns {
    bytes: Vec<u8>,
    /// Bytes of the present turn that were looked at.
    at: usize,
    /// Bytes of the last turn, to be removed before the next.
    spent: usize,
}

impl Turns {
    /// Adds what was received.
    pub(super) fn push(&mut self, bytes: &[u8]) {
        self.bytes.extend_from_slice(bytes);
    }

    /// The next whole turn, without its end.
    pub(super) fn next(&mut self) -> Option<&[u8]> {
        if self.spent > 0 {
            self.bytes.drain(..self.spent);
            self.spent = 0;
            self.at = 0;
        }
        while let Some(byte) = self.bytes.get(self.at) {
            let ends = *byte == 0 && (self.at == 0 || self.bytes.get(self.at - 1) == Some(&0));
            self.at += 1;
            if ends {
                self.spent = self.at;
                return self.bytes.get(..self.at - 1);
            }
        }
        None
    }
}

/// Serves one host after the other; with `once` it returns when the first has disconnected.
///
/// In lock-step nothing moves while no host is connected. In real time the controller keeps running
/// every tick and holds the arm.
///
/// # Errors
/// The cell fails, or the listener fails. A host that disconnects is not an error.
pub fn serve_hosts(cell: &mut LocalDevice, listener: &TcpListener, once: bool) -> Result<(), LinkError> {
    if cell.hello().lock_step {
        loop {
            let (stream, _) = listener.accept().map_err(|e| TcpError::of("the host link", e))?;
            turn_by_turn(cell, stream)?;
            if once {
                return Ok(());
            }
        }
    }
    let mut service = HostService::new(listener)?;
    while !(service.turn(cell)? && once) {}
    Ok(())
}

/// Serves one host after the other in real time, one control period at a time. While no host is connected, and whatever
/// a host does, each period is carried out. Apart from a host that connects, a period allocates nothing here.
pub struct HostService<'a> {
    listener: &'a TcpListener,
    host: Option<Host>,
    down: Vec<u8>,
    up: Vec<u8>,
}

impl<'a> HostService<'a> {
    /// No host is connected yet.
    ///
    /// # Errors
    /// The listener fails.
    pub fn new(listener: &'a TcpListener) -> Result<Self, LinkError> {
        listener
            .set_nonblocking(true)
            .map_err(|e| TcpError::of("the host link", e))?;
        Ok(Self {
            listener,
            host: None,
            down: Vec::with_capacity(DOWN + MAX_FRAME),
            up: Vec::with_capacity(UP),
        })
    }

    /// One control period. Returns whether a host has disconnected.
    ///
    /// # Errors
    /// The cell fails, or the listener fails.
    pub fn turn(&mut self, cell: &mut LocalDevice) -> Result<bool, LinkError> {
        if self.host.is_none() {
            match self.listener.accept() {
                Ok((stream, _)) => self.host = Host::handshake(cell, stream).ok(),
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::Interrupted) => {}
                Err(e) => return Err(TcpError::of("the host link", e).into()),
            }
        }
        self.down.clear();
        self.up.clear();
        let mut left = self
            .host
            .as_mut()
            .is_some_and(|host| host.read(&mut self.down).is_err());
        cell.step(&self.down, &mut self.up)?;
        if let Some(host) = &mut self.host {
            left |= host.write(&self.up).is_err();
        }
        if left {
            self.host = None;
        }
        Ok(left)
    }
}

/// The drive's hello, framed for the host.
fn hello_frame(cell: &LocalDevice) -> std::io::Result<Vec<u8>> {
    let mut bytes = vec![0; MAX_FRAME];
    let length = frame::encode(cell.hello(), 0, cell.now_us(), &mut bytes).map_err(std::io::Error::other)?;
    bytes.truncate(length);
    Ok(bytes)
}

/// Lock-step: the host's bytes, one period, the controller's bytes; repeated until the host
/// disconnects.
fn turn_by_turn(cell: &mut LocalDevice, mut stream: TcpStream) -> Result<(), LinkError> {
    let sent = stream
        .set_nonblocking(false)
        .and_then(|()| stream.set_nodelay(true))
        .and_then(|()| stream.write_all(&hello_frame(cell)?));
    if sent.is_err() {
        return Ok(());
    }
    let (mut turns, mut up, mut buffer) = (Turns::default(), Vec::new(), vec![0; 4 * MAX_FRAME]);
    loop {
        while let Some(down) = turns.next() {
            up.clear();
            cell.step(down, &mut up)?;
            up.push(0);
            if stream.write_all(&up).is_err() {
                return Ok(());
            }
        }
        match stream.read(&mut buffer) {
            Ok(0) => return Ok(()),
            Ok(count) => turns.push(buffer.get(..count).unwrap_or_default()),
            Err(e) if e.kind() == ErrorKind::Interrupted => {}
            Err(_) => return Ok(()),
        }
    }
}

/// A host in real time. Nothing waits for it.
struct Host {
    stream: TcpStream,
    backlog: Vec<u8>,
}

impl Host {
    fn handshake(cell: &LocalDevice, mut stream: TcpStream) -> std::io::Result<Self> {
        stream.set_nonblocking(false)?;
        stream.set_nodelay(true)?;
        stream.set_write_timeout(Some(Duration::from_millis(1)))?;
        stream.write_all(&hello_frame(cell)?)?;
        stream.set_nonblocking(true)?;
        Ok(Self {
            stream,
            backlog: Vec::with_capacity(BACKLOG + UP + 1),
        })
    }

    fn read(&mut self, down: &mut Vec<u8>) -> std::io::Result<()> {
        let mut buffer = [0; MAX_FRAME];
        while down.len() < DOWN {
            match self.stream.read(&mut buffer) {
                Ok(0) => {
                    return Err(ErrorKind::BrokenPipe.into());
                }
                Ok(count) => down.extend_from_slice(buffer.get(..count).unwrap_or_default()),
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        Ok(())
    }

    fn write(&mut self, up: &[u8]) -> std::io::Result<()> {
        self.backlog.extend_from_slice(up);
        self.backlog.push(0);
        while !self.backlog.is_empty() {
            match self.stream.write(&self.backlog) {
                Ok(0) => {
                    return Err(ErrorKind::BrokenPipe.into());
                }
                Ok(count) => drop(self.backlog.drain(..count)),
                Err(e) if e.kind() == ErrorKind::WouldBlock => break,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) => return Err(e),
            }
        }
        if self.backlog.len() > BACKLOG {
            return Err(ErrorKind::BrokenPipe.into());
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::Turns;

    // Fails if a period's bytes are cut, merged or kept back, however the stream is cut.
    #[test]
    fn turns_come_out_whole_however_the_bytes_are_cut() {
        let bytes = [5, 6, 0, 7, 0, 0, 0, 8, 0, 0, 9];
        for size in 1..=bytes.len() {
            let (mut turns, mut seen) = (Turns::default(), Vec::new());
            for chunk in bytes.chunks(size) {
                turns.push(chunk);
                while let Some(turn) = turns.next() {
                    seen.push(turn.to_vec());
                }
            }
            assert_eq!(seen, [vec![5, 6, 0, 7, 0], vec![], vec![8, 0]], "in chunks of {size}");
        }
    }
}
