//! A connection whose frames are kept as they came.

pub(super) use spherecal_budget::HANDSHAKE as OWED;
use std::collections::VecDeque;
use std::io::{ErrorKind, Read as _, Write as _};
use std::net::{TcpStream, ToSocketAddrs as _};
use std::time::{Duration, Instant};

use spherecal_shared::protocol::frame::{self, Accumulator, Header, MAX_FRAME, Message};

/// How long a peer may take to close a connection: 5 s without a valid frame, and what a busy machine adds.
pub(super) const CLOSES: Duration = Duration::from_secs(8);
/// How long nothing may come where nothing is owed.
pub(super) const QUIET: Duration = Duration::from_millis(300);
/// Most bytes that are printed.
const SHOWN: usize = 96;

/// A whole frame.
#[derive(Clone, Debug)]
pub(super) struct Came {
    pub(super) header: Header,
    body: Vec<u8>,
}

impl Came {
    pub(super) fn read<M: Message>(&self) -> Option<M> {
        (self.header.key == M::KEY).then(|| postcard::from_bytes(&self.body).ok())?
    }

    /// Key and body, as they are printed.
    pub(super) fn words(&self) -> String {
        format!("key {}, body {}", hex(&self.header.key), hex(&self.body))
    }
}

/// Bytes as they are printed: hexadecimal, at most [`SHOWN`] of them.
pub(super) fn hex(bytes: &[u8]) -> String {
    let shown: String = bytes.iter().take(SHOWN).map(|byte| format!("{byte:02x}")).collect();
    match bytes.len() {
        count if count > SHOWN => format!("{shown}... ({count} bytes)"),
        _ => shown,
    }
}

pub(super) fn framed<M: Message>(message: &M, sequence: u32) -> Result<Vec<u8>, String> {
    let mut out = vec![0; MAX_FRAME];
    let length = frame::encode(message, sequence, 0, &mut out).map_err(|error| error.to_string())?;
    out.truncate(length);
    Ok(out)
}

/// A frame that is damaged in its middle, but not by a zero, which would end it.
pub(super) fn damaged(mut frame: Vec<u8>) -> Vec<u8> {
    let middle = frame.len() / 2;
    if let Some(byte) = frame.get_mut(middle) {
        *byte ^= if *byte == 0x10 { 0x20 } else { 0x10 };
    }
    frame
}

/// One connection to a peer.
pub(super) struct Probe {
    stream: TcpStream,
    accumulator: Accumulator,
    came: VecDeque<Came>,
    /// Bytes that were not yet looked at for end marks.
    pub(super) raw: Vec<u8>,
    sent: u32,
    closed: bool,
}

impl Probe {
    pub(super) fn connect(address: &str) -> Result<Self, String> {
        let failed = |error: std::io::Error| format!("tcp:{address} cannot be reached: {error}");
        let mut last = ErrorKind::AddrNotAvailable.into();
        for candidate in address.to_socket_addrs().map_err(failed)? {
            match TcpStream::connect_timeout(&candidate, OWED) {
                Ok(stream) => {
                    stream.set_nodelay(true).map_err(failed)?;
                    stream.set_write_timeout(Some(OWED)).map_err(failed)?;
                    return Ok(Self {
                        stream,
                        accumulator: Accumulator::new(),
                        came: VecDeque::new(),
                        raw: Vec::new(),
                        sent: 0,
                        closed: false,
                    });
                }
                Err(error) => last = error,
            }
        }
        Err(failed(last))
    }

    /// Sends a message; the error is that the connection is closed.
    pub(super) fn send<M: Message>(&mut self, message: &M) -> Result<(), String> {
        let bytes = framed(message, self.sent)?;
        self.sent = self.sent.wrapping_add(1);
        self.write(&bytes)
    }

    pub(super) fn write(&mut self, bytes: &[u8]) -> Result<(), String> {
        self.stream.write_all(bytes).map_err(|error| {
            self.closed = true;
            format!("the connection is closed: {error}")
        })
    }

    /// Reads what comes within this time, at least once.
    pub(super) fn read(&mut self, most: Duration) {
        let mut buffer = [0; MAX_FRAME];
        let limit = most.max(Duration::from_millis(1));
        if self.closed || self.stream.set_read_timeout(Some(limit)).is_err() {
            return;
        }
        match self.stream.read(&mut buffer) {
            Ok(count) if count > 0 => {
                let bytes = buffer.get(..count).unwrap_or_default();
                self.raw.extend_from_slice(bytes);
                for byte in bytes {
                    let came = &mut self.came;
                    self.accumulator.push(*byte, &mut |frame| {
                        if let Ok((header, body)) = frame.and_then(frame::open) {
                            let body = body.to_vec();
                            came.push_back(Came { header, body });
                        }
                    });
                }
            }
            Err(e)
                if matches!(
                    e.kind(),
                    ErrorKind::WouldBlock | ErrorKind::TimedOut | ErrorKind::Interrupted
                ) => {}
            _ => self.closed = true,
        }
    }

    /// The next frame; `None` if none comes in time, or if the connection is closed.
    pub(super) fn next(&mut self, most: Duration) -> Option<Came> {
        let begun = Instant::now();
        loop {
            if let Some(came) = self.came.pop_front() {
                return Some(came);
            }
            let left = most.checked_sub(begun.elapsed()).filter(|_| !self.closed)?;
            self.read(left);
        }
    }

    /// The next frame, which must be a message of this type.
    pub(super) fn expect<M: Message>(&mut self, what: &str) -> Result<M, String> {
        match self.next(OWED) {
            Some(came) => came
                .read::<M>()
                .ok_or_else(|| format!("{} in the place of {what}", came.words())),
            None if self.closed => Err(format!("the connection was closed in the place of {what}")),
            None => Err(format!("nothing within {} s in the place of {what}", OWED.as_secs())),
        }
    }

    /// Fails if the peer does not close the connection, whatever else it sends.
    pub(super) fn expect_close(&mut self) -> Result<(), String> {
        let begun = Instant::now();
        while begun.elapsed() < CLOSES {
            self.came.clear();
            self.raw.clear();
            self.read(CLOSES.saturating_sub(begun.elapsed()));
            if self.closed {
                return Ok(());
            }
        }
        Err(format!("the connection is open after {:.0} s", CLOSES.as_secs_f64()))
    }

    /// Sends these bytes so many times. Fails if the peer does not close the connection.
    pub(super) fn expect_close_after(&mut self, bytes: &[u8], times: usize) -> Result<(), String> {
        // The writes fail when the other side has closed.
        if (0..times).any(|_| self.write(bytes).is_err()) {
            return Ok(());
        }
        self.expect_close()
    }

    /// Sends 1 MiB without a valid frame. Fails if the peer does not close the connection.
    pub(super) fn expect_close_after_noise(&mut self) -> Result<(), String> {
        self.expect_close_after(&[0x41; 1 << 12], (1 << 8) + 1)
    }
}
