//! The names of RTDE fields and their types, as a robot knows them.
//!
//! Source: the maker's client library, `src/rtde/data_package.cpp`, and its RTDE guide.

use FieldType::{Bool, Double, Int32, Uint8, Uint32, Uint64, Vector3D, Vector6D, Vector6Int32};

use super::FieldType;

/// Bits, integers and doubles of the general registers in each direction.
const BITS: u32 = 128;
const NUMBERS: u32 = 48;

/// Outputs with names of their own.
const OUTPUTS: &[(&str, FieldType)] = &[
    ("timestamp", Double),
    ("target_q", Vector6D),
    ("target_qd", Vector6D),
    ("target_qdd", Vector6D),
    ("target_current", Vector6D),
    ("target_moment", Vector6D),
    ("actual_q", Vector6D),
    ("actual_qd", Vector6D),
    ("actual_current", Vector6D),
    ("actual_current_window", Vector6D),
    ("actual_current_as_torque", Vector6D),
    ("joint_control_output", Vector6D),
    ("actual_TCP_pose", Vector6D),
    ("actual_TCP_speed", Vector6D),
    ("actual_TCP_force", Vector6D),
    ("target_TCP_pose", Vector6D),
    ("target_TCP_speed", Vector6D),
    ("actual_digital_input_bits", Uint64),
    ("joint_temperatures", Vector6D),
    ("actual_execution_time", Double),
    ("robot_mode", Int32),
    ("joint_mode", Vector6Int32),
    ("safety_mode", Int32),
    ("safety_status", Int32),
    ("actual_tool_accelerometer", Vector3D),
    ("speed_scaling", Double),
    ("target_speed_fraction", Double),
    ("actual_momentum", Double),
    ("actual_main_voltage", Double),
    ("actual_robot_voltage", Double),
    ("actual_robot_current", Double),
    ("actual_joint_voltage", Vector6D),
    ("actual_digital_output_bits", Uint64),
    ("runtime_state", Uint32),
    ("elbow_position", Vector3D),
    ("elbow_velocity", Vector3D),
    ("robot_status_bits", Uint32),
    ("safety_status_bits", Uint32),
    ("analog_io_types", Uint32),
    ("standard_analog_input0", Double),
    ("standard_analog_input1", Double),
    ("standard_analog_output0", Double),
    ("standard_analog_output1", Double),
    ("io_current", Double),
    ("euromap67_input_bits", Uint32),
    ("euromap67_output_bits", Uint32),
    ("euromap67_24V_voltage", Double),
    ("euromap67_24V_current", Double),
    ("tool_mode", Uint32),
    ("tool_analog_input_types", Uint32),
    ("tool_analog_input0", Double),
    ("tool_analog_input1", Double),
    ("tool_output_voltage", Int32),
    ("tool_output_current", Double),
    ("tool_temperature", Double),
    ("tcp_force_scalar", Double),
    ("output_bit_registers0_to_31", Uint32),
    ("output_bit_registers32_to_63", Uint32),
    ("input_bit_registers0_to_31", Uint32),
    ("input_bit_registers32_to_63", Uint32),
    ("tool_output_mode", Uint8),
    ("tool_digital_output0_mode", Uint8),
    ("tool_digital_output1_mode", Uint8),
    ("payload", Double),
    ("payload_cog", Vector3D),
    ("payload_inertia", Vector6D),
    ("script_control_line", Uint32),
    ("ft_raw_wrench", Vector6D),
    ("joint_position_deviation_ratio", Double),
    ("collision_detection_ratio", Double),
    ("time_scale_source", Int32),
    ("tcp_offset", Vector6D),
];

/// Inputs with names of their own.
const INPUTS: &[(&str, FieldType)] = &[
    ("speed_slider_mask", Uint32),
    ("speed_slider_fraction", Double),
    ("standard_digital_output_mask", Uint8),
    ("standard_digital_output", Uint8),
    ("configurable_digital_output_mask", Uint8),
    ("configurable_digital_output", Uint8),
    ("tool_digital_output_mask", Uint8),
    ("tool_digital_output", Uint8),
    ("standard_analog_output_mask", Uint8),
    ("standard_analog_output_type", Uint8),
    ("standard_analog_output_0", Double),
    ("standard_analog_output_1", Double),
    ("input_bit_registers0_to_31", Uint32),
    ("input_bit_registers32_to_63", Uint32),
    ("external_force_torque", Vector6D),
];

fn named(table: &[(&str, FieldType)], name: &str) -> Option<FieldType> {
    table.iter().find(|(known, _)| *known == name).map(|(_, kind)| *kind)
}

fn register(direction: &str, name: &str) -> Option<FieldType> {
    let rest = name.strip_prefix(direction)?;
    let (kind, number) = rest.rsplit_once('_')?;
    let (count, kind) = match kind {
        "_bit_register" => (BITS, Bool),
        "_int_register" => (NUMBERS, Int32),
        "_double_register" => (NUMBERS, Double),
        _ => return None,
    };
    // `+1` and `007` are no numbers of registers.
    let plain =
        number.len() <= 3 && number.bytes().all(|b| b.is_ascii_digit()) && (number == "0" || !number.starts_with('0'));
    let number: u32 = number.parse().ok().filter(|_| plain)?;
    (number < count).then_some(kind)
}

/// The type of an output; `None` for a name that robots do not know. Inputs that were written can be read, too.
pub fn output_type(name: &str) -> Option<FieldType> {
    named(OUTPUTS, name)
        .or_else(|| register("output", name))
        .or_else(|| register("input", name))
}

/// The type of an input; `None` for a name that robots do not know.
pub fn input_type(name: &str) -> Option<FieldType> {
    named(INPUTS, name).or_else(|| register("input", name))
}
