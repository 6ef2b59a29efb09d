//! Bytes that are no message, and names of errors.

use proptest::prelude::*;
use spherecal_fci::wire::*;

use super::tail;

// Fails if a NaN or an infinity of a field that control reads passes, or if one of an unused field is refused.
#[test]
fn non_finite_numbers_are_refused_where_control_reads_them() {
    for version in Version::ALL {
        for (number, info) in RobotState::FIELDS.iter().enumerate() {
            for bad in [f64::NAN, f64::INFINITY, f64::NEG_INFINITY] {
                let mut state = RobotState::default();
                let last = info.count - 1;
                state.numbers_mut()[number][last] = bad;
                let mut bytes = [0; MAX_STATE_SIZE];
                let size = state.encode(version, &mut bytes);
                let decoded = RobotState::decode(version, &bytes[..size]);
                if info.checked {
                    assert_eq!(
                        decoded,
                        Err(WireError::NotFinite {
                            field: info.name,
                            index: last
                        })
                    );
                } else {
                    assert!(decoded.is_ok(), "{}", info.name);
                }
            }
        }
        let state = RobotState {
            control_command_success_rate: f64::NAN,
            ..RobotState::default()
        };
        let mut bytes = [0; MAX_STATE_SIZE];
        let size = state.encode(version, &mut bytes);
        assert!(RobotState::decode(version, &bytes[..size]).is_err());

        let command = RobotCommand::torque(1, [0.0, 0.0, f64::NAN, 0.0, 0.0, 0.0, 0.0]);
        let mut bytes = [0; MAX_COMMAND_SIZE];
        let size = command.encode(version, &mut bytes);
        let refused = Err(WireError::NotFinite {
            field: "tau_J_d",
            index: 2,
        });
        assert_eq!(RobotCommand::decode(version, &bytes[..size]), refused);
    }
    for field in ["q", "dq", "tau_J", "tau_J_d"] {
        assert!(
            RobotState::FIELDS.iter().any(|f| f.name == field && f.checked),
            "{field}"
        );
    }
}

// Fails if a state with an unknown mode is taken for a known one.
#[test]
fn unknown_modes_are_refused() {
    for version in Version::ALL {
        let tail = tail(version);
        for (at, field, value) in [
            (tail[0], "motion_generator_mode", 6),
            (tail[1], "controller_mode", 4),
            (tail[4], "robot_mode", 7),
        ] {
            let mut bytes = [0; MAX_STATE_SIZE];
            let size = RobotState::default().encode(version, &mut bytes);
            bytes[at] = value;
            let refused = Err(WireError::UnknownValue {
                field,
                value: value.into(),
            });
            assert_eq!(RobotState::decode(version, &bytes[..size]), refused);
        }
    }
}

// Fails if two errors share a name or a bit, or if a name has changed.
#[test]
fn errors_have_distinct_names() {
    let mut names: Vec<&str> = ErrorFlag::ALL.iter().map(|e| e.name()).collect();
    for (bit, error) in ErrorFlag::ALL.iter().enumerate() {
        assert_eq!(error.bit(), bit);
    }
    for (bit, name) in [
        (6, "joint_reflex"),
        (25, "communication_constraints_violation"),
        (34, "tau_j_range_violation"),
    ] {
        assert_eq!(names[bit], name);
    }
    names.sort_unstable();
    names.dedup();
    assert_eq!(names.len(), 41);
    let two = ErrorSet::of(ErrorFlag::JointReflex).with(ErrorSet::of(ErrorFlag::PowerLimitViolation));
    assert_eq!(two.to_string(), "joint_reflex, power_limit_violation");
    assert_eq!(ErrorSet::NONE.to_string(), "no error");
}

fn version() -> impl Strategy<Value = Version> {
    prop::sample::select(Version::ALL.to_vec())
}

proptest! {
    // Fails if any decoder panics, or accepts bytes that it would not write itself.
    #[test]
    fn decoders_are_total(data in prop::collection::vec(any::<u8>(), 0..600)) {
        fuzz_decode(&data);
    }

    // The same with bytes of the right size, so that decoding comes to its end.
    #[test]
    fn decoders_are_total_at_the_right_size(
        version in version(),
        mut data in prop::collection::vec(any::<u8>(), MAX_STATE_SIZE),
        modes in any::<[u8; 3]>(),
    ) {
        let tail = tail(version);
        data[tail[0]] = modes[0] % 8;
        data[tail[1]] = modes[1] % 5;
        data[tail[4]] = modes[2] % 8;
        let _ = RobotState::decode(version, &data[..version.state_size()]);
        let _ = RobotCommand::decode(version, &data[..version.command_size()]);
        for number in 0..16_u32 {
            for size in [0, 2, 3, 4, 7, 40, 48, 56, 104, 113, 128, 416] {
                let _ = Request::decode(version, number, &data[..size]);
                let header = CommandHeader { command: number, id: 1, size: size as u32 + 12 };
                let _ = Response::decode(version, header, &data[..size]);
            }
        }
    }

    // Fails if a command is changed by encoding and decoding.
    #[test]
    fn commands_survive(
        version in version(),
        message_id in any::<u64>(),
        torque in prop::array::uniform7(-100.0..100.0),
        ends in any::<bool>(),
    ) {
        let mut command = RobotCommand::torque(message_id, torque);
        if ends {
            command = command.finished(version);
        }
        let mut bytes = [0; MAX_COMMAND_SIZE];
        let size = command.encode(version, &mut bytes);
        prop_assert_eq!(RobotCommand::decode(version, &bytes[..size]), Ok(command));
    }

    // Fails if a wrong size passes for a state or a command.
    #[test]
    fn wrong_sizes_are_refused(version in version(), size in 0_usize..3000) {
        let data = vec![0; size];
        prop_assert_eq!(RobotState::decode(version, &data).is_ok(), size == version.state_size());
        prop_assert_eq!(RobotCommand::decode(version, &data).is_ok(), size == version.command_size());
    }
}
