//! Our program for the robot: it takes torques from RTDE registers.
//!
//! The client writes a command, a number and six torques into input registers, all in one data package. In each control step
//! the program reads them and acknowledges the number in an output register. It ends by itself when no new number comes.

use super::FieldType;
use crate::JOINTS;

/// The program, as it is uploaded. The simulated robot side recognises this text and runs no other.
///
/// - `direct_torque` takes one control step, as `sync` does. The robot adds gravity and most of the joints' friction.
/// - 12 steps are 24 ms: as long as a controller without states keeps its last torque.
/// - Angles are followed by the robot's own position control, with the least smoothing that it permits: the setpoint is smooth.
/// - While nothing is wanted the robot holds its pose.
pub const PROGRAM: &str = "\
def spherecal_torque_1():
  set_target_payload(read_input_float_register(30), [read_input_float_register(31), read_input_float_register(32), read_input_float_register(33)], [read_input_float_register(34), read_input_float_register(35), read_input_float_register(36), read_input_float_register(37), read_input_float_register(38), read_input_float_register(39)], 0)
  local number = read_input_integer_register(25)
  local silent = 0
  local patience = 500
  local follows = False
  while silent < patience:
    local command = read_input_integer_register(24)
    local next = read_input_integer_register(25)
    if next == number:
      silent = silent + 1
    else:
      silent = 0
      number = next
    end
    write_output_integer_register(24, number)
    if command == 2:
      follows = True
      patience = 12
      direct_torque([read_input_float_register(24), read_input_float_register(25), read_input_float_register(26), read_input_float_register(27), read_input_float_register(28), read_input_float_register(29)], viscous_scale=[0.9, 0.9, 0.8, 0.9, 0.9, 0.9], coulomb_scale=[0.8, 0.8, 0.7, 0.8, 0.8, 0.8])
    elif command == 3:
      follows = True
      patience = 12
      servoj([read_input_float_register(24), read_input_float_register(25), read_input_float_register(26), read_input_float_register(27), read_input_float_register(28), read_input_float_register(29)], t=0.002, lookahead_time=0.03, gain=300)
    elif follows:
      follows = False
      patience = 500
      stopj(4.0)
      silent = 0
    else:
      sync()
    end
  end
  stopj(4.0)
end
";
/// Time by which `servoj` looks ahead in [`PROGRAM`], s.
pub const SERVO_LOOKAHEAD_S: f64 = 0.03;
/// Control steps without a new number after which the program ends while it follows torques or angles, and while it does not.
pub const PATIENCE_STEPS: [u32; 2] = [12, 500];

/// Output register with the acknowledged number.
pub const ACKNOWLEDGED: &str = "output_int_register_24";
/// Input registers of the program: what it shall do, the number of the package, torques (N m) or angles (rad), and the load: mass (kg),
/// centre of mass (m) and inertia (kg m²: xx, yy, zz, xy, xz, yz) in the frame of the flange. A fieldbus may have the registers 0 to 23.
pub const INPUTS: [(&str, FieldType); 18] = [
    ("input_int_register_24", FieldType::Int32),
    ("input_int_register_25", FieldType::Int32),
    ("input_double_register_24", FieldType::Double),
    ("input_double_register_25", FieldType::Double),
    ("input_double_register_26", FieldType::Double),
    ("input_double_register_27", FieldType::Double),
    ("input_double_register_28", FieldType::Double),
    ("input_double_register_29", FieldType::Double),
    ("input_double_register_30", FieldType::Double),
    ("input_double_register_31", FieldType::Double),
    ("input_double_register_32", FieldType::Double),
    ("input_double_register_33", FieldType::Double),
    ("input_double_register_34", FieldType::Double),
    ("input_double_register_35", FieldType::Double),
    ("input_double_register_36", FieldType::Double),
    ("input_double_register_37", FieldType::Double),
    ("input_double_register_38", FieldType::Double),
    ("input_double_register_39", FieldType::Double),
];

/// What hangs at the flange, in its frame.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Load {
    /// Mass, kg.
    pub mass_kg: f64,
    /// Centre of mass, m.
    pub com_m: [f64; 3],
    /// Inertia about the centre of mass: xx, yy, zz, xy, xz, yz, kg m².
    pub inertia_kg_m2: [f64; 6],
}

/// What the program shall do.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum Order {
    /// Acknowledge numbers, and hold the pose.
    #[default]
    Listen,
    /// Follow these torques, without gravity, N m.
    Torque([f64; JOINTS]),
    /// Follow these angles by the robot's own position control, rad.
    Angles([f64; JOINTS]),
}

impl Order {
    /// The number of the command register.
    pub const fn number(&self) -> i32 {
        match self {
            Self::Listen => 1,
            Self::Torque(_) => 2,
            Self::Angles(_) => 3,
        }
    }
}

/// The name of a program: `NAME` of its line `def NAME():`. `None` where there is no such line.
pub fn program_name(text: &str) -> Option<&str> {
    let line = text.lines().map(str::trim).find(|line| !line.is_empty())?;
    let line = line.strip_prefix("def ").or_else(|| line.strip_prefix("sec "))?;
    line.split_once('(').map(|(name, _)| name.trim())
}
