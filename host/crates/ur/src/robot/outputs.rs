//! What the robot side says in its outputs.

use super::controls::ArmState;
use super::registers::Registers;
use crate::JOINTS;
use crate::wire::{FieldType, KinematicsInfo, RobotMode, RuntimeState, SafetyMode, Series, Value, output_type};

/// `joint_mode` of a joint that is ready.
const JOINT_RUNNING: i32 = 253;

/// Everything that outputs are made of.
pub(super) struct Outputs<'a> {
    /// Time since the start, s.
    pub(super) time_s: f64,
    pub(super) arm: ArmState,
    pub(super) kinematics: &'a KinematicsInfo,
    pub(super) robot_mode: i32,
    pub(super) safety_mode: i32,
    pub(super) runtime_state: i32,
    pub(super) registers: &'a Registers,
}

/// The type of an output of a robot of this series; `None` for names that it does not know. A CB3 has neither a force sensor
/// nor currents as torques.
pub(super) fn known(series: Series, name: &str) -> Option<FieldType> {
    let new = matches!(name, "actual_current_as_torque" | "ft_raw_wrench");
    output_type(name).filter(|_| series == Series::ESeries || !new)
}

impl Outputs<'_> {
    pub(super) fn value(&self, name: &str, kind: FieldType) -> Value {
        match name {
            "timestamp" => Value::Double(self.time_s),
            "actual_q" | "target_q" => Value::Vector6D(self.arm.q),
            "actual_qd" | "target_qd" => Value::Vector6D(self.arm.qd),
            "target_moment" => Value::Vector6D(self.arm.moment),
            "actual_current_as_torque" => Value::Vector6D(self.arm.motor_torque),
            "actual_TCP_pose" | "target_TCP_pose" => Value::Vector6D(flange_pose(self.kinematics, &self.arm.q)),
            "robot_mode" => Value::Int32(self.robot_mode),
            "safety_mode" | "safety_status" => Value::Int32(self.safety_mode),
            "runtime_state" => Value::Uint32(self.runtime_state.unsigned_abs()),
            "joint_mode" => Value::Vector6Int32([JOINT_RUNNING; JOINTS]),
            "speed_scaling" | "target_speed_fraction" => Value::Double(1.0),
            "robot_status_bits" => Value::Uint32(self.robot_status()),
            "safety_status_bits" => Value::Uint32(self.safety_status()),
            _ => self.registers.value(name).unwrap_or_else(|| kind.zero()),
        }
    }

    /// Bit 0: the power is on. Bit 1: a program runs.
    fn robot_status(&self) -> u32 {
        let power = self.robot_mode >= RobotMode::PowerOn.number();
        let program = self.runtime_state == RuntimeState::Playing.number();
        u32::from(power) | u32::from(program) << 1
    }

    /// A bit for each safety mode, in the order of the maker's client library.
    fn safety_status(&self) -> u32 {
        let Ok(mode) = SafetyMode::from_number(self.safety_mode) else {
            return 0;
        };
        let (bit, emergency, stopped) = match mode {
            SafetyMode::Normal => (0, false, false),
            SafetyMode::Reduced => (1, false, false),
            SafetyMode::ProtectiveStop => (2, false, true),
            SafetyMode::Recovery => (3, false, false),
            SafetyMode::SystemEmergencyStop | SafetyMode::ImmiEmergencyStop | SafetyMode::ProfisafeEmergencyStop => {
                (5, true, true)
            }
            SafetyMode::RobotEmergencyStop => (6, true, true),
            SafetyMode::Violation => (8, false, true),
            SafetyMode::Fault => (9, false, true),
            SafetyMode::SystemThreePositionEnablingStop | SafetyMode::PendantThreePositionEnablingStop => {
                (11, false, true)
            }
            // The safeguards, and what no bit stands for.
            _ => (4, false, true),
        };
        1 << bit | u32::from(emergency) << 7 | u32::from(stopped) << 10
    }
}

/// The flange in the robot's base as the robot says it: position (m) and rotation vector (rad).
fn flange_pose(dh: &KinematicsInfo, q: &[f64; JOINTS]) -> [f64; 6] {
    let mut at = [0.0; 3];
    // Columns of the rotation.
    let mut axes = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]];
    let along = |at: &mut [f64; 3], axis: &[f64; 3], way: f64| at.iter_mut().zip(axis).for_each(|(x, e)| *x += way * e);
    let turn = |u: &mut [f64; 3], v: &mut [f64; 3], angle: f64| {
        let (s, c) = angle.sin_cos();
        for (u, v) in u.iter_mut().zip(v) {
            (*u, *v) = (c * *u + s * *v, c * *v - s * *u);
        }
    };
    for j in 0..JOINTS {
        let [x, y, z] = &mut axes;
        turn(x, y, q[j] + dh.theta[j]);
        along(&mut at, z, dh.d[j]);
        along(&mut at, x, dh.a[j]);
        turn(y, z, dh.alpha[j]);
    }
    let [x, y, z] = rotation_vector(&axes);
    [at[0], at[1], at[2], x, y, z]
}

/// Axis times angle of a rotation given by its columns, by way of the unit quaternion, which is exact at half a turn too.
fn rotation_vector(columns: &[[f64; 3]; 3]) -> [f64; 3] {
    let [[xx, xy, xz], [yx, yy, yz], [zx, zy, zz]] = *columns;
    // Four times the products of the quaternion's parts: the row with the largest square is divided by its root.
    let rows = [
        [1.0 + xx + yy + zz, yz - zy, zx - xz, xy - yx],
        [yz - zy, 1.0 + xx - yy - zz, xy + yx, zx + xz],
        [zx - xz, xy + yx, 1.0 - xx + yy - zz, yz + zy],
        [xy - yx, zx + xz, yz + zy, 1.0 - xx - yy + zz],
    ];
    let mut largest = 0;
    for k in 1..4 {
        if rows[k][k] > rows[largest][largest] {
            largest = k;
        }
    }
    let scale = 0.5 / rows[largest][largest].sqrt();
    let sign = if rows[largest][0] < 0.0 { -scale } else { scale };
    let [w, x, y, z] = rows[largest].map(|part| sign * part);
    let sine = x.hypot(y).hypot(z);
    let factor = if sine < 1e-12 { 2.0 } else { 2.0 * sine.atan2(w) / sine };
    [x, y, z].map(|part| factor * part)
}

#[cfg(test)]
mod tests {
    use super::*;

    // Fails if the pose of a UR10 is not the one that the maker's simulator gives: angles and positions of the test
    // `ur10_fw_kinematics_real` of Universal_Robots_ROS2_Driver, `ur_calibration/test/calibration_test.cpp` (BSD-3-Clause).
    #[test]
    fn the_flange_of_a_ur10_is_where_its_maker_says() {
        // What that simulator has for pi / 2, in nanoradian.
        let right = 1_570_796_327.0 * 1e-9;
        let dh = KinematicsInfo {
            d: [0.1273, 0.0, 0.0, 0.163941, 0.1157, 0.0922],
            a: [0.0, -0.612, -0.5723, 0.0, 0.0, 0.0],
            alpha: [right, 0.0, 0.0, right, -right, 0.0],
            ..KinematicsInfo::default()
        };
        let q = [
            -1.600_700_203_572_408_5,
            -1.727_100_197_468_889_3,
            -2.202_999_893_818_990_6,
            -0.807_999_912_892_476_9,
            1.595_100_045_204_162_6,
            -0.030_999_962_483_510_13,
        ];
        let found = flange_pose(&dh, &q);
        let expected = [-0.179_925_914_147_547, -0.606_869_755_162_764, 0.230_789_102_067_257];
        for (found, expected) in found.iter().zip(expected) {
            assert!((found - expected).abs() < 1e-12, "{found} is not {expected}");
        }
    }

    // Fails if axis or angle of a rotation is wrong, also near zero and at half a turn.
    #[test]
    fn rotation_vectors_are_axis_times_angle() {
        let about_x = |angle: f64| {
            let (s, c) = angle.sin_cos();
            rotation_vector(&[[1.0, 0.0, 0.0], [0.0, c, s], [0.0, -s, c]])
        };
        for angle in [0.0, 1e-9, 0.3, -2.0, 3.1, std::f64::consts::PI] {
            let [x, y, z] = about_x(angle);
            assert!(
                (x - angle).abs() < 1e-9 && y.abs() < 1e-12 && z.abs() < 1e-12,
                "{angle}: {x} {y} {z}"
            );
        }
    }
}
