//! An e-Series robot of Universal Robots, or a newer one, behind RTDE and a program of ours.

use std::time::Duration;

use spherecal_shared::protocol::drive::{DriveHello, DriveStatus};
use spherecal_shared::robot::{Arm, Dynamics as _};
use spherecal_ur::JOINTS;
use spherecal_ur::client::{ClientError, DashboardCommand, ProgramEnd, TorqueClient, TorqueState, Unready};
use spherecal_ur::wire::{Order, SafetyMode};

use super::DriveEvent;
use super::drive::{Course, Interface, InterfaceDrive, SESSION, periods};
use super::ur_start::{Sent, UrError, UrOptions, begin, start};
use crate::LinkError;

const PERIOD_S: f64 = TorqueClient::period_s();
const PERIOD_US: u32 = (PERIOD_S * 1e6) as u32;
/// Periods in a second: the pause between an end and the next start. The host sees the fault first.
const PAUSE_TICKS: u64 = 1_000_000 / PERIOD_US as u64;
/// Periods of a protective stop before the robot is asked to end it. It refuses for 5 s.
const UNLOCK_TICKS: u64 = 11 * PAUSE_TICKS / 2;
/// How often in a row it is asked, without torques between them.
const UNLOCKS: u32 = 3;

/// A robot of Universal Robots as a drive.
///
/// - Our program runs on the robot from the connection on. Without `enable` it holds the pose by the robot's own position
///   control, which also follows the angles of a motion through free space.
/// - The measured torques are those of the motors. What accelerates the declared motors is taken off, and the gravity of
///   model and tool is added: that is what acts on the links.
/// - A stop ends the program. After a protective stop the drive asks the dashboard, or on PolyScope X the Robot API, to end it, at
///   most three times in a row;
///   other stops are a person's. As soon as the robot is ready, the next command with `enable` starts the program anew.
/// - A cable that is out for less than a minute, and a robot that restarts, end the program; the drive connects again.
pub type UrDrive = InterfaceDrive<Ur, JOINTS>;

/// A robot of Universal Robots behind its interfaces.
pub struct Ur {
    options: UrOptions,
    /// `None` while the connection is lost.
    client: Option<TorqueClient>,
    arm: Arm<f64, JOINTS>,
    limits: [f64; JOINTS],
    motors: [f64; JOINTS],
    state: TorqueState,
    before: TorqueState,
    sent: Sent,
    /// A start has read its first state.
    begun: bool,
    /// Our program runs.
    runs: bool,
    /// The last command was torques or angles.
    follows: bool,
    /// Since when the robot has been stopped.
    stopped_at: Option<u64>,
    unlocks: u32,
}

impl UrDrive {
    /// Connects, starts the program and measures the delay of the wire. Nothing moves.
    ///
    /// # Errors
    /// The robot cannot be reached, is not ready, has no torques, or does not run the program; another client uses it.
    pub fn connect(options: UrOptions) -> Result<Self, LinkError> {
        if options.robot.dof() != JOINTS {
            return Err(LinkError::OtherRobot {
                drive: JOINTS,
                robot: options.robot.dof(),
            });
        }
        Self::open(options).map_err(LinkError::device)
    }

    fn open(options: UrOptions) -> Result<Self, UrError> {
        let UrOptions { robot, undeclared, .. } = &options;
        let arm = Arm::new(robot, &options.tool)?;
        let mut client = options.open()?;
        let (mut state, mut sent) = (TorqueState::default(), Sent::default());
        let latency_us = begin(&mut client, &mut state, &mut sent)?.max(undeclared.latency_us);
        let motors = &undeclared.motor_kg_m2;
        let hello = DriveHello {
            period_us: PERIOD_US,
            compensates_gravity: true,
            motor_kg_m2: motors.clone(),
            latency_us,
            follows: true,
            // No controller is on this computer: what answers from here is a simulation.
            simulated: client.is_local(),
            ..DriveHello::new(SESSION, robot.joints.iter().map(|joint| joint.limits))
        };
        let course = Course::new(PERIOD_US, PAUSE_TICKS, &options.config.machine);
        let robot = Ur {
            arm,
            limits: std::array::from_fn(|j| robot.joints.get(j).map_or(0.0, |joint| joint.limits.torque_nm)),
            motors: std::array::from_fn(|j| motors.get(j).copied().unwrap_or(0.0)),
            client: Some(client),
            before: state,
            state,
            sent,
            begun: false,
            runs: true,
            follows: false,
            stopped_at: None,
            unlocks: 0,
            options,
        };
        Ok(Self::new(robot, hello, course))
    }
}

impl Ur {
    /// Starts the program anew, and waits until it runs.
    fn start(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let Some(client) = self.client.as_mut().filter(|_| course.may_start()) else {
            return Ok(());
        };
        if self.state.robot.ready().is_err() || self.state.robot.program().is_some() {
            return Ok(());
        }
        course.recorder.pause();
        self.runs = start(client, &mut self.state, &mut self.sent)?;
        self.begun = true;
        if self.runs {
            self.unlocks = 0;
        } else {
            course.refused(DriveEvent::UrNotStarted);
        }
        Ok(())
    }

    /// A state came.
    fn arrived(&mut self, course: &mut Course) {
        let robot = &self.state.robot;
        let passed = (robot.timestamp - self.before.robot.timestamp) / PERIOD_S;
        let passed = passed.round().clamp(1.0, 1e9) as u32;
        // The periods of a silence are counted.
        let counted = if course.silent.is_zero() {
            0
        } else {
            periods(course.silent, PERIOD_US)
        };
        course.arrived(self.follows, passed.saturating_sub(1 + counted).into());
        let unready = robot.ready().err();
        if self.runs && (unready.is_some() || robot.program().is_none()) {
            course.recorder.record.stops += 1;
            course.recorder.event(DriveEvent::UrEnded(
                unready.map_or(ProgramEnd::Ended, ProgramEnd::Unready),
            ));
            self.ended(course);
        }
        self.unlock(course, unready);
    }

    /// The program does not run any more.
    fn ended(&mut self, course: &mut Course) {
        (self.runs, self.follows) = (false, false);
        course.pause();
        course.recorder.pause();
    }

    /// Asks the robot to end a protective stop, once it permits it.
    fn unlock(&mut self, course: &mut Course, unready: Option<Unready>) {
        let protective = Unready::Stopped(SafetyMode::ProtectiveStop.number());
        let Some(unready) = unready.filter(|unready| *unready == protective) else {
            self.stopped_at = None;
            return;
        };
        let since = *self.stopped_at.get_or_insert(course.tick);
        if course.tick - since < UNLOCK_TICKS || self.unlocks > UNLOCKS {
            return;
        }
        self.stopped_at = Some(course.tick);
        self.unlocks += 1;
        if self.unlocks > UNLOCKS {
            course.recorder.event(DriveEvent::UrPersonNeeded(unready));
            return;
        }
        course.recorder.record.recoveries += 1;
        course.recorder.event(DriveEvent::UrUnlocking);
        let commands = [
            DashboardCommand::CloseSafetyPopup,
            DashboardCommand::UnlockProtectiveStop,
        ];
        // Whether it helped, the robot's state tells. One that does not answer is asked again.
        let asked = self.client.as_ref().map(|client| client.ask(&commands));
        if let Some(Err(ClientError::RobotApi { status, .. })) = asked {
            course.recorder.event(DriveEvent::UrUnlockRefused(status));
        }
    }

    /// Orders this of the program; one that does not run is started. `limited`: a torque was beyond its limit.
    fn order(&mut self, course: &mut Course, order: &Order, limited: bool) -> Result<(), ClientError> {
        let follows = *order != Order::Listen;
        if follows && !self.runs {
            return self.start(course);
        }
        let Some(client) = &mut self.client else { return Ok(()) };
        // While the robot is silent there is nothing to answer: its program ends by itself.
        if !course.silent.is_zero() {
            return Ok(());
        }
        self.sent.note(client.send(order)?, self.state.robot.timestamp);
        if follows {
            if !self.follows {
                course.recorder.event(DriveEvent::Started);
            }
            course.recorder.answered(false, limited);
        } else if self.follows {
            course.recorder.pause();
        }
        self.follows = follows;
        Ok(())
    }

    /// What acts on the links, N m.
    fn link_torque(&self) -> [f64; JOINTS] {
        let (now, then) = (&self.state.robot, &self.before.robot);
        let gravity = self.arm.bodies(&self.arm.frames(&now.actual_q)).gravity();
        let time_s = (now.timestamp - then.timestamp).max(PERIOD_S);
        std::array::from_fn(|j| {
            let acceleration = (now.actual_qd[j] - then.actual_qd[j]) / time_s;
            gravity[j] + self.state.motor_torque[j] - self.motors[j] * acceleration
        })
    }
}

impl Interface<JOINTS> for Ur {
    type Error = ClientError;

    fn carry_out(&mut self, course: &mut Course, tau: Option<[f64; JOINTS]>) -> Result<(), ClientError> {
        let mut limited = false;
        let order = match tau {
            Some(mut tau) => {
                for (tau, limit) in tau.iter_mut().zip(self.limits) {
                    limited |= tau.abs() > limit;
                    *tau = tau.clamp(-limit, limit);
                }
                Order::Torque(tau)
            }
            None => Order::Listen,
        };
        self.order(course, &order, limited)
    }

    fn follow(&mut self, course: &mut Course, q: [f64; JOINTS]) -> Result<(), ClientError> {
        self.order(course, &Order::Angles(q), false)
    }

    fn receive(&mut self, course: &mut Course) -> Result<(), ClientError> {
        let Some(client) = &mut self.client else { return Ok(()) };
        let before = self.state;
        if !std::mem::take(&mut self.begun) {
            client.receive(&mut self.state)?;
        }
        self.before = before;
        self.arrived(course);
        Ok(())
    }

    fn measured(&self) -> [[f64; JOINTS]; 3] {
        [
            self.state.robot.actual_q,
            self.state.robot.actual_qd,
            self.link_torque(),
        ]
    }

    fn status(&self, course: &Course) -> DriveStatus {
        let robot = &self.state.robot;
        match robot.ready() {
            Ok(()) if self.runs => DriveStatus::Ready,
            Ok(()) if course.may_start() && robot.program().is_none() => DriveStatus::Ready,
            Ok(()) | Err(Unready::Mode(_)) => DriveStatus::Disabled,
            Err(Unready::Stopped(number)) => match SafetyMode::from_number(number) {
                Ok(SafetyMode::ProtectiveStop | SafetyMode::Violation | SafetyMode::Fault) => DriveStatus::Failed,
                _ => DriveStatus::EmergencyStop,
            },
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
            ClientError::Closed | ClientError::Io(_) | ClientError::Connect { .. }
        )
    }

    fn is_final(error: &ClientError) -> bool {
        matches!(
            error,
            ClientError::NoTorques { .. } | ClientError::Protocol | ClientError::Wire(_)
        )
    }

    fn is_connected(&self) -> bool {
        self.client.is_some()
    }

    fn close(&mut self, course: &mut Course) {
        self.client = None;
        self.ended(course);
    }

    fn connect(&mut self) -> Result<(), ClientError> {
        self.client = Some(self.options.open()?);
        Ok(())
    }
}
