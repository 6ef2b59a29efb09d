//! A Panda or an FR3 behind the Franka Control Interface.

use std::time::Duration;

use spherecal_fci::PERIOD_S;
use spherecal_fci::client::{Client, ClientConfig, ClientError};
use spherecal_fci::robot::{ArmLimits as FrankaLimits, ModelError};
use spherecal_fci::wire::{CollisionBehavior, FlangeLoad, RobotMode, RobotState, Status, Version};
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveHello, DriveStatus};
use spherecal_shared::robot::{Inertia, JointLimits};

use super::drive::{Course, Interface, InterfaceDrive, SESSION};
use super::{DriveEvent, JOINTS, PAUSE_TICKS, Undeclared};
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

/// Distance from the axis of joints 1 to 4, and 5 to 7, to the farthest contact, in m: it turns a threshold of the
/// force into one of the torque.
const LEVER_M: [f64; JOINTS] = [0.9, 0.9, 0.9, 0.9, 0.35, 0.35, 0.35];

/// What the drive tells the robot before the first motion.
#[derive(Clone, Debug)]
pub struct FrankaOptions {
    /// The connection.
    pub config: ClientConfig,
    /// Mass distribution of the calibration tool in the flange frame.
    pub load: Inertia,
    /// Thresholds of contact and collision, see [`collision_behavior`].
    pub thresholds: CollisionBehavior,
    /// What the handshake adds to what the robot says.
    pub undeclared: Undeclared,
}

/// Thresholds of the robot for this procedure. The robot reports a contact from the force that triggers the approach
/// (`approach.trigger_n`) on. Its reflex stands at one and a half times the force at which the controller stops the arm
/// (`limits.force_n`): the pull that releases the nest passes, and the controller reacts first.
pub fn collision_behavior(procedure: &Procedure) -> CollisionBehavior {
    let limits = FrankaLimits::PANDA.torque;
    let (contact, collision) = (procedure.approach.trigger_n, 1.5 * procedure.limits.force_n);
    let torque = |force: f64| std::array::from_fn(|j| (force * LEVER_M[j]).min(limits[j]));
    // Moments at the end effector act with the lever of the wrist.
    let force = |force: f64| {
        let moment = force * LEVER_M[JOINTS - 1];
        [force, force, force, moment, moment, moment]
    };
    CollisionBehavior::uniform(torque(contact), torque(collision), force(contact), force(collision))
}

/// Connects; clears a reflex of earlier; declares load and thresholds.
pub(super) fn open(options: &FrankaOptions) -> Result<Client, ClientError> {
    let mut client = Client::connect(&options.config)?;
    let mut state = RobotState::default();
    client.receive(&mut state)?;
    if state.robot_mode == RobotMode::Reflex {
        client.recover()?;
    }
    client.set_load(&load(&options.load))?;
    client.set_collision_behavior(&options.thresholds)?;
    Ok(client)
}

fn load(body: &Inertia) -> FlangeLoad {
    let [xx, yy, zz, xy, xz, yz] = body.inertia_kg_m2;
    FlangeLoad {
        mass: body.mass_kg,
        centre_of_mass: body.com_m,
        inertia: [xx, xy, xz, xy, yy, yz, xz, yz, zz],
    }
}

/// The limits that the robot states in its own model; `None` where the version has no model.
pub(super) fn own_limits(client: &mut Client) -> Result<Option<Result<FrankaLimits, ModelError>>, ClientError> {
    match client.robot_model() {
        Ok(model) => Ok(model.map(|text| FrankaLimits::from_urdf(&text))),
        // A robot that does not tell has the limits of its data sheet.
        Err(ClientError::Refused { .. }) => Ok(None),
        Err(error) => Err(error),
    }
}

pub(super) fn joint_limits(limits: &FrankaLimits) -> heapless::Vec<JointLimits, { spherecal_shared::MAX_JOINTS }> {
    let joint = |j: usize| JointLimits {
        min_rad: limits.lower[j],
        max_rad: limits.upper[j],
        velocity_rad_s: limits.velocity[j],
        torque_nm: limits.torque[j],
    };
    (0..JOINTS).map(joint).collect()
}
