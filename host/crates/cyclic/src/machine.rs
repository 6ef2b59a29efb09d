//! The machine that one side of a wire runs on: its time and its network.
//!
//! Client and robot side reach time and sockets only through a [`Machine`]. [`this_machine`] is this computer.
//! `testing::World` is a simulated network with a clock of its own: a wait lets its time pass, and nothing else does.

use std::fmt::Debug;
use std::io::{ErrorKind, Read, Result, Write};
use std::net::{Shutdown, SocketAddr, TcpListener, TcpStream, UdpSocket};
use std::sync::atomic::{AtomicBool, Ordering};
use std::sync::{Arc, Mutex, PoisonError};
use std::time::{Duration, Instant};

/// Time and network of one side of a wire.
pub trait Machine: Debug + Send + Sync {
    /// The time now.
    fn now(&self) -> Instant;

    /// Lets this much time pass.
    fn sleep(&self, time: Duration);

    /// Lets a moment pass between two looks at a socket that is polled.
    fn pause(&self);

    /// Opens a port for datagrams. Port 0 takes any free one.
    ///
    /// # Errors
    /// The address is in use or is none of this machine.
    fn datagrams(&self, at: SocketAddr) -> Result<Box<dyn Datagrams>>;

    /// Listens for connections. Port 0 takes any free one.
    ///
    /// # Errors
    /// The address is in use or is none of this machine.
    fn listen(&self, at: SocketAddr) -> Result<Box<dyn Listener>>;

    /// Connects within this time. Reads of the stream wait for bytes.
    ///
    /// # Errors
    /// Nobody listens there, or the network is out.
    fn connect(&self, to: SocketAddr, timeout: Duration) -> Result<Box<dyn Stream>>;

    /// Runs a process until the result is dropped.
    ///
    /// # Errors
    /// What the system says if no thread can be started.
    fn run(&self, name: &str, process: Box<dyn Process>) -> Result<Running>;
}

/// What acts at times of its own, and never waits: a robot side, a person.
pub trait Process: Send {
    /// Does what is due at `now`. Returns when to be called next.
    fn turn(&mut self, now: Instant) -> Instant;
}

/// A port for datagrams.
pub trait Datagrams: Debug + Send {
    /// Its own address.
    ///
    /// # Errors
    /// What the system says.
    fn address(&self) -> Result<SocketAddr>;

    /// Sends a datagram.
    ///
    /// # Errors
    /// What the system says. A datagram that is lost on its way is no error.
    fn send(&self, bytes: &[u8], to: SocketAddr) -> Result<()>;

    /// How long [`receive`](Self::receive) waits. `None`, and before the first call: not at all.
    ///
    /// # Errors
    /// What the system says.
    fn set_wait(&self, wait: Option<Duration>) -> Result<()>;

    /// The next datagram: its size and its sender.
    ///
    /// # Errors
    /// `WouldBlock` or `TimedOut` if none comes; else what the system says.
    fn receive(&self, buffer: &mut [u8]) -> Result<(usize, SocketAddr)>;

    /// Polls the network card for this many microseconds before a wait sleeps (`SO_BUSY_POLL`).
    ///
    /// # Errors
    /// The system cannot, or does not permit it.
    fn busy_poll(&self, us: u32) -> Result<()>;
}

/// A port for connections.
pub trait Listener: Debug + Send {
    /// Its own address.
    ///
    /// # Errors
    /// What the system says.
    fn address(&self) -> Result<SocketAddr>;

    /// The next connection and its client. Does not wait, nor does the stream.
    ///
    /// # Errors
    /// `WouldBlock` if nobody has connected; else what the system says.
    fn accept(&self) -> Result<(Box<dyn Stream>, SocketAddr)>;
}

/// A connection. It closes when it is dropped.
pub trait Stream: Read + Write + Debug + Send {
    /// How long a read waits. `None`: reads and writes do not wait.
    ///
    /// # Errors
    /// What the system says.
    fn set_wait(&self, wait: Option<Duration>) -> Result<()>;

    /// Whether the other side has closed the connection. Does not wait. Afterwards reads and writes wait again.
    fn is_closed(&self) -> bool;

    /// Closes the connection in both directions.
    fn close(&self);
}

/// A running process. It ends when this is dropped.
pub struct Running(Option<Box<dyn FnOnce() + Send + Sync>>);

impl Running {
    pub(crate) fn until(end: impl FnOnce() + Send + Sync + 'static) -> Self {
        Self(Some(Box::new(end)))
    }
}

impl Debug for Running {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Running")
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        if let Some(end) = self.0.take() {
            end();
        }
    }
}

/// This computer: the wall clock, its sockets, and a thread for each process.
pub fn this_machine() -> Arc<dyn Machine> {
    Arc::new(ThisMachine)
}

#[derive(Debug)]
struct ThisMachine;

impl Machine for ThisMachine {
    fn now(&self) -> Instant {
        Instant::now()
    }

    fn sleep(&self, time: Duration) {
        std::thread::sleep(time);
    }

    fn pause(&self) {
        std::hint::spin_loop();
    }

    fn datagrams(&self, at: SocketAddr) -> Result<Box<dyn Datagrams>> {
        let socket = UdpSocket::bind(at)?;
        socket.set_nonblocking(true)?;
        Ok(Box::new(socket))
    }

    fn listen(&self, at: SocketAddr) -> Result<Box<dyn Listener>> {
        let listener = TcpListener::bind(at)?;
        listener.set_nonblocking(true)?;
        Ok(Box::new(listener))
    }

    fn connect(&self, to: SocketAddr, timeout: Duration) -> Result<Box<dyn Stream>> {
        let stream = TcpStream::connect_timeout(&to, timeout)?;
        stream.set_nodelay(true)?;
        Ok(Box::new(stream))
    }

    fn run(&self, name: &str, mut process: Box<dyn Process>) -> Result<Running> {
        let ended = Arc::new(AtomicBool::new(false));
        let theirs = Arc::clone(&ended);
        let thread = std::thread::Builder::new().name(name.into()).spawn(move || {
            while !theirs.load(Ordering::Relaxed) {
                let due = process.turn(Instant::now());
                std::thread::sleep(due.saturating_duration_since(Instant::now()));
            }
        })?;
        Ok(Running::until(move || {
            ended.store(true, Ordering::Relaxed);
            // A panic of the thread has been printed already.
            let _ = thread.join();
        }))
    }
}

/// The shortest wait that is not taken for none.
const SHORTEST: Duration = Duration::from_micros(1);

impl Datagrams for UdpSocket {
    fn address(&self) -> Result<SocketAddr> {
        self.local_addr()
    }

    fn send(&self, bytes: &[u8], to: SocketAddr) -> Result<()> {
        self.send_to(bytes, to).map(|_| ())
    }

    fn set_wait(&self, wait: Option<Duration>) -> Result<()> {
        if let Some(wait) = wait {
            self.set_read_timeout(Some(wait.max(SHORTEST)))?;
        }
        self.set_nonblocking(wait.is_none())
    }

    fn receive(&self, buffer: &mut [u8]) -> Result<(usize, SocketAddr)> {
        self.recv_from(buffer)
    }

    #[cfg(target_os = "linux")]
    fn busy_poll(&self, us: u32) -> Result<()> {
        socket2::SockRef::from(self).set_busy_poll(us)
    }

    #[cfg(not(target_os = "linux"))]
    fn busy_poll(&self, _us: u32) -> Result<()> {
        Err(ErrorKind::Unsupported.into())
    }
}

impl Listener for TcpListener {
    fn address(&self) -> Result<SocketAddr> {
        self.local_addr()
    }

    fn accept(&self) -> Result<(Box<dyn Stream>, SocketAddr)> {
        let (stream, peer) = TcpListener::accept(self)?;
        stream.set_nonblocking(true)?;
        stream.set_nodelay(true)?;
        Ok((Box::new(stream), peer))
    }
}

impl Stream for TcpStream {
    fn set_wait(&self, wait: Option<Duration>) -> Result<()> {
        if let Some(wait) = wait {
            self.set_read_timeout(Some(wait.max(SHORTEST)))?;
        }
        self.set_nonblocking(wait.is_none())
    }

    fn is_closed(&self) -> bool {
        if self.set_nonblocking(true).is_err() {
            return true;
        }
        let closed = match self.peek(&mut [0]) {
            Ok(0) => true,
            Ok(_) => false,
            Err(error) => error.kind() != ErrorKind::WouldBlock,
        };
        closed || self.set_nonblocking(false).is_err()
    }

    fn close(&self) {
        // The connection may be gone already; there is nobody to tell.
        let _ = self.shutdown(Shutdown::Both);
    }
}

/// What the process of a robot side shares with its owner: controls `C` in, statistics `S` out.
#[derive(Debug)]
pub struct Published<C, S> {
    /// What persons and safety functions do.
    pub controls: C,
    statistics: Mutex<S>,
}

impl<C, S: Copy> Published<C, S> {
    /// Lets the owner see these statistics.
    pub fn publish(&self, statistics: S) {
        *self.statistics.lock().unwrap_or_else(PoisonError::into_inner) = statistics;
    }

    fn statistics(&self) -> S {
        *self.statistics.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// A running robot side. It ends when it is dropped.
#[derive(Debug)]
pub struct Side<C, S> {
    address: SocketAddr,
    shared: Arc<Published<C, S>>,
    running: Running,
}

impl<C: Default, S: Copy + Default> Side<C, S> {
    /// Starts the process that `make` makes, under this name. `address` is its own.
    ///
    /// # Errors
    /// What the system says if no thread can be started.
    pub fn start<P: Process + 'static>(
        machine: &dyn Machine,
        name: &str,
        address: SocketAddr,
        make: impl FnOnce(Arc<Published<C, S>>) -> P,
    ) -> std::io::Result<Self> {
        let shared = Arc::new(Published {
            controls: C::default(),
            statistics: Mutex::new(S::default()),
        });
        let running = machine.run(name, Box::new(make(Arc::clone(&shared))))?;
        Ok(Self {
            address,
            shared,
            running,
        })
    }
}

impl<C, S: Copy> Side<C, S> {
    /// Where it listens, or from where it sends.
    pub fn address(&self) -> SocketAddr {
        self.address
    }

    /// What persons, application and safety functions do.
    pub fn controls(&self) -> &C {
        &self.shared.controls
    }

    /// The statistics of the last period.
    pub fn statistics(&self) -> S {
        self.shared.statistics()
    }

    /// Ends the process and waits for it.
    pub fn shut_down(self) -> S {
        drop(self.running);
        self.shared.statistics()
    }
}
