//! Every message against the documented layout, byte by byte, and every decoder against arbitrary bytes.

use proptest::prelude::*;
use spherecal_fci::wire::*;

/// Field, offset in the versions 5, 7 and 8 (f64), offset in version 10 (f32): from the documented layout, not from the
/// crate's own table.
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
];

/// First byte of: motion generator mode, controller mode, errors, reflex reason, robot mode, success rate.
const TAIL_F64: [usize; 6] = [2280, 2281, 2282, 2323, 2364, 2365];
const TAIL_F32: [usize; 6] = [1288, 1289, 1290, 1331, 1372, 1373];

fn state_with_pattern() -> RobotState {
    let mut state = RobotState {
        message_id: 0x0102_0304_0506_0708,
        motion_generator_mode: MotionGeneratorMode::None,
        controller_mode: ControllerMode::External,
        errors: ErrorSet::of(RobotError::ControllerTorqueDiscontinuity),
        reflex_reason: ErrorSet::of(RobotError::BaseAccelerationInvalidReading),
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

fn number_at(bytes: &[u8], version: Version, offset: usize) -> f64 {
    if version == Version::V10 {
        f32::from_le_bytes(bytes[offset..offset + 4].try_into().expect("4 bytes")).into()
    } else {
        f64::from_le_bytes(bytes[offset..offset + 8].try_into().expect("8 bytes"))
    }
}

// Fails if a field of the state stands at another byte than documented, in any version.
#[test]
fn state_has_the_documented_layout() {
    let state = state_with_pattern();
    assert_eq!(RobotState::FIELDS.len(), STATE_LAYOUT.len());
    for version in Version::ALL {
        let mut bytes = [0xAA; MAX_STATE_SIZE];
        let size = state.encode(version, &mut bytes);
        let (expected, step, tail) = match version {
            Version::V10 => (1377, 4, TAIL_F32),
            _ => (2373, 8, TAIL_F64),
        };
        assert_eq!(size, expected);
        assert_eq!(bytes[..8], 0x0102_0304_0506_0708_u64.to_le_bytes());
        for (field, (info, (name, f64_at, f32_at))) in RobotState::FIELDS.iter().zip(STATE_LAYOUT).enumerate() {
            let offset = if version == Version::V10 { *f32_at } else { *f64_at };
            assert_eq!(info.name, *name);
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
        for bit in 0..41 {
            assert_eq!(bytes[tail[2] + bit], u8::from(bit == 32));
            assert_eq!(bytes[tail[3] + bit], u8::from(bit == 40));
        }
        assert_eq!(bytes[tail[4]], 4);
        assert_eq!(number_at(&bytes, version, tail[5]), 0.75);
        assert_eq!(RobotState::decode(version, &bytes[..size]), Ok(state.clone()));
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
            command.torque_command_finished = flag == "torque" && version != Version::V5;
            let mut bytes = [0xAA; MAX_COMMAND_SIZE];
            let size = command.encode(version, &mut bytes);
            assert_eq!(size, if version == Version::V5 { 370 } else { 371 });
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

// Fails if a command has another number than documented, or a request another size.
#[test]
fn requests_have_the_documented_numbers_and_sizes() {
    let thresholds = CollisionBehavior::uniform([1.0; 7], [2.0; 7], [3.0; 6], [4.0; 6]);
    let load = FlangeLoad {
        mass: 1.5,
        centre_of_mass: [0.1, 0.2, 0.3],
        inertia: [0.0; 9],
    };
    // Request; number in the versions 5, 7, 8, 10; size of the message, header included (version 10 apart).
    let none = u32::MAX;
    let table = [
        (
            Request::Connect {
                version: 5,
                udp_port: 0x1234,
            },
            [0, 0, 0, 0],
            16,
        ),
        (Request::Move(MoveRequest::torque(Version::V7)), [1, 1, 1, 1], 68),
        (Request::StopMove, [2, 2, 2, 2], 12),
        (Request::GetCartesianLimit { id: -2 }, [3, none, none, none], 16),
        (Request::SetCollisionBehavior(thresholds), [4, 3, 3, 3], 428),
        (Request::SetJointImpedance([5.0; 7]), [5, 4, 4, 4], 68),
        (Request::SetCartesianImpedance([6.0; 6]), [6, 5, 5, 5], 60),
        (
            Request::SetGuidingMode {
                axes: [true; 6],
                nullspace: false,
            },
            [7, 6, 6, 6],
            19,
        ),
        (Request::SetEeToK([7.0; 16]), [8, 7, 7, 7], 140),
        (Request::SetNeToEe([8.0; 16]), [9, 8, 8, 8], 140),
        (Request::SetLoad(load), [10, 9, 9, 9], 116),
        (Request::SetFilters([9.0; 5]), [11, none, none, none], 52),
        (Request::AutomaticErrorRecovery, [12, 10, 10, 10], 12),
        (
            Request::LoadModelLibrary {
                architecture: 0,
                system: 1,
            },
            [13, 11, 11, none],
            14,
        ),
        (Request::GetRobotModel, [none, none, 12, 11], 12),
    ];
    for (request, numbers, size) in table {
        for (version, number) in [Version::V5, Version::V7, Version::V8, Version::V10]
            .into_iter()
            .zip(numbers)
        {
            let mut bytes = vec![0xEE];
            let encoded = request.encode(version, 0xABCD_EF01, &mut bytes);
            if number == none {
                let missing = WireError::NotInVersion {
                    command: request.command().name(),
                    version,
                };
                assert_eq!(encoded, Err(missing));
                continue;
            }
            assert_eq!(encoded, Ok(()));
            let bytes = &bytes[1..];
            let is_move_v10 = version == Version::V10 && matches!(request, Request::Move(_));
            assert_eq!(
                bytes.len(),
                if is_move_v10 { 125 } else { size },
                "{}",
                request.command()
            );
            assert_eq!(bytes[..4], number.to_le_bytes());
            assert_eq!(bytes[4..8], 0xABCD_EF01_u32.to_le_bytes());
            assert_eq!(bytes[8..12], (bytes.len() as u32).to_le_bytes());
            assert_eq!(Request::decode(version, number, &bytes[12..]), Ok(request));
        }
    }
}

// Fails if the arguments of a request stand in another order than documented.
#[test]
fn arguments_stand_in_the_documented_order() {
    let f64_at = |bytes: &[u8], at: usize| number_at(bytes, Version::V5, at);
    let mut bytes = Vec::new();
    Request::Connect {
        version: 10,
        udp_port: 0x1234,
    }
    .encode(Version::V5, 1, &mut bytes)
    .expect("Connect");
    assert_eq!(bytes[12..], [10, 0, 0x34, 0x12]);

    bytes.clear();
    Request::Move(MoveRequest::torque(Version::V10))
        .encode(Version::V10, 1, &mut bytes)
        .expect("Move");
    assert_eq!(bytes[12..20], [2, 0, 0, 0, 4, 0, 0, 0]);
    let limits: Vec<f64> = (0..6).map(|i| f64_at(&bytes, 20 + 8 * i)).collect();
    assert_eq!(
        limits,
        [10.0, 3.12, std::f64::consts::TAU, 10.0, 3.12, std::f64::consts::TAU]
    );
    assert!(bytes[68..].iter().all(|b| *b == 0));
    bytes.clear();
    Request::Move(MoveRequest::torque(Version::V5))
        .encode(Version::V5, 1, &mut bytes)
        .expect("Move");
    assert_eq!(bytes[12..20], [2, 0, 0, 0, 1, 0, 0, 0]);

    let behavior = CollisionBehavior {
        lower_torque_acceleration: [1.0; 7],
        upper_torque_acceleration: [2.0; 7],
        lower_torque_nominal: [3.0; 7],
        upper_torque_nominal: [4.0; 7],
        lower_force_acceleration: [5.0; 6],
        upper_force_acceleration: [6.0; 6],
        lower_force_nominal: [7.0; 6],
        upper_force_nominal: [8.0; 6],
    };
    bytes.clear();
    Request::SetCollisionBehavior(behavior)
        .encode(Version::V8, 1, &mut bytes)
        .expect("SetCollisionBehavior");
    let starts = [12, 68, 124, 180, 236, 284, 332, 380];
    let order: Vec<f64> = starts.iter().map(|at| f64_at(&bytes, *at)).collect();
    assert_eq!(order, [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0]);

    let load = FlangeLoad {
        mass: 1.5,
        centre_of_mass: [0.1, 0.2, 0.3],
        inertia: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0],
    };
    bytes.clear();
    Request::SetLoad(load)
        .encode(Version::V10, 1, &mut bytes)
        .expect("SetLoad");
    let values: Vec<f64> = (0..13).map(|i| f64_at(&bytes, 12 + 8 * i)).collect();
    assert_eq!(
        values,
        [1.5, 0.1, 0.2, 0.3, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0, 8.0, 9.0]
    );
}

// Fails if a status has another number than the official clients take it for.
#[test]
fn statuses_have_the_documented_numbers() {
    use Status as S;
    let number = |status: Status, command, version| status.number(command, version);
    for (status, v5, later) in [
        (S::Success, 0, 0),
        (S::MotionStarted, 1, 1),
        (S::Preempted, 2, 2),
        (S::NotPossible, 3, 5),
        (S::StartAtSingularPose, 4, 6),
        (S::InvalidArgument, 5, 7),
        (S::ReflexAborted, 6, 8),
        (S::EmergencyAborted, 7, 9),
        (S::InputErrorAborted, 8, 10),
        (S::Aborted, 9, 11),
    ] {
        assert_eq!(number(status, CommandKind::Move, Version::V5), v5);
        for version in [Version::V7, Version::V8, Version::V10] {
            assert_eq!(number(status, CommandKind::Move, version), later);
        }
    }
    assert_eq!(number(S::PreemptedBySafetyFunction, CommandKind::Move, Version::V7), 3);
    assert_eq!(number(S::PreemptedBySafetyFunction, CommandKind::Move, Version::V5), 2);
    assert_eq!(number(S::RejectedBySafetyFunction, CommandKind::Move, Version::V10), 4);
    assert_eq!(number(S::ReflexAborted, CommandKind::StopMove, Version::V5), 3);
    assert_eq!(number(S::ReflexAborted, CommandKind::StopMove, Version::V10), 4);
    assert_eq!(
        number(
            S::ManualRecoveryRequired,
            CommandKind::AutomaticErrorRecovery,
            Version::V5
        ),
        2
    );
    assert_eq!(
        number(
            S::ManualRecoveryRequired,
            CommandKind::AutomaticErrorRecovery,
            Version::V10
        ),
        3
    );
    assert_eq!(number(S::InvalidArgument, CommandKind::SetLoad, Version::V5), 2);
    assert_eq!(
        number(S::RejectedBySafetyFunction, CommandKind::SetLoad, Version::V10),
        3
    );
    assert_eq!(number(S::IncompatibleVersion, CommandKind::Connect, Version::V5), 1);
    for version in Version::ALL {
        for command in CommandKind::all(version) {
            for (n, status) in Status::all(*command, version).iter().enumerate() {
                assert_eq!(status.number(*command, version), n as u8);
                assert_eq!(Status::from_number(n as u8, *command, version), Ok(*status));
            }
            assert!(Status::from_number(200, *command, version).is_err());
        }
    }
}

// Fails if a response is cut, padded or read with the wrong header.
#[test]
fn responses_are_read_as_written() {
    let urdf = "<robot name=\"fr3\"/>";
    let response = Response {
        command: CommandKind::GetRobotModel,
        id: 7,
        status: Status::Success,
        body: urdf.as_bytes(),
    };
    let mut bytes = Vec::new();
    response.encode(Version::V10, &mut bytes).expect("a response");
    assert_eq!(
        bytes[..13],
        [11, 0, 0, 0, 7, 0, 0, 0, 12 + 1 + urdf.len() as u8, 0, 0, 0, 0]
    );
    let header = CommandHeader::decode(&bytes, MAX_RESPONSE).expect("a header");
    let back = Response::decode(Version::V10, header, &bytes[12..]).expect("a response");
    assert_eq!(back, response);
    assert_eq!(back.robot_model(), Ok(urdf));
    let cut = Response::decode(Version::V10, header, &bytes[12..20]);
    assert!(matches!(cut, Err(WireError::Length { .. })), "{cut:?}");
    let binary = Response {
        body: &[0xFF, 0xFE],
        ..response
    };
    assert_eq!(binary.robot_model(), Err(WireError::NotText));
    let answer = ConnectAnswer::decode(&[1, 10, 0]);
    assert_eq!(
        answer,
        Ok(ConnectAnswer {
            status: Status::IncompatibleVersion,
            version: 10
        })
    );
    assert!(ConnectAnswer::decode(&[1, 10]).is_err());
    assert!(ConnectAnswer::decode(&[1, 10, 0, 0]).is_err());
}

// Fails if a header may announce a size that would make a receiver allocate without bound.
#[test]
fn absurd_sizes_are_refused() {
    for size in [0, 11, MAX_REQUEST as u32 + 1, u32::MAX] {
        let bytes = CommandHeader {
            command: 0,
            id: 0,
            size,
        }
        .encode();
        assert!(
            matches!(CommandHeader::decode(&bytes, MAX_REQUEST), Err(WireError::Size { .. })),
            "{size}"
        );
    }
    assert!(CommandHeader::decode(&[0; 11], MAX_REQUEST).is_err());
}

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
    for (version, tail) in [(Version::V5, TAIL_F64), (Version::V10, TAIL_F32)] {
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

// Fails if an angle of version 10 is further from the true one than half a step of a 32-bit float. Says what the
// documentation says: 2.4e-7 rad at 3 rad.
#[test]
fn angles_of_version_10_have_the_documented_step() {
    let mut state = RobotState::default();
    let mut worst: f64 = 0.0;
    for k in 0..1000 {
        let angle = 2.9 + 1e-4 * f64::from(k) + 1.234_567_89e-8;
        state.q = [angle; 7];
        let mut bytes = [0; MAX_STATE_SIZE];
        let size = state.encode(Version::V10, &mut bytes);
        let back = RobotState::decode(Version::V10, &bytes[..size]).expect("a state");
        worst = worst.max((back.q[0] - angle).abs());
        let size = state.encode(Version::V5, &mut bytes);
        assert_eq!(
            RobotState::decode(Version::V5, &bytes[..size]).expect("a state").q,
            state.q
        );
    }
    let step = 2.0_f64.powi(-22);
    assert!((step - 2.4e-7).abs() < 1e-8);
    assert!(worst <= step / 2.0, "{worst:e}");
    assert!(worst > step / 8.0, "{worst:e}");
}

// Fails if the rounding of version 10 changes the mean of a noisy recording of 1 s by more than 1e-8 rad.
#[test]
fn a_noisy_recording_averages_the_step_of_version_10_away() {
    let mut seed = 1_u64;
    // Twelve uniform numbers make a nearly normal one.
    let mut normal = || {
        let mut sum = -6.0;
        for _ in 0..12 {
            seed = seed
                .wrapping_mul(6_364_136_223_846_793_005)
                .wrapping_add(1_442_695_040_888_963_407);
            sum += (seed >> 11) as f64 / (1_u64 << 53) as f64;
        }
        sum
    };
    for angle in [0.1, 1.0, 2.9, -3.01] {
        let mut error = 0.0;
        for _ in 0..1000 {
            let mut state = RobotState {
                q: [angle + 1e-5 * normal(); 7],
                ..RobotState::default()
            };
            let exact = state.q[0];
            let mut bytes = [0; MAX_STATE_SIZE];
            let size = state.encode(Version::V10, &mut bytes);
            state = RobotState::decode(Version::V10, &bytes[..size]).expect("a state");
            error += (state.q[0] - exact) / 1000.0;
        }
        assert!(error.abs() < 1e-8, "{angle}: {error:e}");
    }
}

// Fails if two errors share a name or a bit, or if a name has changed.
#[test]
fn errors_have_distinct_names() {
    let mut names: Vec<&str> = RobotError::ALL.iter().map(|e| e.name()).collect();
    for (bit, error) in RobotError::ALL.iter().enumerate() {
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
    let two = ErrorSet::of(RobotError::JointReflex).with(ErrorSet::of(RobotError::PowerLimitViolation));
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
        let tail = if version == Version::V10 { TAIL_F32 } else { TAIL_F64 };
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
