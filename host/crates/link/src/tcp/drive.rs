//! The controller's end of the drive link: a drive behind a TCP connection, a serial port, or a UDP socket.

use std::time::{Duration, Instant};

use serial2::SerialPort;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, NO_SESSION};
use spherecal_shared::protocol::frame::LinkCounters;
use spherecal_shared::robot::{JointLimits, Robot};
use spherecal_shared::timing::PeriodWatch;

use super::TcpError;
use super::datagrams::Datagrams;
use super::progress::Rate;
use super::stream::Stream;
use super::wire::{Parsed, Wire};
use crate::serial::open_port;
use crate::{Drive, LinkError};
use spherecal_budget::HANDSHAKE;
use spherecal_budget::link::{AHEAD, FIRST_STATE, PERIOD};

/// How often a drive at a serial port or UDP socket is asked for its hello.
const ASK: Duration = Duration::from_millis(200);
/// Rate of the boards' drive link, in bits per second.
pub(super) const DRIVE_BAUD: u32 = 3_000_000;

/// How long before a state is due this side starts to poll for it.
const EARLY: Duration = Duration::from_micros(250);
/// Interval of that polling.
const LOOK: Duration = Duration::from_micros(40);

/// A drive behind a TCP connection, a serial port, or a UDP socket.
///
/// In real time an [`exchange`](Drive::exchange) ends when a new state has arrived. The drive is
/// the clock, so two clocks never drift against each other. If the state is half a period late, the
/// exchange ends without it and the controller gets the last state again; the state's number shows
/// the repeat. Ticks that this side missed are counted as on a board.
pub struct RemoteDrive {
    wire: Wire,
    hello: DriveHello,
    schedule: Option<RealTimeSchedule>,
    /// The command of this period was sent.
    answered: bool,
    /// What a drive in real time has sent, from its first state on.
    rate: Option<Rate>,
    /// Periods in which a lock-step drive was ahead.
    ahead: u32,
    missed: u32,
}

/// The clock of the controller of a real-time drive.
struct RealTimeSchedule {
    start: Instant,
    period_us: u64,
    watch: PeriodWatch,
}

impl RealTimeSchedule {
    fn new(period_us: u32) -> Self {
        let period_us = u64::from(period_us);
        Self {
            start: Instant::now(),
            period_us,
            watch: PeriodWatch::new(period_us, 0),
        }
    }

    fn now_us(&self) -> u64 {
        u64::try_from(self.start.elapsed().as_micros()).unwrap_or(u64::MAX)
    }

    /// How long it is until the next state may come.
    fn until_early(&self) -> Duration {
        let due = Duration::from_micros(self.watch.due_us());
        due.saturating_sub(EARLY).saturating_sub(self.start.elapsed())
    }

    /// Whether the next state is half a period late.
    fn is_late(&self) -> bool {
        self.now_us() >= self.watch.due_us().saturating_add(self.period_us / 2)
    }

    /// Notes a tick; returns the number of periods that passed without one.
    fn tick(&mut self) -> u32 {
        let now_us = self.now_us();
        let missed = self.watch.record(now_us);
        self.watch = PeriodWatch::new(self.period_us, now_us);
        missed
    }
}

impl RemoteDrive {
    /// Connects to `HOST:PORT` and receives the drive's hello.
    ///
    /// # Errors
    /// Nothing answers there, or the answer is not of this drive link.
    pub fn connect(address: &str) -> Result<Self, TcpError> {
        let mut wire = Wire::connect(address)?;
        let hello: DriveHello = wire
            .wait_for("a drive's hello", HANDSHAKE)
            .map_err(|error| match error {
                TcpError::Silent { peer, seconds, .. } => TcpError::NotADrive { peer, seconds },
                other => other,
            })?;
        Self::greeted(wire, hello)
    }

    /// Opens the serial port `DEVICE` or `DEVICE@BAUD` (3,000,000 by default) and asks the drive there for its hello. The
    /// drive runs in real time.
    ///
    /// # Errors
    /// The port cannot be opened, or no hello comes.
    pub fn open(device: &str) -> Result<Self, LinkError> {
        let port = open_port(device, DRIVE_BAUD)?;
        Ok(Self::at_port(port, &format!("serial:{device}"))?)
    }

    /// The same at an open port; `peer` appears in messages.
    ///
    /// # Errors
    /// No hello comes, or the port fails.
    pub fn at_port(port: SerialPort, peer: &str) -> Result<Self, TcpError> {
        Self::asked(Wire::over(Stream::Serial(port), peer.to_owned()))
    }

    /// Asks the drive at the UDP socket `HOST:PORT` for its hello. The drive runs in real time.
    ///
    /// # Errors
    /// There is no such host, or no hello comes.
    pub fn at_socket(address: &str) -> Result<Self, TcpError> {
        let peer = format!("udp:{address}");
        let unreachable = |source| TcpError::Unreachable {
            peer: peer.clone(),
            source,
        };
        let stream = Stream::Udp(Datagrams::to(address).map_err(unreachable)?);
        Self::asked(Wire::over(stream, peer.clone())).map_err(|error| match error {
            // Nobody listens there.
            TcpError::Broken { source, .. } => unreachable(source),
            other => other,
        })
    }

    /// Asks until the hello comes: a drive that runs already does not know that somebody listens.
    fn asked(mut wire: Wire) -> Result<Self, TcpError> {
        wire.patience(Some(ASK))?;
        let begun = Instant::now();
        let question = DriveCommand {
            session: NO_SESSION,
            ..DriveCommand::default()
        };
        let mut asked: Option<Instant> = None;
        // States of a drive that is asked already come between.
        while begun.elapsed() < HANDSHAKE {
            if asked.is_none_or(|asked| asked.elapsed() >= ASK) {
                wire.send(&question, 0)?;
                asked = Some(Instant::now());
            }
            if let Some(Parsed::Message(_, hello)) = wire.receive::<DriveHello>()? {
                return Self::greeted(wire, hello);
            }
        }
        Err(TcpError::NotADrive {
            peer: wire.peer,
            seconds: HANDSHAKE.as_secs(),
        })
    }

    fn greeted(mut wire: Wire, hello: DriveHello) -> Result<Self, TcpError> {
        let schedule = if hello.lock_step {
            wire.patience(Some(PERIOD))?;
            None
        } else {
            Some(RealTimeSchedule::new(hello.period_us))
        };
        Ok(Self {
            wire,
            hello,
            schedule,
            answered: false,
            rate: None,
            ahead: 0,
            missed: 0,
        })
    }

    fn send(&mut self, command: &DriveCommand) -> Result<(), TcpError> {
        let time_us = command.tick.wrapping_mul(u64::from(self.hello.period_us));
        self.wire.send(command, time_us)
    }

    /// The next state; `None` when none came in time. The hello of the session may come once more.
    fn next_state(&mut self) -> Result<Option<DriveState>, TcpError> {
        loop {
            match self.wire.receive::<DriveState>()? {
                None => return Ok(None),
                Some(Parsed::Message(_, state)) => return Ok(Some(state)),
                // One that changes something else than the number is ignored, too.
                Some(Parsed::Hello(hello)) if hello.session == self.hello.session => {}
                Some(Parsed::Hello(hello)) => {
                    return Err(TcpError::Restarted {
                        peer: self.wire.peer.clone(),
                        session: self.hello.session,
                        found: hello.session,
                    });
                }
                Some(other) => return Err(self.wire.unexpected("a drive state", other)),
            }
        }
    }

    fn silent(&self, waited: Duration) -> TcpError {
        TcpError::Silent {
            peer: self.wire.peer.clone(),
            seconds: waited.as_secs(),
            damaged: self.wire.counters().crc_errors,
        }
    }

    fn newest(&mut self, state: &mut DriveState) -> Result<(), TcpError> {
        if self.rate.is_none() {
            self.wire.patience(Some(FIRST_STATE))?;
            *state = self.next_state()?.ok_or_else(|| self.silent(FIRST_STATE))?;
            self.wire.never_wait()?;
            // The ticks begin with the first state.
            self.schedule = Some(RealTimeSchedule::new(self.hello.period_us));
            self.rate = Some(Rate::new(Duration::from_micros(u64::from(self.hello.period_us))));
            return Ok(());
        }
        let early = self.schedule.as_ref().map(RealTimeSchedule::until_early);
        std::thread::sleep(early.unwrap_or_default());
        let mut fresh = false;
        loop {
            while let Some(newer) = self.next_state()? {
                if let Some(rate) = &mut self.rate {
                    rate.count(&self.wire.peer, "drive states")?;
                }
                *state = newer;
                fresh = true;
            }
            if fresh || self.schedule.as_ref().is_none_or(RealTimeSchedule::is_late) {
                break;
            }
            std::thread::sleep(LOOK);
        }
        self.missed = self.schedule.as_mut().map_or(0, RealTimeSchedule::tick);
        Ok(())
    }
}

impl Drive for RemoteDrive {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        let answered = std::mem::take(&mut self.answered);
        if let Some(command) = command.filter(|_| !answered) {
            self.send(command)?;
        }
        if self.schedule.is_some() {
            self.newest(state)?;
        } else {
            *state = self.next_state()?.ok_or_else(|| self.silent(PERIOD))?;
            self.ahead = if self.wire.has_more() {
                self.ahead + 1
            } else {
                self.ahead.saturating_sub(1)
            };
            if self.ahead > AHEAD {
                return Err(TcpError::Ahead {
                    peer: self.wire.peer.clone(),
                    periods: self.ahead,
                }
                .into());
            }
        }
        Ok(())
    }

    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        // In lock-step the drive waits anyway.
        if !self.hello.lock_step {
            self.send(command)?;
            self.answered = true;
        }
        Ok(())
    }

    fn missed(&self) -> u32 {
        self.missed
    }

    fn counters(&self) -> LinkCounters {
        self.wire.counters()
    }
}

/// Checks that a drive with these limits can do everything that the robot's description allows. The
/// plan was made with the description.
///
/// # Errors
/// The first limit of the drive that is tighter than the description's, or is not a number.
pub fn check_limits(drive: &[JointLimits], robot: &Robot) -> Result<(), TcpError> {
    /// Limits that were typed in other units differ in the last digits.
    const SLACK: f64 = 1e-3;
    for (k, (has, needs)) in drive.iter().zip(robot.joints.iter().map(|j| &j.limits)).enumerate() {
        let pairs = [
            (
                "a smallest angle in rad of",
                has.min_rad,
                needs.min_rad,
                needs.min_rad - has.min_rad,
            ),
            (
                "a largest angle in rad of",
                has.max_rad,
                needs.max_rad,
                has.max_rad - needs.max_rad,
            ),
            (
                "a largest speed in rad/s of",
                has.velocity_rad_s,
                needs.velocity_rad_s,
                has.velocity_rad_s - needs.velocity_rad_s,
            ),
            (
                "a largest torque in N m of",
                has.torque_nm,
                needs.torque_nm,
                has.torque_nm - needs.torque_nm,
            ),
        ];
        for (what, drive, robot, spare) in pairs {
            // The negation refuses a NaN as well.
            if !(spare >= -SLACK) {
                return Err(TcpError::Limits {
                    joint: k + 1,
                    what,
                    drive,
                    robot,
                });
            }
        }
    }
    Ok(())
}

#[cfg(test)]
#[path = "drive_tests.rs"]
mod tests;
