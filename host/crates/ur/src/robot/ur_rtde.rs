//! The control program of `ur-rtde`, as far as it moves joints.
//!
//! Its client writes the number of a command into `input_int_register_0`, what the command needs into double registers from 0 on,
//! and 0 when it was told that the command is done. The program writes into `output_int_register_0`: 1 is ready, 2 is done.
//! Source: the text of the program that `ur-rtde` 1.6.5 uploads. Commands that are not simulated end the program, so that none
//! seems to be carried out.

use super::controls::{ArmCommand, ArmState, Step};
use super::mover::Mover;
use super::registers::Registers;
use crate::JOINTS;
use crate::wire::{Value, program_name};

/// What a client asks for.
mod command {
    pub(super) const NONE: i32 = 0;
    pub(super) const MOVE_J: i32 = 1;
    pub(super) const SPEED_J: i32 = 9;
    pub(super) const SERVO_J: i32 = 11;
    pub(super) const SPEED_STOP: i32 = 15;
    pub(super) const SERVO_STOP: i32 = 16;
    pub(super) const STOP_J: i32 = 34;
    pub(super) const DIRECT_TORQUE: i32 = 66;
    pub(super) const STOP_SCRIPT: i32 = 255;
}

/// Where the program answers, and what.
const ANSWER: &str = "output_int_register_0";
const READY: i32 = 1;
const DONE: i32 = 2;

/// That program, as it runs.
#[derive(Debug, Default)]
pub(super) struct UrRtde {
    /// The position control, once a command has asked for it. Until then the arm rests.
    mover: Option<Mover>,
    /// The command that runs, or has run, until its client takes it back.
    executing: i32,
}

impl UrRtde {
    pub(super) fn recognise(text: &str) -> Option<Self> {
        (program_name(text) == Some("rtde_control") && text.contains("servoj(")).then(Self::default)
    }

    /// One pass of its loop.
    pub(super) fn step(&mut self, registers: &mut Registers, arm: &ArmState, step_s: f64) -> Step {
        let value = |k: usize| registers.double(&format!("input_double_register_{k}"));
        let six = || std::array::from_fn(value);
        let command = registers.integer("input_int_register_0");
        // A command that takes its time begins once. One in real time is read in each pass.
        let begins = self.executing != command;
        self.executing = command;
        let answer = match command {
            command::NONE => READY,
            command::SERVO_J => {
                self.mover(arm).servo(six(), value(9));
                READY
            }
            command::SPEED_J => {
                self.mover(arm).speed(six(), value(6));
                READY
            }
            command::MOVE_J => {
                if begins {
                    self.mover(arm).move_to(six(), value(6), value(7));
                }
                let returns_at_once = registers.integer("input_int_register_1") == 1;
                if returns_at_once || self.rests() { DONE } else { READY }
            }
            command::SPEED_STOP | command::SERVO_STOP | command::STOP_J => {
                if begins {
                    self.mover(arm).speed([0.0; JOINTS], value(0));
                }
                if self.rests() { DONE } else { READY }
            }
            command::DIRECT_TORQUE => {
                let torque = six();
                self.mover = None;
                registers.set(ANSWER, Value::Int32(READY));
                return Step::Runs(ArmCommand::Torque(torque));
            }
            command::STOP_SCRIPT => return Step::Ends(None),
            other => return Step::Ends(Some(format!("the command {other} of ur-rtde is not simulated"))),
        };
        registers.set(ANSWER, Value::Int32(answer));
        Step::Runs(self.mover.as_mut().map_or(ArmCommand::Hold, |mover| mover.step(step_s)))
    }

    fn mover(&mut self, arm: &ArmState) -> &mut Mover {
        self.mover.get_or_insert_with(|| Mover::new(arm.q))
    }

    fn rests(&self) -> bool {
        self.mover.as_ref().is_none_or(Mover::rests)
    }
}
