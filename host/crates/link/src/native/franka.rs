//! A Panda or an FR3 behind the Franka Control Interface.

use std::time::Duration;

use spherecal_fci::PERIOD_S;
use spherecal_fci::client::{Client, ClientError};
use spherecal_fci::robot::ArmLimits as FrankaLimits;
use spherecal_fci::wire::{RobotMode, RobotState, Status, Version};
use spherecal_shared::protocol::drive::{DriveHello, DriveStatus};

use super::drive::{Course, Interface, InterfaceDrive, SESSION};
use super::franka_setup::{FrankaOptions, joint_limits, open, own_limits};
use super::{DriveEvent, JOINTS, PAUSE_TICKS};
use crate::LinkError;

/// Control period, in µs.
const PERIOD_US: u32 = (PERIOD_S * 1e6) as u32;
/// Ticks that the robot has for an error recovery before the drive asks again.
const RECOVERY_TICKS: u64 = 15_000;
/// Error recoveries without a motion between them before a person is needed.
const RECOVERIES: u32 = 3;

/// A Franka robot as a drive.
///
/// - A command with `enable` starts a torque motion if none runs. That command's torque is not sent: it was computed for
///   a state before the motion.
/// - A command without `enable`, or none, stops the motion. The robot then holds its pose.
/// - A reflex ends the motion. After a second the drive asks for the error recovery, at most three times in a row.
/// - A cable that is out for less than a minute, and a robot that restarts, end the motion; the drive connects again.
pub type FrankaDrive = InterfaceDrive<Franka, JOINTS>;

/// A Franka robot behind its interface.
pub struct Franka {
    options: FrankaOptions,
    /// `None` while the connection is lost.
    client: Option<Client>,
    state: RobotState,
    /// Since when the robot has been in its reflex, and whether recovery was asked for.
    reflex: Option<(u64, bool)>,
    recoveries_in_row: u32,
}

impl FrankaDrive {
    /// Connects, declares load and thresholds, and asks for the robot's own model: its joint limits count, those of the
    /// data sheet where the interface has no model. Nothing moves.
    ///
    /// # Errors
    /// The robot cannot be reached, speaks another version, or refuses a setting.
    pub fn connect(options: FrankaOptions) -> Result<Self, LinkError> {
        let mut client = open(&options).map_err(LinkError::device)?;
        let mut course = Course::new(PERIOD_US, PAUSE_TICKS, &options.config.machine);
        let limits = match own_limits(&mut client).map_err(LinkError::device)? {
            Some(Ok(limits)) => limits,
            Some(Err(error)) => {
                course.recorder.event(DriveEvent::ModelUnread(error));
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
        let robot = Franka {
            options,
            client: Some(client),
            state: RobotState::default(),
            reflex: None,
            recoveries_in_row: 0,
        };
        Ok(Self::new(robot, hello, course))
    }

    /// The version of the interface that was agreed on; `None` while the connection is lost.
    pub fn version(&self) -> Option<Version> {
        self.robot().client.as_ref().map(Client::version)
    }
}

impl Franka {
    fn is_moving(&self) -> bool {
        self.client.as_ref().is_some_and(Client::is_moving)
    }

    fn start(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        if !course.may_start() || self.state.robot_mode != RobotMode::Idle {
            return Ok(());
        }
        course.recorder.pause();
        match client.start_torque_motion() {
            Ok(()) => {
                self.recoveries_in_row = 0;
                course.recorder.event(DriveEvent::Started);
            }
            Err(ClientError::NotReady { mode, errors }) => course.refused(DriveEvent::FrankaNotReady { mode, errors }),
            Err(ClientError::Refused { mode, .. }) => {
                let errors = self.state.errors.with(self.state.reflex_reason);
                course.refused(DriveEvent::FrankaNotReady { mode, errors });
            }
            Err(ClientError::Ended(end)) => course.refused(DriveEvent::FrankaEnded(end)),
            Err(error) => return Err(error),
        }
        Ok(())
    }
}

impl Interface<JOINTS> for Franka {
    type Error = ClientError;

    fn carry_out(&mut self, course: &mut Course, tau: Option<[f64; JOINTS]>) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        let Some(tau) = tau else {
            // While the robot is silent nothing can be stopped; it stops itself, because commands stay away.
            if client.is_moving() && course.silent.is_zero() {
                course.recorder.pause();
                return match client.stop() {
                    Err(ClientError::Refused { .. }) => Ok(()),
                    result => result,
                };
            }
            return Ok(());
        };
        if !client.is_moving() {
            return self.start(course);
        }
        match client.command(&tau) {
            Ok(cycle) => {
                course.recorder.answered(cycle.rate_limited, cycle.torque_limited);
                Ok(())
            }
            // The newest state was answered before the robot fell silent.
            Err(ClientError::NothingToAnswer) => Ok(()),
            Err(error) => Err(error),
        }
    }

    fn receive(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        match client.receive(&mut self.state) {
            Ok(missed) => course.arrived(self.is_moving(), missed),
            Err(ClientError::Ended(end)) => {
                course.arrived(self.is_moving(), 0);
                course.recorder.record.stops += 1;
                course.refused(DriveEvent::FrankaEnded(end));
            }
            Err(error) => return Err(error),
        }
        Ok(())
    }

    /// Asks for the error recovery once the reflex has lasted for a while.
    fn settle(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let Some(client) = self
            .client
            .as_mut()
            .filter(|_| self.state.robot_mode == RobotMode::Reflex)
        else {
            self.reflex = None;
            return Ok(());
        };
        let (mut since, mut asked) = *self.reflex.get_or_insert((course.tick, false));
        if asked && let Some(status) = client.recovery_answer()?.filter(|status| *status != Status::Success) {
            // Refused: the next attempt after a pause, unless the robot says that none can help.
            (since, asked) = (course.tick, false);
            if status == Status::ManualRecoveryRequired {
                self.recoveries_in_row = RECOVERIES;
            }
            self.reflex = Some((since, asked));
        }
        let waited = course.tick - since;
        if (asked && waited < RECOVERY_TICKS) || waited < PAUSE_TICKS || self.recoveries_in_row > RECOVERIES {
            return Ok(());
        }
        self.recoveries_in_row += 1;
        self.reflex = Some((course.tick, true));
        if self.recoveries_in_row > RECOVERIES {
            let errors = self.state.errors.with(self.state.reflex_reason);
            course.recorder.event(DriveEvent::PersonNeeded(errors));
            return Ok(());
        }
        course.recorder.record.recoveries += 1;
        course.recorder.event(DriveEvent::Recovering);
        client.request_recovery()
    }

    fn measured(&self) -> [[f64; JOINTS]; 3] {
        [self.state.q, self.state.dq, self.state.tau_J]
    }

    fn status(&self, course: &Course) -> DriveStatus {
        match self.state.robot_mode {
            RobotMode::Move if self.is_moving() => DriveStatus::Ready,
            RobotMode::Idle if course.may_start() => DriveStatus::Ready,
            RobotMode::Reflex => DriveStatus::Failed,
            RobotMode::UserStopped => DriveStatus::EmergencyStop,
            _ => DriveStatus::Disabled,
        }
    }

    fn silence(error: &mut ClientError) -> Option<&mut Duration> {
        match error {
            ClientError::Silent { after } => Some(after),
            _ => None,
        }
    }

    fn loses_connection(error: &ClientError) -> bool {
        matches!(
            error,
            ClientError::Closed | ClientError::Io { .. } | ClientError::NoResponse { .. }
        )
    }

    fn is_final(error: &ClientError) -> bool {
        matches!(error, ClientError::Version { .. } | ClientError::Wire(_))
    }

    fn is_connected(&self) -> bool {
        self.client.is_some()
    }

    fn close(&mut self, _course: &mut Course) {
        self.client = None;
    }

    fn connect(&mut self) -> Result<(), ClientError> {
        self.client = Some(open(&self.options)?);
        Ok(())
    }
}
