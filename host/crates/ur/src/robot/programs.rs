//! The programs that this robot side runs, each known by its text. It interprets no script.

use super::controls::{ArmCommand, ArmState, Step};
use super::mover::Mover;
use super::registers::Registers;
use super::ur_rtde::UrRtde;
use crate::wire::{ACKNOWLEDGED, INPUTS, Load, Order, PATIENCE_STEPS, PROGRAM, SERVO_LOOKAHEAD_S, Value};

#[derive(Debug)]
pub(super) struct TorqueProgram {
    /// The last number that came.
    number: i32,
    /// Control steps since then.
    silent: u32,
    /// It follows torques or angles.
    follows: bool,
    /// The setpoint while it follows angles.
    mover: Option<Mover>,
}

/// A program that this side runs.
#[derive(Debug)]
pub(super) enum Program {
    Torque(TorqueProgram),
    UrRtde(UrRtde),
}

impl Program {
    /// The program in this text, and the load that it tells the robot.
    pub(super) fn recognise(text: &str, registers: &Registers) -> Option<(Self, Option<Load>)> {
        if let Some((program, load)) = TorqueProgram::recognise(text, registers) {
            return Some((Self::Torque(program), Some(load)));
        }
        UrRtde::recognise(text).map(|program| (Self::UrRtde(program), None))
    }

    /// One pass of its loop. `arm`: the arm now; `step_s`: the time until the next pass.
    pub(super) fn step(&mut self, registers: &mut Registers, arm: &ArmState, step_s: f64) -> Step {
        match self {
            Self::Torque(program) => program.step(registers, arm, step_s),
            Self::UrRtde(program) => program.step(registers, arm, step_s),
        }
    }

    /// The last number that ours has read.
    pub(super) fn number(&self) -> i32 {
        match self {
            Self::Torque(program) => program.number,
            Self::UrRtde(_) => 0,
        }
    }
}

impl TorqueProgram {
    /// The program in this text, if it is that one. The load that it tells the robot is in the registers.
    fn recognise(text: &str, registers: &Registers) -> Option<(Self, Load)> {
        if text != PROGRAM {
            return None;
        }
        let value = |k: usize| registers.double(INPUTS[k].0);
        let load = Load {
            mass_kg: value(8),
            com_m: std::array::from_fn(|k| value(9 + k)),
            inertia_kg_m2: std::array::from_fn(|k| value(12 + k)),
        };
        let this = Self {
            number: registers.integer(INPUTS[1].0),
            silent: 0,
            follows: false,
            mover: None,
        };
        Some((this, load))
    }

    /// One pass of its loop. `stopj` takes no time here: the arm holds at once.
    fn step(&mut self, registers: &mut Registers, arm: &ArmState, step_s: f64) -> Step {
        let (command, number) = (registers.integer(INPUTS[0].0), registers.integer(INPUTS[1].0));
        if number == self.number {
            self.silent += 1;
        } else {
            (self.number, self.silent) = (number, 0);
        }
        registers.set(ACKNOWLEDGED, Value::Int32(number));
        let follows = follows(registers);
        if !follows && self.follows {
            self.silent = 0;
        }
        self.follows = follows;
        let [following, listening] = PATIENCE_STEPS;
        if self.silent >= if follows { following } else { listening } {
            return Step::Ends(None);
        }
        let joints = std::array::from_fn(|j| registers.double(INPUTS[2 + j].0));
        if command == Order::Angles(joints).number() {
            let mover = self.mover.get_or_insert_with(|| Mover::new(arm.q));
            mover.servo(joints, SERVO_LOOKAHEAD_S);
            return Step::Runs(mover.step(step_s));
        }
        self.mover = None;
        Step::Runs(if follows {
            ArmCommand::Torque(joints)
        } else {
            ArmCommand::Hold
        })
    }
}

/// Whether the last package of inputs asks for torques or angles.
fn follows(registers: &Registers) -> bool {
    registers.integer(INPUTS[0].0) > Order::Listen.number()
}

/// The number of that package.
pub(super) fn moving_order(registers: &Registers) -> Option<i32> {
    follows(registers).then(|| registers.integer(INPUTS[1].0))
}
