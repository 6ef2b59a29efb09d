//! Both messages against the documented fields, `prost`, and bytes of another encoder; and every decoder against
//! arbitrary bytes.

use proptest::prelude::*;
use prost::Message as _;
use spherecal_fri::wire::*;

/// The documented fields as `prost` messages, written here by hand: the independent reference.
#[allow(clippy::struct_field_names, reason = "the names are those of the documentation")]
mod reference {
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct JointValues {
        #[prost(double, repeated, packed = "false", tag = "1")]
        pub value: Vec<f64>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct PackedValues {
        #[prost(double, repeated, tag = "1")]
        pub value: Vec<f64>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct Header {
        #[prost(uint32, required, tag = "1")]
        pub message_identifier: u32,
        #[prost(uint32, required, tag = "2")]
        pub sequence_counter: u32,
        #[prost(uint32, required, tag = "3")]
        pub reflected_sequence_counter: u32,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct RobotInfo {
        #[prost(int32, optional, tag = "1")]
        pub number_of_joints: Option<i32>,
        #[prost(int32, optional, tag = "2")]
        pub safety_state: Option<i32>,
        #[prost(int32, repeated, packed = "false", tag = "5")]
        pub drive_state: Vec<i32>,
        #[prost(int32, optional, tag = "6")]
        pub operation_mode: Option<i32>,
        #[prost(int32, optional, tag = "7")]
        pub control_mode: Option<i32>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct Timestamp {
        #[prost(uint32, required, tag = "1")]
        pub sec: u32,
        #[prost(uint32, required, tag = "2")]
        pub nanosec: u32,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct MonitorData {
        #[prost(message, optional, tag = "1")]
        pub measured_joint_position: Option<JointValues>,
        #[prost(message, optional, tag = "2")]
        pub measured_torque: Option<JointValues>,
        #[prost(message, optional, tag = "3")]
        pub commanded_joint_position: Option<JointValues>,
        #[prost(message, optional, tag = "4")]
        pub commanded_torque: Option<JointValues>,
        #[prost(message, optional, tag = "5")]
        pub external_torque: Option<JointValues>,
        // Not read by the crate: stands for everything that a cabinet sends beside.
        #[prost(bytes = "vec", repeated, tag = "8")]
        pub read_io_request: Vec<Vec<u8>>,
        #[prost(message, optional, tag = "15")]
        pub timestamp: Option<Timestamp>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct ConnectionInfo {
        #[prost(int32, required, tag = "1")]
        pub session_state: i32,
        #[prost(int32, required, tag = "2")]
        pub quality: i32,
        #[prost(uint32, optional, tag = "3")]
        pub send_period: Option<u32>,
        #[prost(uint32, optional, tag = "4")]
        pub receive_multiplier: Option<u32>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct IpoData {
        #[prost(message, optional, tag = "1")]
        pub joint_position: Option<JointValues>,
        #[prost(int32, optional, tag = "10")]
        pub client_command_mode: Option<i32>,
        #[prost(int32, optional, tag = "11")]
        pub overlay_type: Option<i32>,
        #[prost(double, optional, tag = "12")]
        pub tracking_performance: Option<f64>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct Checksum {
        #[prost(int32, optional, tag = "1")]
        pub crc32: Option<i32>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct EndOfMessageData {
        #[prost(int32, optional, tag = "1")]
        pub message_length: Option<i32>,
        #[prost(message, optional, tag = "2")]
        pub message_checksum: Option<Checksum>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct Monitoring {
        #[prost(message, required, tag = "1")]
        pub header: Header,
        #[prost(message, optional, tag = "2")]
        pub robot_info: Option<RobotInfo>,
        #[prost(message, optional, tag = "3")]
        pub monitor_data: Option<MonitorData>,
        #[prost(message, optional, tag = "4")]
        pub connection_info: Option<ConnectionInfo>,
        #[prost(message, optional, tag = "5")]
        pub ipo_data: Option<IpoData>,
        #[prost(bytes = "vec", repeated, tag = "6")]
        pub requested_transformations: Vec<Vec<u8>>,
        #[prost(message, optional, tag = "15")]
        pub end_of_message_data: Option<EndOfMessageData>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct CommandData {
        #[prost(message, optional, tag = "1")]
        pub joint_position: Option<JointValues>,
        #[prost(message, optional, tag = "2")]
        pub cartesian_wrench_feed_forward: Option<JointValues>,
        #[prost(message, optional, tag = "3")]
        pub joint_torque: Option<JointValues>,
    }
    #[derive(Clone, PartialEq, prost::Message)]
    pub(crate) struct Command {
        #[prost(message, required, tag = "1")]
        pub header: Header,
        #[prost(message, optional, tag = "2")]
        pub command_data: Option<CommandData>,
        #[prost(message, optional, tag = "15")]
        pub end_of_message_data: Option<EndOfMessageData>,
    }
}

use reference as r;

/// A field of values that is there.
#[allow(clippy::unnecessary_wraps, reason = "the fields are optional")]
fn values(v: &[f64]) -> Option<r::JointValues> {
    Some(r::JointValues { value: v.to_vec() })
}

fn sample() -> MonitoringMessage {
    MonitoringMessage {
        sequence: 300,
        reflected_sequence: u32::MAX,
        robot: RobotInfo {
            number_of_joints: Some(7),
            safety: Some(SafetyState::StopLevel1),
            drives: Some([DriveState::Active; 7]),
            operation: Some(OperationMode::Automatic),
            control: Some(ControlMode::JointImpedance),
        },
        measured_position: [0.1, -0.2, 0.3, -0.4, 0.5, -0.6, 0.7],
        measured_torque: [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, 7.0],
        commanded_position: Some([0.0; 7]),
        commanded_torque: Some([-1.0; 7]),
        external_torque: Some([0.5; 7]),
        time: Some(Timestamp {
            sec: 1_700_000_000,
            nanosec: 999_999_999,
        }),
        connection: ConnectionInfo {
            session: SessionState::CommandingActive,
            quality: Quality::Excellent,
            send_period_ms: Some(1),
            receive_multiplier: Some(5),
        },
        ipo: Some(IpoData {
            joint_position: Some([0.25; 7]),
            command_mode: Some(ClientCommandMode::Torque),
            overlay: Some(OverlayType::Joint),
            tracking_performance: Some(0.75),
        }),
        end: None,
    }
}

/// The same content as `sample` in the reference's types.
fn reference_sample() -> r::Monitoring {
    let s = sample();
    r::Monitoring {
        header: r::Header {
            message_identifier: 0x24_5142,
            sequence_counter: 300,
            reflected_sequence_counter: u32::MAX,
        },
        robot_info: Some(r::RobotInfo {
            number_of_joints: Some(7),
            safety_state: Some(2),
            drive_state: vec![2; 7],
            operation_mode: Some(2),
            control_mode: Some(2),
        }),
        monitor_data: Some(r::MonitorData {
            measured_joint_position: values(&s.measured_position),
            measured_torque: values(&s.measured_torque),
            commanded_joint_position: values(&[0.0; 7]),
            commanded_torque: values(&[-1.0; 7]),
            external_torque: values(&[0.5; 7]),
            read_io_request: vec![],
            timestamp: Some(r::Timestamp {
                sec: 1_700_000_000,
                nanosec: 999_999_999,
            }),
        }),
        connection_info: Some(r::ConnectionInfo {
            session_state: 4,
            quality: 3,
            send_period: Some(1),
            receive_multiplier: Some(5),
        }),
        ipo_data: Some(r::IpoData {
            joint_position: values(&[0.25; 7]),
            client_command_mode: Some(3),
            overlay_type: Some(1),
            tracking_performance: Some(0.75),
        }),
        requested_transformations: vec![],
        end_of_message_data: None,
    }
}

fn encoded(message: &MonitoringMessage, checksum: bool) -> Vec<u8> {
    let mut bytes = [0xAA; MAX_MESSAGE_SIZE];
    let size = message.encode(&mut bytes, checksum).expect("it fits");
    bytes[..size].to_vec()
}

// Fails if one byte of the monitoring message differs from what prost writes for the documented fields.
#[test]
fn the_monitoring_message_is_that_of_the_reference() {
    let bytes = encoded(&sample(), false);
    assert_eq!(bytes, reference_sample().encode_to_vec());
    assert_eq!(MonitoringMessage::decode(&bytes), Ok(sample()));
}

// Fails if our bytes differ from those of the cabinet that KUKA's own client accepted.
#[test]
fn the_monitoring_message_is_that_of_the_known_cabinet() {
    let text: String = include_str!("monitoring.hex").split_whitespace().collect();
    let known: Vec<u8> = (0..text.len())
        .step_by(2)
        .map(|i| u8::from_str_radix(&text[i..i + 2], 16).expect("hex"))
        .collect();
    let q = [0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0];
    let message = MonitoringMessage {
        sequence: 300,
        reflected_sequence: 299,
        robot: RobotInfo {
            safety: Some(SafetyState::NormalOperation),
            operation: Some(OperationMode::T1),
            ..sample().robot
        },
        measured_position: q,
        measured_torque: [0.0; 7],
        commanded_position: Some(q),
        commanded_torque: Some([0.0; 7]),
        external_torque: Some([0.0; 7]),
        time: Some(Timestamp {
            sec: 0,
            nanosec: 300_000_000,
        }),
        connection: ConnectionInfo {
            receive_multiplier: Some(1),
            ..sample().connection
        },
        ipo: Some(IpoData {
            joint_position: Some(q),
            tracking_performance: Some(1.0),
            ..sample().ipo.expect("ipo")
        }),
        end: None,
    };
    assert_eq!(MonitoringMessage::decode(&known), Ok(message));
    assert_eq!(encoded(&message, false), known);
}

// Fails if the command message differs from what prost writes, or what we read from it.
#[test]
fn the_command_message_is_that_of_the_reference() {
    let position = [0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7];
    for (torque, wrench) in [
        (None, None),
        (Some([9.0; 7]), None),
        (None, Some([1.0, 2.0, 3.0, 4.0, 5.0, 6.0])),
    ] {
        let command = CommandMessage {
            sequence: 5,
            reflected_sequence: 70_000,
            joint_position: Some(position),
            wrench,
            joint_torque: torque,
            end: None,
        };
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        let size = command.encode(&mut bytes, false).expect("it fits");
        let reference = r::Command {
            header: r::Header {
                message_identifier: 0x3_4001,
                sequence_counter: 5,
                reflected_sequence_counter: 70_000,
            },
            command_data: Some(r::CommandData {
                joint_position: values(&position),
                cartesian_wrench_feed_forward: wrench.and_then(|w| values(&w)),
                joint_torque: torque.and_then(|t| values(&t)),
            }),
            end_of_message_data: None,
        };
        assert_eq!(bytes[..size], reference.encode_to_vec());
        assert_eq!(CommandMessage::decode(&bytes[..size]), Ok(command));
    }
}

// Fails if length or checksum are not those of the bytes before the field, or a damaged message is said to match.
#[test]
fn the_end_of_a_message_carries_length_and_checksum() {
    let plain = encoded(&sample(), false);
    let bytes = encoded(&sample(), true);
    assert_eq!(bytes[..plain.len()], plain);
    let reference = r::Monitoring::decode(&bytes[..]).expect("prost reads it");
    let end = reference.end_of_message_data.expect("an end");
    assert_eq!(end.message_length, Some(plain.len() as i32));
    // CRC-32 of IEEE 802.3, bit by bit.
    let crc = !plain.iter().fold(!0_u32, |crc, byte| {
        (0..8).fold(crc ^ u32::from(*byte), |c, _| {
            if c & 1 == 1 { 0xEDB8_8320 ^ (c >> 1) } else { c >> 1 }
        })
    });
    assert_eq!(end.message_checksum.expect("a checksum").crc32, Some(crc as i32));
    let decoded = MonitoringMessage::decode(&bytes)
        .expect("a message")
        .end
        .expect("an end");
    assert_eq!(
        (decoded.length, decoded.crc32, decoded.checksum),
        (Some(plain.len() as i32), Some(crc), Checksum::Matches)
    );
    let mut damaged = bytes;
    // The last byte of the interpolator's tracking performance.
    damaged[plain.len() - 3] ^= 1;
    let decoded = MonitoringMessage::decode(&damaged)
        .expect("a message")
        .end
        .expect("an end");
    assert_eq!(decoded.checksum, Checksum::Differs);
    let mut command = [0; MAX_MESSAGE_SIZE];
    let size = CommandMessage::default().encode(&mut command, true).expect("it fits");
    let decoded = CommandMessage::decode(&command[..size])
        .expect("a command")
        .end
        .expect("an end");
    assert_eq!(decoded.checksum, Checksum::Matches);
}

// Fails if fields that a cabinet sends beside stop the decoder, or packed values are not read.
#[test]
fn other_fields_are_skipped_and_packed_values_are_read() {
    let mut reference = reference_sample();
    reference.requested_transformations = vec![vec![1, 2, 3]];
    reference.monitor_data.as_mut().expect("data").read_io_request = vec![vec![0x0A, 0x01, 0x41]; 3];
    let mut bytes = reference.encode_to_vec();
    // A field of a later version: number 100, a varint; number 101, 32 bits.
    bytes.extend([0xA0, 0x06, 0x07, 0xAD, 0x06, 1, 2, 3, 4]);
    assert_eq!(MonitoringMessage::decode(&bytes), Ok(sample()));

    let packed = r::PackedValues { value: vec![1.5; 7] }.encode_to_vec();
    let mut data = vec![0x0A, packed.len() as u8];
    data.extend(packed);
    let header = r::Header {
        message_identifier: 0x3_4001,
        sequence_counter: 1,
        reflected_sequence_counter: 2,
    };
    let mut bytes = vec![0x0A, header.encoded_len() as u8];
    bytes.extend(header.encode_to_vec());
    bytes.extend([0x12, data.len() as u8]);
    bytes.extend(data);
    assert_eq!(
        CommandMessage::decode(&bytes).expect("a command").joint_position,
        Some([1.5; 7])
    );
}

// Fails if a message that lacks something, has too much, or has a number that is none is accepted, or its error does
// not name the field.
#[test]
fn incomplete_messages_are_refused_by_name() {
    let refused = |change: &dyn Fn(&mut r::Monitoring)| {
        let mut reference = reference_sample();
        change(&mut reference);
        MonitoringMessage::decode(&reference.encode_to_vec()).expect_err("refused")
    };
    let field = |change: &dyn Fn(&mut r::Monitoring)| refused(change).to_string();
    assert!(field(&|m| m.header.message_identifier = 0x3_4001).contains("0x34001"));
    assert!(field(&|m| m.connection_info = None).contains("connectionInfo"));
    assert!(field(&|m| m.monitor_data = None).contains("measuredJointPosition"));
    assert!(field(&|m| m.monitor_data.as_mut().expect("data").measured_torque = None).contains("measuredTorque"));
    for count in [0, 6, 8] {
        let error =
            refused(&|m| m.monitor_data.as_mut().expect("data").measured_joint_position = values(&vec![0.0; count]));
        assert_eq!(
            error,
            WireError::Count {
                field: "measuredJointPosition",
                expected: 7,
                got: count
            }
        );
        let error = refused(&|m| {
            m.robot_info.as_mut().expect("info").drive_state = vec![0; if count == 0 { 1 } else { count }];
        });
        assert!(matches!(
            error,
            WireError::Count {
                field: "driveState",
                ..
            }
        ));
    }
    for bad in [f64::NAN, f64::INFINITY] {
        let mut torque = vec![0.0; 7];
        torque[6] = bad;
        let error = refused(&|m| m.monitor_data.as_mut().expect("data").measured_torque = values(&torque));
        assert_eq!(
            error,
            WireError::NotFinite {
                field: "measuredTorque",
                index: 6
            }
        );
        let error = refused(&|m| m.ipo_data.as_mut().expect("ipo").tracking_performance = Some(bad));
        assert!(matches!(
            error,
            WireError::NotFinite {
                field: "trackingPerformance",
                ..
            }
        ));
    }
    let error = refused(&|m| m.connection_info.as_mut().expect("info").session_state = 5);
    assert_eq!(
        error,
        WireError::UnknownValue {
            field: "sessionState",
            value: 5
        }
    );
    let error = refused(&|m| m.robot_info.as_mut().expect("info").safety_state = Some(4));
    assert_eq!(
        error,
        WireError::UnknownValue {
            field: "safetyState",
            value: 4
        }
    );
    let long = MonitoringMessage::decode(&[0; MAX_MESSAGE_SIZE + 1]);
    assert_eq!(
        long,
        Err(WireError::TooLong {
            got: MAX_MESSAGE_SIZE + 1
        })
    );
    assert_eq!(
        MonitoringMessage::decode(&[]),
        Err(WireError::Missing { field: "header" })
    );
}

// Fails if a message cut anywhere panics, or passes as whole.
#[test]
fn cut_messages_are_refused() {
    let bytes = encoded(&sample(), true);
    let end = encoded(&sample(), false).len();
    for size in 0..bytes.len() {
        let cut = MonitoringMessage::decode(&bytes[..size]);
        // Protocol buffers have no end of their own: what is cut between two fields of the message reads as if the rest
        // had not been sent. Without measurement or connection it is refused all the same.
        let whole_fields = cut.is_ok();
        assert!(
            !whole_fields || size == end || cut.is_ok_and(|m| m.ipo.is_none()),
            "{size}"
        );
    }
}

// Fails if a known message changes a number: the names of users' manuals.
#[test]
fn enumerations_have_the_documented_numbers() {
    assert_eq!(
        SessionState::ALL.iter().map(|s| s.name()).collect::<Vec<_>>(),
        [
            "IDLE",
            "MONITORING_WAIT",
            "MONITORING_READY",
            "COMMANDING_WAIT",
            "COMMANDING_ACTIVE"
        ]
    );
    assert_eq!(
        Quality::ALL.iter().map(|s| s.name()).collect::<Vec<_>>(),
        ["POOR", "FAIR", "GOOD", "EXCELLENT"]
    );
    assert_eq!(
        OperationMode::ALL.iter().map(|s| s.name()).collect::<Vec<_>>(),
        ["T1", "T2", "AUT"]
    );
    for (number, session) in SessionState::ALL.iter().enumerate() {
        assert_eq!(session.number(), number as u64);
    }
    assert_eq!(ClientCommandMode::from_number(3), Ok(ClientCommandMode::Torque));
    assert_eq!(ControlMode::from_number(2), Ok(ControlMode::JointImpedance));
    assert_eq!(SafetyState::from_number(0), Ok(SafetyState::NormalOperation));
}

proptest! {
    // Fails if a decoder panics, or what it accepts is not what it would write.
    #[test]
    fn decoders_are_total(data in prop::collection::vec(any::<u8>(), 0..400)) {
        fuzz_decode(&data);
    }

    // The same with damaged messages, which come further.
    #[test]
    fn damaged_messages_do_no_harm(changes in prop::collection::vec((any::<prop::sample::Index>(), any::<u8>()), 0..6)) {
        let mut bytes = encoded(&sample(), true);
        for (place, value) in changes {
            let at = place.index(bytes.len());
            bytes[at] = value;
        }
        fuzz_decode(&bytes);
    }

    // Fails if prost and this crate disagree about a command.
    #[test]
    fn commands_agree_with_the_reference(
        sequence in any::<u32>(),
        reflected in any::<u32>(),
        position in prop::array::uniform7(-3.0..3.0),
        torque in prop::option::of(prop::array::uniform7(-300.0..300.0)),
    ) {
        let command = CommandMessage {
            sequence,
            reflected_sequence: reflected,
            joint_position: Some(position),
            wrench: None,
            joint_torque: torque,
            end: None,
        };
        let mut bytes = [0; MAX_MESSAGE_SIZE];
        let size = command.encode(&mut bytes, false).expect("it fits");
        let read = r::Command::decode(&bytes[..size]).expect("prost reads it");
        prop_assert_eq!(read.header.sequence_counter, sequence);
        prop_assert_eq!(read.header.reflected_sequence_counter, reflected);
        let data = read.command_data.expect("data");
        prop_assert_eq!(data.joint_position.expect("positions").value, position.to_vec());
        prop_assert_eq!(data.joint_torque.map(|t| t.value), torque.map(|t| t.to_vec()));
    }
}
