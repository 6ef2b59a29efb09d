//! Both messages against the documented fields, `prost`, and bytes of another encoder; and every decoder against
//! arbitrary bytes.

mod decoding;
mod reference;

use prost::Message as _;
use spherecal_fri::wire::*;

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
    let text: String = include_str!("../../monitoring.hex").split_whitespace().collect();
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
