//! What persons do to a robot side, and what it counts.

use std::sync::atomic::{AtomicBool, AtomicI32};

use crate::wire::{RobotMode, RuntimeState, SafetyMode};

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
    /// Torques that were asked for after the program had ended. A client needs some periods to see the end.
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
