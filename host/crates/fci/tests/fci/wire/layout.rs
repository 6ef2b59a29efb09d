//! Where the fields of states and commands stand.

use spherecal_fci::wire::*;

use super::{number_at, tail};

/// Field, offset in the versions 5 to 9 (f64), offset in version 10 (f32): from the documented layout, not from the
/// crate's own table. Version 4 has no `O_ddP_O`: what follows stands 24 bytes earlier.
const STATE_LAYOUT: &[(&str, usize, usize)] = &[
    ("O_T_EE", 8, 8),
    ("O_T_EE_d", 136, 72),
    ("F_T_EE", 264, 136),
    ("EE_T_K", 392, 200),
    ("F_T_NE", 520, 264),
    ("NE_T_EE", 648, 328),
    ("m_ee", 776, 392),
    ("I_ee", 784, 396),
    ("F_x_Cee", 856, 432),
    ("m_load", 880, 444),
    ("I_load", 888, 448),
    ("F_x_Cload", 960, 484),
    ("elbow", 984, 496),
    ("elbow_d", 1000, 504),
    ("tau_J", 1016, 512),
    ("tau_J_d", 1072, 540),
    ("dtau_J", 1128, 568),
    ("q", 1184, 596),
    ("q_d", 1240, 624),
    ("dq", 1296, 652),
    ("dq_d", 1352, 680),
    ("ddq_d", 1408, 708),
    ("joint_contact", 1464, 736),
    ("cartesian_contact", 1520, 764),
    ("joint_collision", 1568, 788),
    ("cartesian_collision", 1624, 816),
    ("tau_ext_hat_filtered", 1672, 840),
    ("O_F_ext_hat_K", 1728, 868),
    ("K_F_ext_hat_K", 1776, 892),
    ("O_dP_EE_d", 1824, 916),
    ("O_ddP_O", 1872, 940),
    ("elbow_c", 1896, 952),
    ("delbow_c", 1912, 960),
    ("ddelbow_c", 1928, 968),
    ("O_T_EE_c", 1944, 976),
    ("O_dP_EE_c", 2072, 1040),
    ("O_ddP_EE_c", 2120, 1064),
    ("theta", 2168, 1088),
    ("dtheta", 2224, 1116),
    ("accelerometer_top", 2280, 1144),
    ("accelerometer_bottom", 2280, 1216),
];

/// Where the documented layout has a field of this version; `None` if nowhere.
fn documented(version: Version, name: &str, f64_at: usize, f32_at: usize) -> Option<usize> {
    match version {
        Version::V10 => Some(f32_at),
        _ if name.starts_with("accelerometer") => None,
        Version::V4 if name == "O_ddP_O" => None,
        Version::V4 if f64_at > 1872 => Some(f64_at - 24),
        _ => Some(f64_at),
    }
}

fn state_with_pattern() -> RobotState {
    let mut state = RobotState {
        message_id: 0x0102_0304_0506_0708,
        motion_generator_mode: MotionGeneratorMode::None,
        controller_mode: ControllerMode::External,
        errors: ErrorSet::of(ErrorFlag::ControllerTorqueDiscontinuity),
        reflex_reason: ErrorSet::of(ErrorFlag::BaseAccelerationInvalidReading),
        robot_mode: RobotMode::Reflex,
        control_command_success_rate: 0.75,
        ..RobotState::default()
    };
    for (field, numbers) in state.numbers_mut().into_iter().enumerate() {
        for (index, number) in numbers.iter_mut().enumerate() {
            *number = 100.0 * (field + 1) as f64 + index as f64 + 0.5;
        }
    }
    state
}

// Fails if a field of the state stands at another byte than documented, in any version.
#[test]
fn state_has_the_documented_layout() {
    let state = state_with_pattern();
    assert_eq!(RobotState::FIELDS.len(), STATE_LAYOUT.len());
    for version in Version::ALL {
        let mut bytes = [0xAA; MAX_STATE_SIZE];
        let size = state.encode(version, &mut bytes);
        let (expected, step) = match version {
            Version::V4 => (2341, 8),
            Version::V10 => (1377, 4),
            _ => (2373, 8),
        };
        let tail = tail(version);
        assert_eq!(size, expected);
        assert_eq!(bytes[..8], 0x0102_0304_0506_0708_u64.to_le_bytes());
        // What a version does not have is not read.
        let mut read = state.clone();
        if version == Version::V4 {
            read.reflex_reason = ErrorSet::NONE;
        }
        for (field, (info, (name, f64_at, f32_at))) in RobotState::FIELDS.iter().zip(STATE_LAYOUT).enumerate() {
            assert_eq!(info.name, *name);
            let Some(offset) = documented(version, name, *f64_at, *f32_at) else {
                assert!(!info.is_in(version), "{name}");
                read.numbers_mut()[field].fill(0.0);
                continue;
            };
            assert_eq!(info.offset(version), offset, "{name}");
            for index in 0..info.count {
                let value = number_at(&bytes, version, offset + index * step);
                assert_eq!(
                    value,
                    100.0 * (field + 1) as f64 + index as f64 + 0.5,
                    "{name}[{index}]"
                );
            }
        }
        assert_eq!(bytes[tail[0]], 5);
        assert_eq!(bytes[tail[1]], 2);
        for bit in 0..tail[3] - tail[2] {
            assert_eq!(bytes[tail[2] + bit], u8::from(bit == 32));
            assert_eq!(bytes[tail[3] + bit], u8::from(bit == 40));
        }
        assert_eq!(bytes[tail[4]], 4);
        assert_eq!(number_at(&bytes, version, tail[5]), 0.75);
        assert_eq!(RobotState::decode(version, &bytes[..size]), Ok(read));
    }
}

// Fails if a field of the command stands at another byte than documented.
#[test]
fn command_has_the_documented_layout() {
    let mut command = RobotCommand::torque(0x1122, [0.0; 7]);
    let numbers = |from: f64, out: &mut [f64]| out.iter_mut().enumerate().for_each(|(i, o)| *o = from + i as f64);
    numbers(100.0, &mut command.q_c);
    numbers(200.0, &mut command.dq_c);
    numbers(300.0, &mut command.O_T_EE_c);
    numbers(400.0, &mut command.O_dP_EE_c);
    numbers(500.0, &mut command.elbow_c);
    numbers(600.0, &mut command.tau_J_d);
    command.valid_elbow = true;
    for version in Version::ALL {
        for (flag, at) in [("motion", 313), ("torque", 370)] {
            let mut command = command.clone();
            command.motion_generation_finished = flag == "motion";
            command.torque_command_finished = flag == "torque" && version >= Version::V7;
            let mut bytes = [0xAA; MAX_COMMAND_SIZE];
            let size = command.encode(version, &mut bytes);
            assert_eq!(size, if version >= Version::V7 { 371 } else { 370 });
            assert_eq!(bytes[..8], 0x1122_u64.to_le_bytes());
            for (from, offset, count) in [
                (100.0, 8, 7),
                (200.0, 64, 7),
                (300.0, 120, 16),
                (400.0, 248, 6),
                (500.0, 296, 2),
                (600.0, 314, 7),
            ] {
                for index in 0..count {
                    assert_eq!(number_at(&bytes, Version::V5, offset + 8 * index), from + index as f64);
                }
            }
            assert_eq!(bytes[312], 1);
            if at < size {
                assert_eq!(bytes[at], 1, "{flag}");
            }
            assert_eq!(RobotCommand::decode(version, &bytes[..size]), Ok(command));
        }
    }
}
