//! The control program of `ur-rtde`, as far as its `directTorque` needs it.
//!
//! Its client writes the number of a command into `input_int_register_0`, and zero when it was told that the command is done.
//! The program writes into `output_int_register_0`: 1 is ready, 2 is done. Source: the text of the program that `ur-rtde`
//! 1.6.5 uploads. Commands that are not simulated end the program, so that none seems to be carried out.

use super::arm::ArmCommand;
use super::registers::Registers;
use super::step::{Step, double, integer};
use crate::wire::{Value, program_name};

/// The line that takes torques; without it the client believes the robot's software to be too old.
const TORQUES: &str = "direct_torque(";
const NONE: i32 = 0;
const DIRECT_TORQUE: i32 = 66;
const STOP_SCRIPT: i32 = 255;

/// That program, as it runs.
#[derive(Debug)]
pub(super) struct UrRtde;

impl UrRtde {
    pub(super) fn recognise(text: &str) -> Option<Self> {
        (program_name(text) == Some("rtde_control") && text.contains(TORQUES)).then_some(Self)
    }

    /// One pass of its loop.
    pub(super) fn step(registers: &mut Registers) -> Step {
        registers.set("output_int_register_0", Value::Int32(1));
        match integer(registers, "input_int_register_0") {
            NONE => Step::Runs(ArmCommand::Hold),
            DIRECT_TORQUE => Step::Runs(ArmCommand::Torque(std::array::from_fn(|j| {
                double(registers, &format!("input_double_register_{j}"))
            }))),
            STOP_SCRIPT => Step::Ends(None),
            other => Step::Ends(Some(format!("the command {other} of ur-rtde is not simulated"))),
        }
    }
}
