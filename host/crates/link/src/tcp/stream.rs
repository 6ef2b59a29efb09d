//! What frames travel on: a TCP connection, a serial port, or datagrams.

use std::io::{ErrorKind, Read, Result, Write};
use std::net::TcpStream;
use std::time::Duration;

use serial2::SerialPort;

use super::datagrams::Datagrams;

/// The longest time that a serial port waits: it cannot wait for ever.
const FOR_EVER: Duration = Duration::from_hours(24);

/// Reads what has come within the time limit: how many bytes, 0 if none. A closed connection is the error `UnexpectedEof`.
pub(super) fn read_some(stream: &mut impl Read, buffer: &mut [u8]) -> Result<usize> {
    match stream.read(buffer) {
        Ok(0) => Err(ErrorKind::UnexpectedEof.into()),
        Err(error)
            if matches!(
                error.kind(),
                ErrorKind::Interrupted | ErrorKind::WouldBlock | ErrorKind::TimedOut
            ) =>
        {
            Ok(0)
        }
        other => other,
    }
}

/// A stream of bytes both ways.
pub(super) enum Stream {
    Tcp(TcpStream),
    Serial(SerialPort),
    Udp(Datagrams),
}

impl Stream {
    /// Reads and writes wait at most this long; `None` waits for ever.
    pub(super) fn wait(&mut self, read: Option<Duration>, write: Duration) -> Result<()> {
        match self {
            Self::Tcp(stream) => {
                stream.set_nonblocking(false)?;
                stream.set_read_timeout(read)?;
                stream.set_write_timeout(Some(write))
            }
            Self::Serial(port) => {
                port.set_read_timeout(read.unwrap_or(FOR_EVER))?;
                port.set_write_timeout(write)
            }
            Self::Udp(datagrams) => {
                let socket = datagrams.socket();
                socket.set_nonblocking(false)?;
                socket.set_read_timeout(read)?;
                socket.set_write_timeout(Some(write))
            }
        }
    }

    /// Neither reads nor writes wait.
    pub(super) fn never_wait(&mut self) -> Result<()> {
        match self {
            Self::Tcp(stream) => stream.set_nonblocking(true),
            Self::Serial(port) => {
                port.set_read_timeout(Duration::ZERO)?;
                port.set_write_timeout(Duration::ZERO)
            }
            Self::Udp(datagrams) => datagrams.socket().set_nonblocking(true),
        }
    }

    /// A valid frame came. Over UDP its sender has earned the place.
    pub(super) fn heard(&mut self) {
        if let Self::Udp(datagrams) = self {
            datagrams.heard();
        }
    }

    /// The next reads wait at most this long.
    pub(super) fn wait_for_reads(&mut self, read: Option<Duration>) -> Result<()> {
        match self {
            Self::Tcp(stream) => stream.set_read_timeout(read),
            Self::Serial(port) => port.set_read_timeout(read.unwrap_or(FOR_EVER)),
            Self::Udp(datagrams) => datagrams.socket().set_read_timeout(read),
        }
    }
}

impl Read for Stream {
    fn read(&mut self, buffer: &mut [u8]) -> Result<usize> {
        match self {
            Self::Tcp(stream) => stream.read(buffer),
            Self::Serial(port) => port.read(buffer),
            Self::Udp(datagrams) => datagrams.receive(buffer),
        }
    }
}

impl Write for Stream {
    fn write(&mut self, bytes: &[u8]) -> Result<usize> {
        match self {
            Self::Tcp(stream) => stream.write(bytes),
            Self::Serial(port) => port.write(bytes),
            Self::Udp(datagrams) => datagrams.send(bytes),
        }
    }

    fn flush(&mut self) -> Result<()> {
        match self {
            Self::Tcp(stream) => stream.flush(),
            Self::Serial(port) => port.flush(),
            Self::Udp(_) => Ok(()),
        }
    }
}
