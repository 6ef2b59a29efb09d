//! Requests and responses of the TCP channel.

use spherecal_fci::wire::*;

use super::number_at;

// Fails if a command has another number than documented, or a request another size.
#[test]
fn requests_have_the_documented_numbers_and_sizes() {
    let thresholds = CollisionBehavior::uniform([1.0; 7], [2.0; 7], [3.0; 6], [4.0; 6]);
    let load = FlangeLoad {
        mass: 1.5,
        centre_of_mass: [0.1, 0.2, 0.3],
        inertia: [0.0; 9],
    };
    // Request; number in the versions 4 and 5, 6 and 7, 8 and 9, 10; size of the message, header included (version 10 apart).
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
        for version in Version::ALL {
            let number = match version {
                Version::V4 | Version::V5 => numbers[0],
                Version::V6 | Version::V7 => numbers[1],
                Version::V8 | Version::V9 => numbers[2],
                Version::V10 => numbers[3],
            };
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
            for (n, status) in Status::all(command, version).enumerate() {
                assert_eq!(status.number(command, version), n as u8);
                assert_eq!(Status::from_number(n as u8, command, version), Ok(status));
            }
            assert!(Status::from_number(200, command, version).is_err());
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
    let header = CommandHeader::decode(&bytes, spherecal_budget::robot::RESPONSE_BYTES).expect("a header");
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
