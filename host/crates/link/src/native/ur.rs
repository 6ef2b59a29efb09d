//! An e-Series robot of Universal Robots, or a newer one, behind RTDE and a program of ours.

use std::sync::Arc;
use std::time::Duration;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::host::LoopTiming;
use spherecal_shared::robot::{Arm, Dynamics as _};
use spherecal_ur::JOINTS;
use spherecal_ur::client::{
    ClientError, DashboardCommand, ProgramEnd, TorqueClient, TorqueState, Unready, ask_dashboard,
};
use spherecal_ur::wire::{Order, SafetyMode};

use super::monitor::{DriveRecorder, Monitor};
use super::ur_start::{Sent, UrError, UrOptions, begin, start};
use super::{DriveEvent, fill, periods, torques};
use crate::{Drive, LinkError};
use spherecal_budget::robot::GIVE_UP;

/// Session number of the drive: a lost connection ends the run, or goes on in the same session.
const SESSION: u32 = 1;
/// Control period, s and µs.
const PERIOD_S: f64 = TorqueClient::period_s();
const PERIOD_US: u32 = (PERIOD_S * 1e6) as u32;
/// Periods in a second: the pause between an end and the next start. The host sees the fault first.
const PAUSE_TICKS: u64 = 1_000_000 / PERIOD_US as u64;
/// Periods of a protective stop before the dashboard is asked to end it. The robot refuses for 5 s.
const UNLOCK_TICKS: u64 = 11 * PAUSE_TICKS / 2;
/// How often in a row the dashboard is asked, without torques between them.
const UNLOCKS: u32 = 3;
/// Shortest time between two attempts to connect again.
const RETRY: Duration = Duration::from_millis(100);
/// First major version without a dashboard.
const POLYSCOPE_X: u32 = 10;

/// A robot of Universal Robots as a drive.
///
/// - Our program runs on the robot from the connection on. Without `enable` it holds the pose by the robot's own position
///   control.
/// - The measured torques are those of the motors. What accelerates the declared motors is taken off, and the gravity of
///   model and tool is added: that is what acts on the links.
/// - A stop ends the program. After a protective stop the drive asks the dashboard to end it, at most three times in a row;
///   other stops are a person's. As soon as the robot is ready, the next command with `enable` starts the program anew.
/// - A cable that is out for less than a minute, and a robot that restarts, end the program; the drive connects again.
pub struct UrDrive {
    options: UrOptions,
    /// `None` while the connection is lost.
    client: Option<TorqueClient>,
    arm: Arm<f64, JOINTS>,
    limits: [f64; JOINTS],
    motors: [f64; JOINTS],
    hello: DriveHello,
    state: TorqueState,
    tick: u64,
    missed: u32,
    sent: Sent,
    /// The command for this period was carried out.
    answered: bool,
    /// A start has read its first state.
    begun: bool,
    /// Our program runs.
    runs: bool,
    /// The last command was a torque.
    follows: bool,
    /// Nothing is started before this tick.
    resume_at: u64,
    silent: Duration,
    /// Since when the robot has been stopped.
    stopped_at: Option<u64>,
    unlocks: u32,
    recorder: DriveRecorder,
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
        let latency_us = begin(&options, &mut client, &mut state, &mut sent)?.max(undeclared.latency_us);
        let motors = &undeclared.motor_kg_m2;
        Ok(Self {
            arm,
            limits: std::array::from_fn(|j| robot.joints.get(j).map_or(0.0, |joint| joint.limits.torque_nm)),
            motors: std::array::from_fn(|j| motors.get(j).copied().unwrap_or(0.0)),
            hello: DriveHello {
                period_us: PERIOD_US,
                compensates_gravity: true,
                motor_kg_m2: motors.clone(),
                latency_us,
                // No controller is on this computer: what answers from here is a simulation.
                simulated: client.is_local(),
                ..DriveHello::new(SESSION, robot.joints.iter().map(|joint| joint.limits))
            },
            client: Some(client),
            state,
            tick: 0,
            missed: 0,
            sent,
            answered: false,
            begun: false,
            runs: true,
            follows: false,
            resume_at: 0,
            silent: Duration::ZERO,
            stopped_at: None,
            unlocks: 0,
            recorder: DriveRecorder::new(PERIOD_US, Arc::clone(&options.config.machine)),
            options,
        })
    }

    /// Carries out the command that answers the last state.
    fn carry_out(&mut self, command: Option<&DriveCommand>) -> Result<(), ClientError> {
        let wanted = command.filter(|c| c.enable).map(|c| &c.tau);
        if wanted.is_some() && !self.runs {
            return self.start();
        }
        let Some(client) = &mut self.client else { return Ok(()) };
        // While the robot is silent there is nothing to answer: its program ends by itself.
        if !self.silent.is_zero() {
            return Ok(());
        }
        let mut limited = false;
        // A wrong number of torques was refused before.
        let order = match wanted.and_then(|tau| torques::<JOINTS>(tau).ok()) {
            Some(mut tau) => {
                for (tau, limit) in tau.iter_mut().zip(self.limits) {
                    limited |= tau.abs() > limit;
                    *tau = tau.clamp(-limit, limit);
                }
                Order::Torque(tau)
            }
            None => Order::Listen,
        };
        let follows = matches!(order, Order::Torque(_));
        self.sent.note(client.send(&order)?, self.state.robot.timestamp);
        if follows {
            if !self.follows {
                self.recorder.event(DriveEvent::Started);
            }
            self.recorder.answered(false, limited);
        } else if self.follows {
            self.recorder.pause();
        }
        self.follows = follows;
        Ok(())
    }

    /// Starts the program anew, and waits until it runs.
    fn start(&mut self) -> Result<(), ClientError> {
        let Some(client) = self.client.as_mut().filter(|_| self.tick >= self.resume_at) else {
            return Ok(());
        };
        if self.state.robot.ready().is_err() || self.state.robot.program().is_some() {
            return Ok(());
        }
        self.recorder.pause();
        self.runs = start(client, &mut self.state, &mut self.sent)?;
        self.begun = true;
        if self.runs {
            self.unlocks = 0;
        } else {
            self.resume_at = self.tick + PAUSE_TICKS;
            self.recorder.event(DriveEvent::UrNotStarted);
        }
        Ok(())
    }

    /// A state came; `before` is the one before it.
    fn arrived(&mut self, before: &TorqueState) {
        let robot = &self.state.robot;
        let passed = (robot.timestamp - before.robot.timestamp) / PERIOD_S;
        let passed = passed.round().clamp(1.0, 1e9) as u32;
        // While the robot holds the arm itself, a state that was not read is no missed period. Those of a silence are counted.
        let counted = if self.silent.is_zero() {
            0
        } else {
            periods(self.silent, PERIOD_US)
        };
        self.missed = if self.follows {
            passed.saturating_sub(1 + counted)
        } else {
            0
        };
        self.recorder.state(self.follows, self.missed);
        self.tick += 1 + u64::from(self.missed);
        if !std::mem::take(&mut self.silent).is_zero() {
            self.recorder.event(DriveEvent::Back);
        }
        let unready = robot.ready().err();
        if self.runs && (unready.is_some() || robot.program().is_none()) {
            self.recorder.record.stops += 1;
            self.recorder.event(DriveEvent::UrEnded(
                unready.map_or(ProgramEnd::Ended, ProgramEnd::Unready),
            ));
            self.ended();
        }
        self.unlock(unready);
    }

    /// The program does not run any more.
    fn ended(&mut self) {
        (self.runs, self.follows) = (false, false);
        self.resume_at = self.tick + PAUSE_TICKS;
        self.recorder.pause();
    }

    /// Asks the dashboard to end a protective stop, once the robot permits it.
    fn unlock(&mut self, unready: Option<Unready>) {
        let protective = Unready::Stopped(SafetyMode::ProtectiveStop.number());
        let Some(unready) = unready.filter(|unready| *unready == protective) else {
            self.stopped_at = None;
            return;
        };
        let since = *self.stopped_at.get_or_insert(self.tick);
        if self.tick - since < UNLOCK_TICKS || self.unlocks > UNLOCKS {
            return;
        }
        self.stopped_at = Some(self.tick);
        self.unlocks += 1;
        let major = self.client.as_ref().map_or(0, |client| client.version().major);
        if self.unlocks > UNLOCKS || major >= POLYSCOPE_X {
            self.unlocks = UNLOCKS + 1;
            self.recorder.event(DriveEvent::UrPersonNeeded(unready));
            return;
        }
        self.recorder.record.recoveries += 1;
        self.recorder.event(DriveEvent::UrUnlocking);
        let commands = [
            DashboardCommand::CloseSafetyPopup,
            DashboardCommand::UnlockProtectiveStop,
        ];
        // Whether it helped, the robot's state tells. A dashboard that does not answer is asked again.
        let _ = ask_dashboard(&self.options.config, &commands);
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
        self.ended();
    }

    fn reconnect(&mut self) -> Result<(), LinkError> {
        let machine = Arc::clone(&self.options.config.machine);
        let begun = machine.now();
        let elapsed = || machine.now().saturating_duration_since(begun);
        match self.options.open() {
            Ok(client) => {
                self.client = Some(client);
                self.resume_at = self.tick + PAUSE_TICKS;
                self.recorder.record.reconnects += 1;
                self.recorder.event(DriveEvent::Reconnected);
            }
            Err(error @ (ClientError::NoTorques { .. } | ClientError::Protocol | ClientError::Wire(_))) => {
                return Err(LinkError::device(error));
            }
            Err(error) if self.silent + elapsed() > GIVE_UP => return Err(LinkError::device(error)),
            Err(_) => machine.sleep(RETRY.saturating_sub(elapsed())),
        }
        self.heard_nothing(elapsed());
        Ok(())
    }

    fn status(&self) -> DriveStatus {
        let robot = &self.state.robot;
        match robot.ready() {
            Ok(()) if self.runs => DriveStatus::Ready,
            Ok(()) if self.tick >= self.resume_at && robot.program().is_none() => DriveStatus::Ready,
            Ok(()) | Err(Unready::Mode(_)) => DriveStatus::Disabled,
            Err(Unready::Stopped(number)) => match SafetyMode::from_number(number) {
                Ok(SafetyMode::ProtectiveStop | SafetyMode::Violation | SafetyMode::Fault) => DriveStatus::Failed,
                _ => DriveStatus::EmergencyStop,
            },
        }
    }

    /// Takes an error that only loses the connection; others are for good.
    fn survive(&mut self, result: Result<(), ClientError>) -> Result<(), LinkError> {
        match result {
            Ok(()) => Ok(()),
            Err(ClientError::Closed | ClientError::Io(_) | ClientError::Connect { .. }) => {
                self.lose();
                Ok(())
            }
            // The robot fell silent meanwhile: the next receive tells.
            Err(ClientError::Silent { .. }) => Ok(()),
            Err(error) => Err(LinkError::device(error)),
        }
    }

    /// What acts on the links, N m; `before` is the state before.
    fn link_torque(&self, before: &TorqueState) -> [f64; JOINTS] {
        let (now, then) = (&self.state.robot, &before.robot);
        let gravity = self.arm.bodies(&self.arm.frames(&now.actual_q)).gravity();
        let time_s = (now.timestamp - then.timestamp).max(PERIOD_S);
        std::array::from_fn(|j| {
            let acceleration = (now.actual_qd[j] - then.actual_qd[j]) / time_s;
            gravity[j] + self.state.motor_torque[j] - self.motors[j] * acceleration
        })
    }
}

impl Drive for UrDrive {
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
        let before = self.state;
        let received = if std::mem::take(&mut self.begun) {
            Ok(())
        } else {
            client.receive(&mut self.state)
        };
        match received {
            Ok(()) => self.arrived(&before),
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
        state.session = self.hello.session;
        state.tick = self.tick;
        fill(&mut state.q, &self.state.robot.actual_q);
        fill(&mut state.dq, &self.state.robot.actual_qd);
        fill(&mut state.tau, &self.link_torque(&before));
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
