//! The drive's end of the drive link: any [`Drive`] offered to controllers.

use std::net::{TcpListener, UdpSocket};
use std::time::{Duration, Instant};

use serial2::SerialPort;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus, NO_SESSION};
use spherecal_shared::protocol::frame::{self, LinkCounters, MAX_FRAME};

use super::TcpError;
use super::datagrams::Datagrams;
use super::drive::DRIVE_BAUD;
use super::lobby::{Candidate, Lobby, Look};
use super::progress::Rate;
use super::stream::Stream;
use super::wire::Wire;
use crate::serial::open_port;
use crate::{Drive, LinkError};
use spherecal_budget::link::{LATE, SILENT};

/// Periods without a command after which a real-time drive closes its brakes. Until then the last
/// torque is kept.
const HELD_PERIODS: u32 = 10;
/// How far a drive in real time may fall behind its clock and catch up, as the clock of a real drive goes on. A clock that
/// slips makes each later state late: the controller allows a drift of 1 ms in a second. A longer stop is one of the
/// machine.
const BEHIND: Duration = Duration::from_secs(1);
/// What the peers are called.
const WHO: &str = "the controller";
/// How often those who wait are looked after while nobody is served.
const LOOK: Duration = Duration::from_millis(5);
/// How often a silent controller in lock-step is looked after.
const PATIENCE: Duration = Duration::from_millis(250);

/// Counts of one controller's connection.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct ConnectionCounts {
    /// Commands carried out.
    pub commands: u64,
    /// Periods for which no command came (real time).
    pub missing: u64,
    /// Commands that answered an older state than the last one sent.
    pub late: u64,
    /// What was received.
    pub link: LinkCounters,
}

/// Serves a drive to one controller at a time. Between two controllers the brakes are closed, and
/// the drive continues from its current position.
pub struct DriveServer {
    drive: Box<dyn Drive>,
    real_time: bool,
    lobby: Lobby,
    /// A controller that has earned its place.
    next: Option<Candidate>,
    /// In lock-step: the state that waits for a command, with which controllers are greeted.
    state: Option<DriveState>,
}

impl DriveServer {
    /// A server for `drive`, in lock-step or in real time.
    pub fn new(drive: Box<dyn Drive>, real_time: bool) -> Self {
        Self {
            drive,
            real_time,
            lobby: Lobby::new(WHO, None),
            next: None,
            state: None,
        }
    }

    /// Waits for a controller and serves it until it disconnects.
    ///
    /// A controller earns the place by its first command. In lock-step one that is silent for 5 s then gives way to
    /// another that sends a command. In real time the states come from the beginning on, and one that has not earned the
    /// place gives way at once.
    ///
    /// # Errors
    /// The drive fails, or the controller sends bytes that are not a command. A controller that
    /// disconnects is not an error.
    pub fn serve(&mut self, listener: &TcpListener) -> Result<ConnectionCounts, LinkError> {
        let mut hello = self.drive.hello().clone();
        hello.lock_step = !self.real_time;
        let mut service = ConnectionCounts::default();
        let mut state = if let Some(state) = self.state.take() {
            state
        } else {
            let mut state = DriveState::default();
            self.drive.exchange(None, &mut state)?;
            state
        };
        let Some(candidate) = self.earned(listener, &hello, &state)? else {
            self.state = Some(state);
            return Ok(service);
        };
        let mut wire = Wire::resume(candidate, WHO)?;
        wire.has_sent(GREETING);
        let result = if self.real_time {
            self.in_real_time(&mut wire, Some(listener), &hello, &mut state, &mut service)
        } else {
            self.in_lock_step(&mut wire, listener, &hello, &mut state, &mut service)
        };
        if self.next.is_some() || service.commands == 0 {
            // Whoever waits was greeted with this state, in lock-step; in real time the arm has stood still since.
            self.state = Some(state);
        } else {
            self.lobby.dismiss();
        }
        counted(result, &wire, service)
    }

    /// Serves the controller at the serial port `DEVICE` or `DEVICE@BAUD` (3,000,000 by default) in real time, until the
    /// port fails. A board that asks for the handshake gets it; while no command comes, the brakes are closed.
    ///
    /// # Errors
    /// The port cannot be opened or fails, the drive fails, or bytes come that are not commands.
    pub fn serve_serial(&mut self, device: &str) -> Result<ConnectionCounts, LinkError> {
        let port = open_port(device, DRIVE_BAUD)?;
        self.serve_port(port, &format!("{WHO} at serial:{device}"))
    }

    /// The same at an open port; `peer` appears in messages.
    ///
    /// # Errors
    /// As [`serve_serial`](Self::serve_serial).
    pub fn serve_port(&mut self, port: SerialPort, peer: &str) -> Result<ConnectionCounts, LinkError> {
        self.serve_stream(Stream::Serial(port), peer)
    }

    /// Serves the controllers that speak to a socket in real time, one at a time. One that was silent for 5 s gives way to
    /// the next, and is sent nothing more. Ends only with an error.
    ///
    /// # Errors
    /// The socket or the drive fails, or bytes come that are not commands.
    pub fn serve_udp(&mut self, socket: &UdpSocket) -> Result<ConnectionCounts, LinkError> {
        let socket = socket.try_clone().map_err(|source| TcpError::of(WHO, source))?;
        self.serve_stream(Stream::Udp(Datagrams::answering(socket)), WHO)
    }

    fn serve_stream(&mut self, stream: Stream, peer: &str) -> Result<ConnectionCounts, LinkError> {
        let mut hello = self.drive.hello().clone();
        hello.lock_step = false;
        let (mut state, mut service) = (DriveState::default(), ConnectionCounts::default());
        self.drive.exchange(None, &mut state)?;
        let mut wire = Wire::over(stream, peer.to_owned());
        let result = self.in_real_time(&mut wire, None, &hello, &mut state, &mut service);
        counted(result, &wire, service)
    }

    /// The next controller that sends a command, or in real time one that has only connected; `None` if one has
    /// disconnected before.
    fn earned(
        &mut self,
        listener: &TcpListener,
        hello: &DriveHello,
        state: &DriveState,
    ) -> Result<Option<Candidate>, LinkError> {
        if let Some(next) = self.next.take() {
            return Ok(Some(next));
        }
        let greeting = greeting(hello, state)?;
        loop {
            match self.lobby.look(listener, &greeting)? {
                Look::Spoke(candidate) => return Ok(Some(candidate)),
                Look::Left(None) => return Ok(None),
                Look::Left(Some(reason)) => {
                    self.state = Some(state.clone());
                    return Err(reason.into());
                }
                Look::Nothing => {
                    if self.real_time
                        && let Some(candidate) = self.lobby.first()
                    {
                        return Ok(Some(candidate));
                    }
                    std::thread::sleep(LOOK);
                }
            }
        }
    }

    /// Fails if another controller has sent a command: this one gives way.
    fn give_way(
        &mut self,
        peer: &str,
        listener: &TcpListener,
        hello: &DriveHello,
        state: &DriveState,
        since: Instant,
    ) -> Result<(), LinkError> {
        let Look::Spoke(next) = self.lobby.look(listener, &greeting(hello, state)?)? else {
            return Ok(());
        };
        self.next = Some(next);
        Err(TcpError::Gone {
            peer: peer.to_owned(),
            what: "it gives way to another controller",
            seconds: since.elapsed().as_secs(),
        }
        .into())
    }

    fn in_lock_step(
        &mut self,
        wire: &mut Wire,
        listener: &TcpListener,
        hello: &DriveHello,
        state: &mut DriveState,
        service: &mut ConnectionCounts,
    ) -> Result<(), LinkError> {
        // Lock-step: a controller may take any time, because simulated time stands still; while nobody else waits.
        wire.patience(Some(PATIENCE))?;
        loop {
            let late = service.late;
            let begin = Instant::now();
            let command = loop {
                let came = match wire.expect::<DriveCommand>("a drive command")? {
                    Some((_, mut command)) => {
                        check_session(wire, hello, &mut command)?;
                        if command.tick == state.tick {
                            break command;
                        }
                        true
                    }
                    None => false,
                };
                // One whose commands answer no state has earned no place.
                if service.commands == 0 || begin.elapsed() >= SILENT {
                    self.give_way(&wire.peer, listener, hello, state, begin)?;
                }
                if !came {
                    continue;
                }
                service.late += 1;
                if service.late - late > LATE {
                    return Err(TcpError::Flood {
                        peer: wire.peer.clone(),
                        what: "drive commands that answer no state",
                        count: service.late - late,
                        seconds: begin.elapsed().as_secs_f64(),
                    }
                    .into());
                }
            };
            service.commands += 1;
            self.drive.exchange(Some(&command), state)?;
            // Whoever waits was greeted with the state before.
            self.lobby.dismiss();
            wire.send(state, state.tick.wrapping_mul(u64::from(hello.period_us)))?;
        }
    }

    /// Without a `listener` nobody else waits, and a silent controller keeps its place.
    fn in_real_time(
        &mut self,
        wire: &mut Wire,
        listener: Option<&TcpListener>,
        hello: &DriveHello,
        state: &mut DriveState,
        service: &mut ConnectionCounts,
    ) -> Result<(), LinkError> {
        wire.never_wait()?;
        let period = Duration::from_micros(u64::from(hello.period_us));
        let start = Instant::now();
        let mut due = start;
        let mut last: Option<DriveCommand> = None;
        let mut silent = HELD_PERIODS;
        let (mut rate, mut heard) = (Rate::new(period), start);
        loop {
            let mut fresh = false;
            while let Some((_, mut command)) = wire.expect::<DriveCommand>("a drive command")? {
                rate.count(&wire.peer, "drive commands")?;
                heard = Instant::now();
                check_session(wire, hello, &mut command)?;
                // It answers an older state, or one that has not been yet.
                if command.tick > state.tick || last.as_ref().is_some_and(|last| command.tick <= last.tick) {
                    service.late += 1;
                    continue;
                }
                fresh = true;
                last = Some(command);
            }
            if fresh {
                silent = 0;
                service.commands += 1;
            } else if last.is_some() {
                silent = silent.saturating_add(1);
                service.missing += 1;
            }
            if last.is_some() {
                // Whoever waits was greeted with a state that is old now.
                self.lobby.dismiss();
            } else if let Some(listener) = listener {
                self.give_way(&wire.peer, listener, hello, state, start)?;
            }
            if listener.is_some() && heard.elapsed() >= SILENT && !wire.is_noisy() {
                return Err(TcpError::Gone {
                    peer: wire.peer.clone(),
                    what: "the drive keeps its brakes closed and waits for another controller",
                    seconds: SILENT.as_secs(),
                }
                .into());
            }
            let held = silent < HELD_PERIODS;
            self.drive.exchange(last.as_ref().filter(|_| held), state)?;
            if last.is_some() && !held {
                // The controller was lost: close the brakes and report it.
                state.status = DriveStatus::Disabled;
            }
            let time_us = u64::try_from(start.elapsed().as_micros()).unwrap_or(u64::MAX);
            wire.send(state, time_us)?;
            due += period;
            let now = Instant::now();
            if now < due {
                std::thread::sleep(due - now);
            } else if now > due + BEHIND {
                due = now;
            }
        }
    }
}

const GREETING: u32 = 2;

/// The hello and the first state, framed for a controller in lock-step.
fn greeting(hello: &DriveHello, state: &DriveState) -> Result<Vec<u8>, TcpError> {
    let mut bytes = vec![0; 2 * MAX_FRAME];
    let first = frame::encode(hello, 0, 0, &mut bytes)?;
    let time_us = state.tick.wrapping_mul(u64::from(hello.period_us));
    let rest = bytes.get_mut(first..).unwrap_or_default();
    let second = frame::encode(state, 1, time_us, rest)?;
    bytes.truncate(first + second);
    Ok(bytes)
}

/// What a service came to. A controller that has disconnected is no error.
fn counted(
    result: Result<(), LinkError>,
    wire: &Wire,
    mut service: ConnectionCounts,
) -> Result<ConnectionCounts, LinkError> {
    service.link = wire.counters();
    match result {
        Err(LinkError::Tcp(error)) if error.is_closed() => Ok(service),
        Err(error) => Err(error),
        Ok(()) => Ok(service),
    }
}

/// Closes the brakes for a command of another session, and sends the handshake again to a controller
/// that asks for it.
fn check_session(wire: &mut Wire, hello: &DriveHello, command: &mut DriveCommand) -> Result<(), TcpError> {
    if command.session != hello.session {
        command.enable = false;
        if command.session == NO_SESSION {
            wire.send(hello, 0)?;
        }
    }
    Ok(())
}
