//! What the drives of all makers share: the loop of an exchange, its ticks, silences and new connections.

use std::sync::Arc;
use std::time::Duration;

use spherecal_budget::robot::GIVE_UP;
use spherecal_cyclic::Machine;
use spherecal_shared::Joints;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::LoopTiming;

use super::DriveEvent;
use super::monitor::{DriveRecorder, Monitor};
use crate::{Drive, LinkError};

/// Session number of a drive: a lost connection ends the run, or goes on in the same session.
pub(super) const SESSION: u32 = 1;
/// Shortest time between two attempts to connect again.
const RETRY: Duration = Duration::from_millis(100);

/// A robot of `N` joints behind its maker's interface: what differs from maker to maker.
pub trait Interface<const N: usize>: Send {
    /// Why its client fails.
    type Error: std::error::Error + Send + Sync + 'static;

    /// Carries out the command that answers the last state: torques, N m, or none.
    fn carry_out(&mut self, course: &mut Course, tau: Option<[f64; N]>) -> Result<(), Self::Error>;

    /// Follows these angles, rad, if the handshake says that the robot can.
    fn follow(&mut self, course: &mut Course, _q: [f64; N]) -> Result<(), Self::Error> {
        self.carry_out(course, None)
    }

    /// Waits for the next state, and notes it in `course`.
    fn receive(&mut self, course: &mut Course) -> Result<(), Self::Error>;

    /// What is to be done about a state before it is reported.
    fn settle(&mut self, _course: &mut Course) -> Result<(), Self::Error> {
        Ok(())
    }

    /// Angles (rad), speeds (rad/s) and torques (N m) of the newest state.
    fn measured(&self) -> [[f64; N]; 3];

    /// What the newest state means for the controller.
    fn status(&self, course: &Course) -> DriveStatus;

    /// The time without a state, if the error says no more than that.
    fn silence(error: &mut Self::Error) -> Option<&mut Duration>;

    /// Whether the error only loses the connection.
    fn loses_connection(_error: &Self::Error) -> bool {
        false
    }

    /// Whether another attempt to connect cannot help.
    fn is_final(_error: &Self::Error) -> bool {
        true
    }

    /// Whether there is a connection. A session without one, such as that of datagrams, loses none.
    fn is_connected(&self) -> bool {
        true
    }

    /// Closes the connection.
    fn close(&mut self, _course: &mut Course) {}

    /// Connects again.
    fn connect(&mut self) -> Result<(), Self::Error> {
        Ok(())
    }
}

/// Where a drive stands: its ticks, its pauses, and how long the robot has been silent.
pub struct Course {
    pub(super) tick: u64,
    missed: u32,
    /// No motion is started before this tick.
    resume_at: u64,
    pause_ticks: u64,
    /// How long the robot has been silent.
    pub(super) silent: Duration,
    period_us: u32,
    machine: Arc<dyn Machine>,
    pub(super) recorder: DriveRecorder,
}

impl Course {
    /// A course of this period that pauses for so many ticks between a stop and the next attempt to move: the host sees the
    /// fault first.
    pub(super) fn new(period_us: u32, pause_ticks: u64, machine: &Arc<dyn Machine>) -> Self {
        Self {
            tick: 0,
            missed: 0,
            resume_at: 0,
            pause_ticks,
            silent: Duration::ZERO,
            period_us,
            machine: Arc::clone(machine),
            recorder: DriveRecorder::new(period_us, Arc::clone(machine)),
        }
    }

    /// Whether the pause after the last stop is over.
    pub(super) fn may_start(&self) -> bool {
        self.tick >= self.resume_at
    }

    /// Begins the pause after a stop.
    pub(super) fn pause(&mut self) {
        self.resume_at = self.tick + self.pause_ticks;
    }

    /// The robot does not move, or not any more.
    pub(super) fn refused(&mut self, event: DriveEvent) {
        self.pause();
        self.recorder.event(event);
    }

    /// A state came, `missed` periods after the one that was expected. While nothing is commanded, a state that was not read is
    /// no missed period.
    pub(super) fn arrived(&mut self, commanding: bool, missed: u64) {
        self.missed = if commanding {
            u32::try_from(missed).unwrap_or(u32::MAX)
        } else {
            0
        };
        self.recorder.state(commanding, self.missed);
        self.tick += 1 + u64::from(self.missed);
        if !std::mem::take(&mut self.silent).is_zero() {
            self.recorder.event(DriveEvent::Back);
        }
    }

    /// No state came for this long.
    fn heard_nothing(&mut self, after: Duration) {
        if self.silent.is_zero() {
            self.recorder.event(DriveEvent::Silent(after));
        }
        self.recorder.pause();
        self.silent += after;
        let periods = periods(after, self.period_us);
        self.missed = periods - 1;
        self.tick += u64::from(periods);
    }
}

/// A robot as a drive.
pub struct InterfaceDrive<R, const N: usize> {
    robot: R,
    hello: DriveHello,
    course: Course,
    /// The command for this period was carried out.
    answered: bool,
}

impl<R: Interface<N>, const N: usize> InterfaceDrive<R, N> {
    pub(super) fn new(robot: R, hello: DriveHello, course: Course) -> Self {
        Self {
            robot,
            hello,
            course,
            answered: false,
        }
    }

    pub(super) fn robot(&self) -> &R {
        &self.robot
    }

    fn carry_out(&mut self, command: Option<&DriveCommand>) -> Result<(), LinkError> {
        let values = |joints: &Joints| {
            <[f64; N]>::try_from(joints.as_slice()).map_err(|_| LinkError::Torques {
                found: joints.len(),
                joints: N,
            })
        };
        let enabled = command.filter(|command| command.enable);
        let carried_out = match enabled {
            Some(command) if !command.follow.is_empty() => {
                self.robot.follow(&mut self.course, values(&command.follow)?)
            }
            _ => {
                let tau = command.map(|command| values(&command.tau)).transpose()?;
                self.robot
                    .carry_out(&mut self.course, tau.filter(|_| enabled.is_some()))
            }
        };
        self.survive(carried_out)
    }

    /// Takes an error that only loses the connection; others are for good.
    fn survive(&mut self, result: Result<(), R::Error>) -> Result<(), LinkError> {
        match result {
            Ok(()) => {}
            Err(error) if R::loses_connection(&error) => {
                self.robot.close(&mut self.course);
                self.course.pause();
            }
            Err(mut error) => {
                // A robot that fell silent meanwhile: the next receive tells.
                if R::silence(&mut error).is_none() {
                    return Err(LinkError::device(error));
                }
            }
        }
        Ok(())
    }

    fn reconnect(&mut self) -> Result<(), LinkError> {
        let course = &mut self.course;
        let machine = Arc::clone(&course.machine);
        let begun = machine.now();
        let elapsed = || machine.now().saturating_duration_since(begun);
        match self.robot.connect() {
            Ok(()) => {
                course.pause();
                course.recorder.record.reconnects += 1;
                course.recorder.event(DriveEvent::Reconnected);
            }
            Err(error) if R::is_final(&error) || course.silent + elapsed() > GIVE_UP => {
                return Err(LinkError::device(error));
            }
            Err(_) => machine.sleep(RETRY.saturating_sub(elapsed())),
        }
        course.heard_nothing(elapsed());
        Ok(())
    }
}

impl<R: Interface<N>, const N: usize> Drive for InterfaceDrive<R, N> {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.course.missed = 0;
        if !std::mem::take(&mut self.answered) {
            self.carry_out(command)?;
        }
        if !self.robot.is_connected() {
            return self.reconnect();
        }
        if let Err(mut error) = self.robot.receive(&mut self.course) {
            if let Some(after) = R::silence(&mut error) {
                self.course.heard_nothing(*after);
                *after = self.course.silent;
                return if self.course.silent > GIVE_UP {
                    Err(LinkError::device(error))
                } else {
                    Ok(())
                };
            }
            self.survive(Err(error))?;
            return self.reconnect();
        }
        let settled = self.robot.settle(&mut self.course);
        self.survive(settled)?;
        state.session = self.hello.session;
        state.tick = self.course.tick;
        let [q, dq, tau] = self.robot.measured();
        for (joints, values) in [(&mut state.q, q), (&mut state.dq, dq), (&mut state.tau, tau)] {
            joints.clear();
            // They fit: a message carries up to MAX_JOINTS.
            let _ = joints.extend_from_slice(&values);
        }
        state.status = self.robot.status(&self.course);
        Ok(())
    }

    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        self.carry_out(Some(command))?;
        self.answered = true;
        Ok(())
    }

    fn missed(&self) -> u32 {
        self.course.missed
    }

    fn monitor(&self) -> Option<Monitor> {
        Some(self.course.recorder.monitor())
    }

    fn timing(&self) -> Option<LoopTiming> {
        Some(LoopTiming::from(&self.course.recorder.record))
    }
}

/// Periods of `period_us` that passed in this time, at least one.
pub(super) fn periods(time: Duration, period_us: u32) -> u32 {
    let count = time.as_micros() / u128::from(period_us.max(1));
    u32::try_from(count).unwrap_or(u32::MAX).max(1)
}
