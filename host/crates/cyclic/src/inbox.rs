//! The client's wait for the newest datagram. It allocates nothing.

use std::io::{Error, ErrorKind};
use std::net::{SocketAddr, UdpSocket};
use std::time::{Duration, Instant};

/// A system call for a socket failed.
#[derive(Debug, thiserror::Error)]
#[error("cannot {action}: {source}")]
pub struct SocketError {
    /// What was tried.
    pub action: &'static str,
    /// What the system said.
    pub source: Error,
}

/// Wraps what the system says, for `map_err`.
pub fn io_error(action: &'static str) -> impl Fn(Error) -> SocketError {
    move |source| SocketError { action, source }
}

/// A UDP socket with a buffer of `N` bytes, of which the newest datagrams are taken.
///
/// Choose `N` one larger than the largest message: a longer datagram then shows by its length.
#[derive(Debug)]
pub struct Inbox<const N: usize> {
    socket: UdpSocket,
    buffer: [u8; N],
    timeout: Duration,
    spin: Duration,
}

/// One wait of an [`Inbox`].
#[derive(Debug)]
pub struct Wait {
    start: Instant,
    blocking: bool,
}

impl Wait {
    /// How long it has taken so far.
    pub fn elapsed(&self) -> Duration {
        self.start.elapsed()
    }
}

impl<const N: usize> Inbox<N> {
    /// Takes the socket over. A wait ends after `timeout`; before it sleeps, it polls the socket for `spin`.
    ///
    /// # Errors
    /// If the system refuses the timeout or `SO_BUSY_POLL` (`busy_poll_us` microseconds; Linux only).
    pub fn new(
        socket: UdpSocket,
        timeout: Duration,
        spin: Duration,
        busy_poll_us: Option<u32>,
    ) -> Result<Self, SocketError> {
        socket
            .set_read_timeout(Some(timeout.max(Duration::from_micros(1))))
            .map_err(io_error("set a timeout"))?;
        if let Some(us) = busy_poll_us {
            busy_poll(&socket, us)?;
        }
        Ok(Self {
            socket,
            buffer: [0; N],
            timeout,
            spin,
        })
    }

    /// The socket's own address.
    ///
    /// # Errors
    /// What the system says.
    pub fn address(&self) -> Result<SocketAddr, SocketError> {
        self.socket.local_addr().map_err(io_error("read the port"))
    }

    /// The first `size` bytes of the buffer: the last datagram.
    pub fn bytes(&self, size: usize) -> &[u8] {
        self.buffer.get(..size).unwrap_or(&self.buffer)
    }

    /// Sends a datagram from this socket.
    ///
    /// # Errors
    /// What the system says.
    pub fn send(&self, bytes: &[u8], to: SocketAddr) -> Result<(), SocketError> {
        let sent = self.socket.send_to(bytes, to);
        sent.map(|_| ()).map_err(io_error("send a command"))
    }

    /// Begins a wait.
    ///
    /// # Errors
    /// What the system says.
    pub fn wait(&self) -> Result<Wait, SocketError> {
        self.set_blocking(false)?;
        Ok(Wait {
            start: Instant::now(),
            blocking: false,
        })
    }

    /// The next datagram: its size and sender. `taken` says whether one of this wait was of use.
    ///
    /// `None` ends the wait: after a useful datagram when no other has come, else when the time is over. First
    /// everything is taken that has come already, then the thread polls, then it sleeps.
    ///
    /// # Errors
    /// What the system says.
    pub fn next(&mut self, wait: &mut Wait, taken: bool) -> Result<Option<(usize, SocketAddr)>, SocketError> {
        if wait.blocking && taken {
            return Ok(None);
        }
        loop {
            // Old or foreign datagrams must not keep the client waiting for ever.
            if !taken && wait.elapsed() > self.timeout {
                return Ok(None);
            }
            match self.socket.recv_from(&mut self.buffer) {
                Ok(received) => return Ok(Some(received)),
                Err(error) if error.kind() == ErrorKind::WouldBlock && !wait.blocking => {
                    if taken {
                        return Ok(None);
                    }
                    if wait.elapsed() >= self.spin {
                        self.set_blocking(true)?;
                        wait.blocking = true;
                    } else {
                        std::hint::spin_loop();
                    }
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Ok(None),
                Err(error) if works_on(&error) => {}
                Err(error) => return Err(io_error("receive a state")(error)),
            }
        }
    }

    fn set_blocking(&self, blocking: bool) -> Result<(), SocketError> {
        self.socket
            .set_nonblocking(!blocking)
            .map_err(io_error("use the UDP port"))
    }
}

/// Errors of a UDP socket after which it works on: a signal, or an answer that met a closed port.
fn works_on(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset
    )
}

#[cfg(target_os = "linux")]
fn busy_poll(socket: &UdpSocket, us: u32) -> Result<(), SocketError> {
    socket2::SockRef::from(socket)
        .set_busy_poll(us)
        .map_err(io_error("set SO_BUSY_POLL; it may need the right CAP_NET_ADMIN"))
}

#[cfg(not(target_os = "linux"))]
fn busy_poll(_socket: &UdpSocket, _us: u32) -> Result<(), SocketError> {
    Err(io_error("set SO_BUSY_POLL")(Error::from(ErrorKind::Unsupported)))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn pair(timeout: Duration) -> (Inbox<8>, UdpSocket, SocketAddr) {
        let inbox = UdpSocket::bind("127.0.0.1:0").expect("a port");
        let to = inbox.local_addr().expect("an address");
        let inbox = Inbox::new(inbox, timeout, Duration::ZERO, None).expect("an inbox");
        (inbox, UdpSocket::bind("127.0.0.1:0").expect("a port"), to)
    }

    // Fails if a wait hands out less than everything that has come, or waits for more after a useful datagram.
    #[test]
    fn everything_that_has_come_is_taken() {
        let (mut inbox, sender, to) = pair(Duration::from_secs(10));
        for number in 0..3 {
            sender.send_to(&[number], to).expect("sent");
        }
        std::thread::sleep(Duration::from_millis(20));
        let mut wait = inbox.wait().expect("a wait");
        let mut seen = Vec::new();
        while let Some((size, _)) = inbox.next(&mut wait, !seen.is_empty()).expect("a datagram") {
            seen.extend_from_slice(inbox.bytes(size));
        }
        assert_eq!(seen, [0, 1, 2]);
    }

    // Fails if datagrams that are of no use make a wait longer than its time.
    #[test]
    fn useless_datagrams_do_not_prolong_a_wait() {
        let (mut inbox, sender, to) = pair(Duration::from_millis(50));
        let flood = std::thread::spawn(move || {
            for _ in 0..200 {
                sender.send_to(&[0], to).expect("sent");
                std::thread::sleep(Duration::from_millis(5));
            }
        });
        let mut wait = inbox.wait().expect("a wait");
        let mut count = 0;
        while inbox.next(&mut wait, false).expect("a datagram").is_some() {
            count += 1;
        }
        assert!((1..200).contains(&count), "{count} datagrams");
        flood.join().expect("an end");
    }
}
