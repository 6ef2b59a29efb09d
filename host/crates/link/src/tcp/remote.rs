//! The host's end of a controller that runs in another process.

use std::io::{ErrorKind, Write};
use std::thread::JoinHandle;
use std::time::{Duration, Instant};

use spherecal_shared::protocol::drive::DriveHello;
use spherecal_shared::protocol::host::Uplink;

use super::controller_server::serve_own_host;
use super::progress::FrameWatch;
use super::stream::{Stream, read_some};
use super::turns::Turns;
use super::wire::Wire;
use super::{TcpError, listen};
use crate::native::{Monitor, enter_real_time};
use crate::{Device, Drive, LinkError, LocalDevice, check_hello, controller_in_process};
use spherecal_budget::link::{CONTROLLER_HELLO, NO_FRAME, PERIOD};

/// How often a silent controller is looked after.
const LOOK: Duration = Duration::from_millis(500);

/// A controller process, reached over its host link.
///
/// A controller disconnects a host that was silent for 5 s, holds the arm, and serves whoever comes next. So a host that
/// was held up connects again and goes on; its session is the same.
pub struct Remote {
    /// Where it connects again; `None` if the controller ends with the connection.
    address: Option<String>,
    /// Whether a period has come over this connection.
    heard: bool,
    stream: Stream,
    peer: String,
    hello: DriveHello,
    turns: Turns,
    watch: FrameWatch,
    buffer: Vec<u8>,
    out: Vec<u8>,
    ticks: u64,
}

impl Remote {
    /// Connects to the host link of a controller process at `HOST:PORT`, for a
    /// robot with `joints` joints.
    ///
    /// # Errors
    /// Nothing answers there, or its drive belongs to another robot.
    pub fn connect(address: &str, joints: usize) -> Result<Self, LinkError> {
        let mut this = Self::connect_once(address, joints)?;
        this.address = Some(address.to_owned());
        Ok(this)
    }

    fn connect_once(address: &str, joints: usize) -> Result<Self, LinkError> {
        let mut wire = Wire::connect(address)?;
        let peer = wire.peer.clone();
        let hello: DriveHello = match wire.wait_for("the hello of a controller's drive", CONTROLLER_HELLO) {
            Err(TcpError::Silent { peer, seconds, .. }) => return Err(TcpError::Busy { peer, seconds }.into()),
            other => other?,
        };
        check_hello(&hello, joints)?;
        wire.patience(Some(LOOK))?;
        let (stream, rest) = wire.into_stream();
        let mut turns = Turns::default();
        turns.push(&rest);
        Ok(Self {
            address: None,
            heard: false,
            stream,
            peer,
            hello,
            turns,
            watch: FrameWatch::of::<Uplink>(),
            buffer: vec![0; 1 << 14],
            out: Vec::new(),
            ticks: 0,
        })
    }

    /// Connects again after the controller has closed the connection. Returns whether the same controller answers: one
    /// with another drive is another, and one that closes the connection at once is not asked twice.
    fn connect_again(&mut self) -> bool {
        let Some(address) = self.address.clone().filter(|_| self.heard) else {
            return false;
        };
        let Ok(again) = Self::connect(&address, self.hello.limits.len()) else {
            return false;
        };
        if again.hello != self.hello {
            return false;
        }
        *self = Self {
            ticks: self.ticks,
            ..again
        };
        true
    }

    /// The hello of the controller's drive.
    pub fn hello(&self) -> &DriveHello {
        &self.hello
    }
}

impl Device for Remote {
    fn waits(&self) -> bool {
        self.hello.lock_step
    }

    fn simulated(&self) -> Option<bool> {
        Some(self.hello.simulated)
    }

    fn now_us(&self) -> u64 {
        self.ticks
            .saturating_sub(1)
            .saturating_mul(u64::from(self.hello.period_us))
    }

    fn ticks(&self) -> u64 {
        self.ticks
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        match self.turn(down, up) {
            Err(error) if error.is_closed() && self.connect_again() => Ok(self.turn(down, up)?),
            other => Ok(other?),
        }
    }
}

impl Remote {
    /// One period over the present connection.
    fn turn(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), TcpError> {
        self.out.clear();
        self.out.extend_from_slice(down);
        self.out.push(0);
        let begin = Instant::now();
        let mut at = 0;
        while at < self.out.len() {
            match self.stream.write(self.out.get(at..).unwrap_or_default()) {
                Ok(count) if count > 0 => at += count,
                Err(e) if e.kind() == ErrorKind::Interrupted => {}
                Err(e) if matches!(e.kind(), ErrorKind::WouldBlock | ErrorKind::TimedOut) => {
                    return Err(TcpError::Deaf {
                        peer: self.peer.clone(),
                        seconds: begin.elapsed().as_secs(),
                    });
                }
                other => {
                    let error = other.err().unwrap_or_else(|| ErrorKind::BrokenPipe.into());
                    return Err(TcpError::of(&self.peer, error));
                }
            }
        }
        let mut begun = None;
        loop {
            if let Some(turn) = self.turns.next() {
                self.watch.look(turn);
                self.watch.progress.check(&self.peer)?;
                up.extend_from_slice(turn);
                self.ticks += 1;
                self.heard = true;
                return Ok(());
            }
            // A turn in parts may take as long as a frame; silence as long as the drive.
            let waited = begin.elapsed();
            if self.turns.waiting() > 0 && begun.get_or_insert_with(Instant::now).elapsed() >= NO_FRAME {
                return Err(TcpError::Endless {
                    peer: self.peer.clone(),
                    bytes: self.turns.waiting(),
                });
            }
            if self.turns.waiting() == 0 && waited >= PERIOD {
                return Err(TcpError::Silent {
                    peer: self.peer.clone(),
                    seconds: waited.as_secs(),
                    damaged: 0,
                });
            }
            let count = read_some(&mut self.stream, &mut self.buffer).map_err(|e| TcpError::of(&self.peer, e))?;
            self.turns.push(self.buffer.get(..count).unwrap_or_default());
            self.turns.check(&self.peer)?;
        }
    }
}

/// A controller in a thread of this process, for a drive in real time. Slow work of the host (a
/// database, a screen) then never delays a tick. For a robot's own interface it is a real-time
/// thread, as far as the system permits.
pub struct Threaded {
    remote: Option<Remote>,
    thread: Option<JoinHandle<Result<(), LinkError>>>,
    monitor: Option<Monitor>,
}

impl Threaded {
    /// Starts a controller for `drive`.
    ///
    /// # Errors
    /// The drive has another number of joints than the robot, or the thread does not start.
    pub fn start(drive: Box<dyn Drive>, joints: usize) -> Result<Self, LinkError> {
        let monitor = drive.monitor();
        let mut cell = LocalDevice::new(controller_in_process(joints)?, drive, joints)?;
        let (listener, address) = listen("0")?;
        let native = monitor.clone();
        let thread = std::thread::Builder::new()
            .name("controller".to_owned())
            .spawn(move || {
                if let Some(monitor) = native {
                    enter_real_time(&monitor);
                }
                serve_own_host(&mut cell, &listener)
            })
            .map_err(|source| LinkError::Transport {
                link: "the controller's thread".to_owned(),
                source,
            })?;
        let mut this = Self {
            remote: None,
            thread: Some(thread),
            monitor,
        };
        match Remote::connect_once(&address.to_string(), joints) {
            Ok(remote) => this.remote = Some(remote),
            Err(error) => return Err(this.reason(error)),
        }
        Ok(this)
    }

    /// Why the thread ended, if it has ended; else `error`.
    fn reason(&mut self, error: LinkError) -> LinkError {
        self.remote = None;
        match self.thread.take().map(JoinHandle::join) {
            Some(Ok(Err(reason))) => reason,
            _ => error,
        }
    }
}

impl Device for Threaded {
    fn waits(&self) -> bool {
        self.remote.as_ref().is_none_or(Device::waits)
    }

    fn simulated(&self) -> Option<bool> {
        self.remote.as_ref().and_then(Device::simulated)
    }

    fn now_us(&self) -> u64 {
        self.remote.as_ref().map_or(0, Device::now_us)
    }

    fn ticks(&self) -> u64 {
        self.remote.as_ref().map_or(0, Device::ticks)
    }

    fn step(&mut self, down: &[u8], up: &mut Vec<u8>) -> Result<(), LinkError> {
        let result = match &mut self.remote {
            Some(remote) => remote.step(down, up),
            None => Err(TcpError::Closed {
                peer: "the controller's thread".to_owned(),
            }
            .into()),
        };
        result.map_err(|error| self.reason(error))
    }

    fn monitor(&self) -> Option<Monitor> {
        self.monitor.clone()
    }
}

impl Drop for Threaded {
    fn drop(&mut self) {
        // The thread ends at the next tick after its host has disconnected.
        self.remote = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
