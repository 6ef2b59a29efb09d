//! The client's wait for the newest datagram. It allocates nothing.

use std::io::{Error, ErrorKind};
use std::net::SocketAddr;
use std::sync::Arc;
use std::time::{Duration, Instant};

use super::machine::{Datagrams, Machine};

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

/// A port with a buffer of `N` bytes, of which the newest datagrams are taken.
///
/// Choose `N` one larger than the largest message: a longer datagram then shows by its length.
#[derive(Debug)]
pub struct Inbox<const N: usize> {
    machine: Arc<dyn Machine>,
    socket: Box<dyn Datagrams>,
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

impl<const N: usize> Inbox<N> {
    /// Takes a port of this machine over. A wait ends after `timeout`; before it sleeps, it polls the port for `spin`.
    ///
    /// # Errors
    /// If the system refuses `SO_BUSY_POLL` (`busy_poll_us` microseconds; Linux only).
    pub fn new(
        machine: Arc<dyn Machine>,
        socket: Box<dyn Datagrams>,
        timeout: Duration,
        spin: Duration,
        busy_poll_us: Option<u32>,
    ) -> Result<Self, SocketError> {
        if let Some(us) = busy_poll_us {
            let refused = io_error("set SO_BUSY_POLL; it may need the right CAP_NET_ADMIN");
            socket.busy_poll(us).map_err(refused)?;
        }
        Ok(Self {
            machine,
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
        self.socket.address().map_err(io_error("read the port"))
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
        self.socket.send(bytes, to).map_err(io_error("send a command"))
    }

    /// Begins a wait.
    ///
    /// # Errors
    /// What the system says.
    pub fn wait(&self) -> Result<Wait, SocketError> {
        self.set_wait(None)?;
        Ok(Wait {
            start: self.machine.now(),
            blocking: false,
        })
    }

    /// How long a wait has taken so far.
    pub fn waited(&self, wait: &Wait) -> Duration {
        self.machine.now().saturating_duration_since(wait.start)
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
            if !taken && self.waited(wait) > self.timeout {
                return Ok(None);
            }
            match self.socket.receive(&mut self.buffer) {
                Ok(received) => return Ok(Some(received)),
                Err(error) if error.kind() == ErrorKind::WouldBlock && !wait.blocking => {
                    if taken {
                        return Ok(None);
                    }
                    if self.waited(wait) >= self.spin {
                        self.set_wait(Some(self.timeout))?;
                        wait.blocking = true;
                    } else {
                        self.machine.pause();
                    }
                }
                Err(error) if matches!(error.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => return Ok(None),
                Err(error) if works_on(&error) => {}
                Err(error) => return Err(io_error("receive a state")(error)),
            }
        }
    }

    fn set_wait(&self, wait: Option<Duration>) -> Result<(), SocketError> {
        self.socket.set_wait(wait).map_err(io_error("use the UDP port"))
    }
}

/// Errors of a UDP socket after which it works on: a signal, or an answer that met a closed port.
fn works_on(error: &Error) -> bool {
    matches!(
        error.kind(),
        ErrorKind::Interrupted | ErrorKind::ConnectionRefused | ErrorKind::ConnectionReset
    )
}

#[cfg(test)]
mod tests {
    use super::super::machine::{Process, this_machine};
    use super::super::testing::{LOCAL, World};
    use super::*;

    fn pair(machine: Arc<dyn Machine>, timeout: Duration) -> (Inbox<8>, Box<dyn Datagrams>, SocketAddr) {
        let port = || machine.datagrams(LOCAL).expect("a port");
        let (inbox, sender) = (port(), port());
        let to = inbox.address().expect("an address");
        let inbox = Inbox::new(Arc::clone(&machine), inbox, timeout, Duration::ZERO, None).expect("an inbox");
        (inbox, sender, to)
    }

    // Fails if a wait hands out less than everything that has come, or waits for more after a useful datagram.
    #[test]
    fn everything_that_has_come_is_taken() {
        let (mut inbox, sender, to) = pair(this_machine(), Duration::from_secs(10));
        for number in 0..3 {
            sender.send(&[number], to).expect("sent");
        }
        std::thread::sleep(Duration::from_millis(20));
        let mut wait = inbox.wait().expect("a wait");
        let mut seen = Vec::new();
        while let Some((size, _)) = inbox.next(&mut wait, !seen.is_empty()).expect("a datagram") {
            seen.extend_from_slice(inbox.bytes(size));
        }
        assert_eq!(seen, [0, 1, 2]);
    }

    /// Sends a datagram every 5 ms.
    struct Flood(Box<dyn Datagrams>, SocketAddr);

    impl Process for Flood {
        fn turn(&mut self, now: Instant) -> Instant {
            self.0.send(&[0], self.1).expect("sent");
            now + Duration::from_millis(5)
        }
    }

    // Fails if datagrams that are of no use make a wait longer than its time.
    #[test]
    fn useless_datagrams_do_not_prolong_a_wait() {
        let world = World::new(0);
        let (mut inbox, sender, to) = pair(world.machine(), Duration::from_millis(52));
        let _flood = world.run("flood", Box::new(Flood(sender, to))).expect("a process");
        let mut wait = inbox.wait().expect("a wait");
        let mut count = 0;
        while inbox.next(&mut wait, false).expect("a datagram").is_some() {
            count += 1;
        }
        assert_eq!((count, inbox.waited(&wait).as_millis()), (12, 55));
    }
}
