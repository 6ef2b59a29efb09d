//! What decoders take and refuse.

use proptest::prelude::*;
use prost::Message as _;
use spherecal_fri::wire::*;

use super::{encoded, reference as r, reference_sample, sample, values};

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
