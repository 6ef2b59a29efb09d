//! The programs that this robot side runs, each known by its text. It interprets no script.

use super::controls::ArmCommand;
use super::registers::Registers;
use crate::JOINTS;
use crate::wire::{ACKNOWLEDGED, INPUTS, Load, Order, PATIENCE_STEPS, PROGRAM, Value, program_name};

#[derive(Debug)]
pub(super) struct TorqueProgram {
    /// The last number that came.
    number: i32,
    /// Control steps since then.
    silent: u32,
    /// It follows torques.
    follows: bool,
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

    /// One pass of its loop.
    pub(super) fn step(&mut self, registers: &mut Registers) -> Step {
        match self {
            Self::Torque(program) => program.step(registers),
            Self::UrRtde(_) => UrRtde::step(registers),
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
        let value = |k: usize| double(registers, INPUTS[k].0);
        let load = Load {
            mass_kg: value(8),
            com_m: std::array::from_fn(|k| value(9 + k)),
            inertia_kg_m2: std::array::from_fn(|k| value(12 + k)),
        };
        let this = Self {
            number: integer(registers, INPUTS[1].0),
            silent: 0,
            follows: false,
        };
        Some((this, load))
    }

    /// One pass of its loop. `stopj` takes no time here: the arm holds at once.
    fn step(&mut self, registers: &mut Registers) -> Step {
        let (command, number) = (integer(registers, INPUTS[0].0), integer(registers, INPUTS[1].0));
        if number == self.number {
            self.silent += 1;
        } else {
            (self.number, self.silent) = (number, 0);
        }
        registers.set(ACKNOWLEDGED, Value::Int32(number));
        let torques = command == Order::Torque([0.0; JOINTS]).number();
        if !torques && std::mem::replace(&mut self.follows, torques) {
            self.silent = 0;
        }
        self.follows = torques;
        let [following, listening] = PATIENCE_STEPS;
        if self.silent >= if torques { following } else { listening } {
            return Step::Ends(None);
        }
        Step::Runs(if torques {
            ArmCommand::Torque(std::array::from_fn(|j| double(registers, INPUTS[2 + j].0)))
        } else {
            ArmCommand::Hold
        })
    }
}

/// The number of the last package of inputs, if it asks for torques.
pub(super) fn torque_order(registers: &Registers) -> Option<i32> {
    let torques = integer(registers, INPUTS[0].0) == Order::Torque([0.0; JOINTS]).number();
    torques.then(|| integer(registers, INPUTS[1].0))
}

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

// The control program of `ur-rtde`, as far as its `directTorque` needs it. Its client writes the number of a command into
// `input_int_register_0`, and zero when it was told that the command is done. The program writes into
// `output_int_register_0`: 1 is ready, 2 is done. Source: the text of the program that `ur-rtde` 1.6.5 uploads. Commands that
// are not simulated end the program, so that none seems to be carried out.

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
