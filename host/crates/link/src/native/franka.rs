//! A Panda or an FR3 behind the Franka Control Interface.

use std::sync::Arc;
use std::time::Duration;

use spherecal_fci::PERIOD_S;
use spherecal_fci::client::{Client, ClientError};
use spherecal_fci::robot::ArmLimits as FrankaLimits;
use spherecal_fci::wire::{RobotMode, RobotState, Status, Version};
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::LoopTiming;

use super::franka_setup::{FrankaOptions, joint_limits, open, own_limits};
use super::monitor::{DriveRecorder, Monitor};
use super::{DriveEvent, JOINTS, PAUSE_TICKS, fill, periods, torques};
use crate::{Drive, LinkError};
use spherecal_budget::robot::GIVE_UP;

/// Session number of the drive: a lost connection ends the run, or goes on in the
/// same session.
const SESSION: u32 = 1;
/// Control period, in µs.
const PERIOD_US: u32 = (PERIOD_S * 1e6) as u32;
/// Ticks that the robot has for an error recovery before the drive asks again.
const RECOVERY_TICKS: u64 = 15_000;
/// Error recoveries without a motion between them before a person is needed.
const RECOVERIES: u32 = 3;
/// Shortest time between two attempts to connect again.
const RETRY: Duration = Duration::from_millis(100);
/// A Franka robot as a drive.
///
/// - A command with `enable` starts a torque motion if none runs. That command's torque is not sent: it was computed for
///   a state before the motion.
/// - A command without `enable`, or none, stops the motion. The robot then holds its pose.
/// - A reflex ends the motion. After a second the drive asks for the error recovery, at most three times in a row.
/// - A cable that is out for less than a minute, and a robot that restarts, end the motion; the drive connects again.
pub struct FrankaDrive {
    options: FrankaOptions,
    /// `None` while the connection is lost.
    client: Option<Client>,
    hello: DriveHello,
    state: RobotState,
    tick: u64,
    missed: u32,
    /// The command for this period was carried out.
    answered: bool,
    /// No motion is started before this tick.
    resume_at: u64,
    /// How long the robot has been silent.
    silent: Duration,
    /// Since when the robot has been in its reflex, and whether recovery was asked for.
    reflex: Option<(u64, bool)>,
    recoveries_in_row: u32,
    recorder: DriveRecorder,
}

impl FrankaDrive {
    /// Connects, declares load and thresholds, and asks for the robot's own model: its joint limits count, those of the
    /// data sheet where the interface has no model. Nothing moves.
    ///
    /// # Errors
    /// The robot cannot be reached, speaks another version, or refuses a setting.
    pub fn connect(options: FrankaOptions) -> Result<Self, LinkError> {
        let mut client = open(&options).map_err(LinkError::device)?;
        let mut recorder = DriveRecorder::new(PERIOD_US, Arc::clone(&options.config.machine));
        let limits = match own_limits(&mut client).map_err(LinkError::device)? {
            Some(Ok(limits)) => limits,
            Some(Err(error)) => {
                recorder.event(DriveEvent::ModelUnread(error));
                *FrankaLimits::of(client.version())
            }
            None => *FrankaLimits::of(client.version()),
        };
        let hello = DriveHello {
            period_us: PERIOD_US,
            compensates_gravity: true,
            motor_kg_m2: options.undeclared.motor_kg_m2.clone(),
            latency_us: options.undeclared.latency_us,
            // No control unit is on this computer: what answers from here is a simulation.
            simulated: client.peer().is_loopback(),
            ..DriveHello::new(SESSION, joint_limits(&limits))
        };
        Ok(Self {
            options,
            client: Some(client),
            hello,
            state: RobotState::default(),
            tick: 0,
            missed: 0,
            answered: false,
            resume_at: 0,
            silent: Duration::ZERO,
            reflex: None,
            recoveries_in_row: 0,
            recorder,
        })
    }

    /// The version of the interface that was agreed on; `None` while the connection is lost.
    pub fn version(&self) -> Option<Version> {
        self.client.as_ref().map(Client::version)
    }

    /// Carries out the command that answers the last state.
    fn carry_out(&mut self, command: Option<&DriveCommand>) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        let Some(tau) = command.filter(|c| c.enable).map(|c| &c.tau) else {
            // While the robot is silent nothing can be stopped; it stops itself, because commands stay away.
            if client.is_moving() && self.silent.is_zero() {
                self.recorder.pause();
                return match client.stop() {
                    Err(ClientError::Refused { .. }) => Ok(()),
                    result => result,
                };
            }
            return Ok(());
        };
        if !client.is_moving() {
            return self.start();
        }
        // A wrong number of torques was refused before.
        let Ok(tau) = torques(tau) else { return Ok(()) };
        match client.command(&tau) {
            Ok(cycle) => {
                self.recorder.answered(cycle.rate_limited, cycle.torque_limited);
                Ok(())
            }
            // The newest state was answered before the robot fell silent.
            Err(ClientError::NothingToAnswer) => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn start(&mut self) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        if self.tick < self.resume_at || self.state.robot_mode != RobotMode::Idle {
            return Ok(());
        }
        self.recorder.pause();
        match client.start_torque_motion() {
            Ok(()) => {
                self.recoveries_in_row = 0;
                self.recorder.event(DriveEvent::Started);
                Ok(())
            }
            Err(ClientError::NotReady { mode, errors }) => {
                self.refused(DriveEvent::FrankaNotReady { mode, errors });
                Ok(())
            }
            Err(ClientError::Refused { mode, .. }) => {
                let errors = self.state.errors.with(self.state.reflex_reason);
                self.refused(DriveEvent::FrankaNotReady { mode, errors });
                Ok(())
            }
            Err(ClientError::Ended(end)) => {
                self.refused(DriveEvent::FrankaEnded(end));
                Ok(())
            }
            Err(error) => Err(error),
        }
    }

    fn refused(&mut self, event: DriveEvent) {
        self.resume_at = self.tick + PAUSE_TICKS;
        self.recorder.event(event);
    }

    /// A state came.
    fn arrived(&mut self, missed: u64) {
        let moving = self.client.as_ref().is_some_and(Client::is_moving);
        // With closed brakes a state that was not read is no missed period.
        self.missed = if moving {
            u32::try_from(missed).unwrap_or(u32::MAX)
        } else {
            0
        };
        self.recorder.state(moving, self.missed);
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
        let periods = periods(after, PERIOD_US);
        self.missed = periods - 1;
        self.tick += u64::from(periods);
    }

    /// Closes the connection: [`reconnect`](Self::reconnect) makes a new one.
    fn lose(&mut self) {
        self.client = None;
        self.resume_at = self.tick + PAUSE_TICKS;
    }

    fn reconnect(&mut self) -> Result<(), LinkError> {
        let machine = Arc::clone(&self.options.config.machine);
        let begun = machine.now();
        let elapsed = || machine.now().saturating_duration_since(begun);
        match open(&self.options) {
            Ok(client) => {
                self.client = Some(client);
                self.resume_at = self.tick + PAUSE_TICKS;
                self.recorder.record.reconnects += 1;
                self.recorder.event(DriveEvent::Reconnected);
            }
            Err(error @ (ClientError::Version { .. } | ClientError::Wire(_))) => return Err(LinkError::device(error)),
            Err(error) if self.silent + elapsed() > GIVE_UP => return Err(LinkError::device(error)),
            Err(_) => machine.sleep(RETRY.saturating_sub(elapsed())),
        }
        self.heard_nothing(elapsed());
        Ok(())
    }

    /// Asks for the error recovery once the reflex has lasted for a while.
    fn recover(&mut self) -> Result<(), ClientError> {
        let Some(client) = self
            .client
            .as_mut()
            .filter(|_| self.state.robot_mode == RobotMode::Reflex)
        else {
            self.reflex = None;
            return Ok(());
        };
        let (mut since, mut asked) = *self.reflex.get_or_insert((self.tick, false));
        if asked && let Some(status) = client.recovery_answer()?.filter(|status| *status != Status::Success) {
            // Refused: the next attempt after a pause, unless the robot says that none can help.
            (since, asked) = (self.tick, false);
            if status == Status::ManualRecoveryRequired {
                self.recoveries_in_row = RECOVERIES;
            }
            self.reflex = Some((since, asked));
        }
        let waited = self.tick - since;
        if (asked && waited < RECOVERY_TICKS) || waited < PAUSE_TICKS || self.recoveries_in_row > RECOVERIES {
            return Ok(());
        }
        self.recoveries_in_row += 1;
        self.reflex = Some((self.tick, true));
        if self.recoveries_in_row > RECOVERIES {
            let errors = self.state.errors.with(self.state.reflex_reason);
            self.recorder.event(DriveEvent::PersonNeeded(errors));
            return Ok(());
        }
        self.recorder.record.recoveries += 1;
        self.recorder.event(DriveEvent::Recovering);
        client.request_recovery()
    }

    fn status(&self) -> DriveStatus {
        let moving = self.client.as_ref().is_some_and(Client::is_moving);
        match self.state.robot_mode {
            RobotMode::Move if moving => DriveStatus::Ready,
            RobotMode::Idle if self.tick >= self.resume_at => DriveStatus::Ready,
            RobotMode::Reflex => DriveStatus::Failed,
            RobotMode::UserStopped => DriveStatus::EmergencyStop,
            _ => DriveStatus::Disabled,
        }
    }

    /// Takes an error that only loses the connection; others are for good.
    fn survive(&mut self, result: Result<(), ClientError>) -> Result<(), LinkError> {
        match result {
            Ok(()) => Ok(()),
            Err(ClientError::Closed | ClientError::Io { .. } | ClientError::NoResponse { .. }) => {
                self.lose();
                Ok(())
            }
            // The robot fell silent meanwhile: the next receive tells.
            Err(ClientError::Silent { .. }) => Ok(()),
            Err(error) => Err(LinkError::device(error)),
        }
    }
}

impl Drive for FrankaDrive {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.missed = 0;
        if !std::mem::take(&mut self.answered) {
            if let Some(command) = command {
                torques::<JOINTS>(&command.tau)?;
            }
            let carried_out = self.carry_out(command);
            self.survive(carried_out)?;
        }
        let Some(client) = &mut self.client else {
            return self.reconnect();
        };
        match client.receive(&mut self.state) {
            Ok(missed) => self.arrived(missed),
            Err(ClientError::Ended(end)) => {
                self.arrived(0);
                self.recorder.record.stops += 1;
                self.resume_at = self.tick + PAUSE_TICKS;
                self.recorder.event(DriveEvent::FrankaEnded(end));
            }
            Err(ClientError::Silent { after }) => {
                self.heard_nothing(after);
                if self.silent > GIVE_UP {
                    return Err(LinkError::device(ClientError::Silent { after: self.silent }));
                }
                return Ok(());
            }
            Err(error) => {
                self.survive(Err(error))?;
                return self.reconnect();
            }
        }
        let recovered = self.recover();
        self.survive(recovered)?;
        state.session = self.hello.session;
        state.tick = self.tick;
        fill(&mut state.q, &self.state.q);
        fill(&mut state.dq, &self.state.dq);
        fill(&mut state.tau, &self.state.tau_J);
        state.status = self.status();
        Ok(())
    }

    fn answer(&mut self, command: &DriveCommand) -> Result<(), LinkError> {
        torques::<JOINTS>(&command.tau)?;
        let carried_out = self.carry_out(Some(command));
        self.survive(carried_out)?;
        self.answered = true;
        Ok(())
    }

    fn missed(&self) -> u32 {
        self.missed
    }

    fn monitor(&self) -> Option<Monitor> {
        Some(self.recorder.monitor())
    }

    fn timing(&self) -> Option<LoopTiming> {
        Some(LoopTiming::from(&self.recorder.record))
    }
}
