//! Which robot the robot side is, what persons do to it, and what it counts.

use std::net::{Ipv4Addr, SocketAddr};
use std::sync::atomic::{AtomicBool, AtomicI32, Ordering};
use std::sync::{Arc, Mutex, PoisonError};

use spherecal_cyclic::{Machine, this_machine};

use crate::wire::{ControllerVersion, KinematicsInfo, Load, RobotMode, RuntimeState, SafetyMode, Series};
use crate::{JOINTS, RTDE_PORT};

/// What the robot side counted since its start.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RobotStatistics {
    /// Periods that the robot lived through.
    pub periods: u64,
    /// Periods by which its clock fell behind the time, because its thread was late.
    pub slipped: u64,
    /// Data packages that were sent.
    pub packages: u64,
    /// Data packages with inputs that came.
    pub inputs: u64,
    /// Connections that ended by a package that is none, or by a client that does not read.
    pub broken: u64,
    /// Clients of RTDE now.
    pub clients: usize,
    /// Programs that were started.
    pub programs: u64,
    /// Scripts that are none of those that this side runs.
    pub refused: u64,
    /// Control steps in which the arm followed torques.
    pub followed: u64,
    /// Programs that ended by themselves: their numbers stayed away.
    pub silent: u64,
    /// Protective stops that a limit caused.
    pub limits: u64,
    /// Torques or angles that were asked for after the program had ended. A client needs some periods to see the end.
    pub after_stop: u64,
    /// Whether a program runs.
    pub runs: bool,
}

/// What persons and safety functions do. Every change acts within a period.
#[derive(Debug)]
pub struct Controls {
    /// Number of the [`RobotMode`]; at the start `RUNNING`.
    pub robot_mode: AtomicI32,
    /// Number of the [`SafetyMode`]; at the start `NORMAL`.
    pub safety_mode: AtomicI32,
    /// Number of the [`RuntimeState`]; at the start `STOPPED`.
    pub runtime_state: AtomicI32,
    /// Whether scripts from outside are taken; at the start they are.
    pub remote: AtomicBool,
    /// Ends the program.
    pub stop_program: AtomicBool,
}

/// For how long a robot refuses to end a protective stop, s.
const LOCKED_S: f64 = 5.0;

/// What becomes of the wish to end a protective stop.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Unlock {
    /// It has ended.
    Done,
    /// There is none.
    NotStopped,
    /// It is younger than 5 s.
    TooEarly,
}

impl Controls {
    /// Ends a protective stop, if the robot permits it. `stopped_s`: how long the robot has been stopped.
    pub(super) fn unlock(&self, stopped_s: f64) -> Unlock {
        if self.safety_mode.load(Ordering::Relaxed) != SafetyMode::ProtectiveStop.number() {
            return Unlock::NotStopped;
        }
        if stopped_s < LOCKED_S {
            return Unlock::TooEarly;
        }
        self.safety_mode.store(SafetyMode::Normal.number(), Ordering::Relaxed);
        Unlock::Done
    }
}

impl Default for Controls {
    fn default() -> Self {
        Self {
            robot_mode: RobotMode::Running.number().into(),
            safety_mode: SafetyMode::Normal.number().into(),
            runtime_state: RuntimeState::Stopped.number().into(),
            remote: true.into(),
            stop_program: false.into(),
        }
    }
}

/// Settings of a robot side.
#[derive(Clone, Debug)]
pub struct RobotConfig {
    /// Time and network of this side.
    pub machine: Arc<dyn Machine>,
    /// Where RTDE listens. The interfaces that take scripts listen one to three ports below, the dashboard five; the Robot API at
    /// [`robot_api_port`](crate::robot_api_port). Port 0 takes any such ports.
    pub address: SocketAddr,
    /// The software that it says to have. It decides on the rate (125 Hz or 500 Hz), and whether there is a dashboard or, from
    /// PolyScope X on, a Robot API.
    pub version: ControllerVersion,
    /// The calibration that it says to have.
    pub kinematics: KinematicsInfo,
    /// Control periods that an input waits, beyond that in which it comes, until a program can read it.
    pub input_delay: u32,
    /// Largest joint speed, rad/s, and largest torque that a program may ask for, N m, of each joint. Beyond them the robot makes a
    /// protective stop. Infinite by default.
    pub limits: [(f64, f64); JOINTS],
}

/// Control periods that an input waits by default. Users of RTDE see their commands act after 4 to 6 ms; this makes it 4 ms.
const INPUT_DELAY: u32 = 1;

impl RobotConfig {
    /// A robot of this series on this computer, at the usual ports, with this calibration.
    pub fn new(series: Series, kinematics: KinematicsInfo) -> Self {
        let (major, minor, bugfix) = match series {
            Series::Cb3 => (3, 15, 0),
            Series::ESeries => (5, 25, 1),
        };
        Self {
            machine: this_machine(),
            address: SocketAddr::from((Ipv4Addr::LOCALHOST, RTDE_PORT)),
            version: ControllerVersion {
                major,
                minor,
                bugfix,
                ..ControllerVersion::default()
            },
            kinematics,
            input_delay: INPUT_DELAY,
            limits: [(f64::INFINITY, f64::INFINITY); JOINTS],
        }
    }

    /// Its series.
    pub fn series(&self) -> Series {
        Series::of(self.version.major)
    }
}

/// The arm at one instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ArmState {
    /// Measured joint angles, base to flange, rad.
    pub q: [f64; JOINTS],
    /// Measured joint velocities, rad/s.
    pub qd: [f64; JOINTS],
    /// Torques that hold arm and load, as the robot computes them, N m.
    pub moment: [f64; JOINTS],
    /// Torques of the motors beyond those, by their currents, seen at the joints, N m.
    pub motor_torque: [f64; JOINTS],
}

/// What the robot lets the arm do in a period.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum ArmCommand {
    /// Hold the pose: by closed brakes, or by position control. A hand may guide an arm that is made for it.
    #[default]
    Hold,
    /// Follow these torques, N m. The arm adds what holds it and its load.
    Torque([f64; JOINTS]),
    /// Follow these angles, rad, and velocities, rad/s, with the robot's own position control.
    Follow([f64; JOINTS], [f64; JOINTS]),
}

/// What a program does in a control step.
pub(super) enum Step {
    /// It goes on, and the arm does this.
    Runs(ArmCommand),
    /// It has ended; with words for its client if something is wrong.
    Ends(Option<String>),
}

/// An arm that the robot moves.
pub trait ArmHardware: Send {
    /// The arm now.
    fn state(&self) -> ArmState;

    /// Lets this time pass, in s, under this command.
    fn step(&mut self, command: ArmCommand, step_s: f64) -> ArmState;

    /// What the robot is told to carry. An arm that nobody commands need not know.
    fn set_load(&mut self, _load: &Load) {}
}

/// An arm that stays where the test puts it.
impl ArmHardware for Arc<Mutex<ArmState>> {
    fn state(&self) -> ArmState {
        *self.lock().unwrap_or_else(PoisonError::into_inner)
    }

    fn step(&mut self, _: ArmCommand, _: f64) -> ArmState {
        ArmHardware::state(self)
    }
}
