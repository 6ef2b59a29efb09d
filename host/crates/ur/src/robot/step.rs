//! What a program does in a control step, and how it reads registers.

use super::arm::ArmCommand;
use super::registers::Registers;
use crate::wire::Value;

/// What a program does in a control step.
pub(super) enum Step {
    /// It goes on, and the arm does this.
    Runs(ArmCommand),
    /// It has ended; with words for its client if something is wrong.
    Ends(Option<String>),
}

pub(super) fn integer(registers: &Registers, name: &str) -> i32 {
    match registers.value(name) {
        Some(Value::Int32(value)) => value,
        _ => 0,
    }
}

pub(super) fn double(registers: &Registers, name: &str) -> f64 {
    match registers.value(name) {
        Some(Value::Double(value)) => value,
        _ => 0.0,
    }
}
