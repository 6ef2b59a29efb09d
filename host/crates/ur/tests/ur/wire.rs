//! Packages against bytes that `struct` of Python packed, and against hostile bytes.

use proptest::prelude::*;
use spherecal_ur::wire::primary::take_primary;
use spherecal_ur::wire::*;

fn hex(text: &str) -> Vec<u8> {
    let byte = |k: usize| u8::from_str_radix(&text[k..k + 2], 16).expect("hexadecimal digits");
    (0..text.len()).step_by(2).map(byte).collect()
}

/// The only package in these bytes.
fn open(bytes: &[u8]) -> (PackageKind, Vec<u8>) {
    let mut received = bytes.to_vec();
    let package = take_package(&mut received, MAX_ANSWER)
        .expect("a package")
        .expect("a whole one");
    assert!(received.is_empty());
    package
}

// Fails if a request has another kind, size, order or byte order than Python's `struct` gives it.
#[test]
fn requests_have_the_bytes_of_python() {
    let outputs = Request::SetupOutputs {
        rate_hz: 500.0,
        names: vec!["timestamp".to_owned(), "actual_q".to_owned()],
    };
    for (request, bytes) in [
        (Request::ProtocolVersion(2), "0005560002"),
        (outputs, "001d4f407f40000000000074696d657374616d702c61637475616c5f71"),
    ] {
        assert_eq!(request.encode(), hex(bytes));
        let (kind, payload) = open(&hex(bytes));
        assert_eq!(Request::decode(kind, &payload), Ok(request));
    }
}

// Fails if an answer is read or written other than Python's `struct` packs it.
#[test]
fn answers_have_the_bytes_of_python() {
    let setup = Setup {
        recipe: 1,
        types: vec!["DOUBLE".to_owned(), "VECTOR6D".to_owned()],
    };
    let version = ControllerVersion {
        major: 5,
        minor: 25,
        bugfix: 1,
        build: 130_000,
    };
    let message = TextMessage {
        message: "hi".to_owned(),
        source: "RTDE".to_owned(),
        level: TextLevel::Warning,
    };
    for (answer, bytes) in [
        (Answer::SetupOutputs(setup), "00134f01444f55424c452c564543544f523644"),
        (
            Answer::ControllerVersion(version),
            "0013760000000500000019000000010001fbd0",
        ),
        (Answer::Text(message), "000c4d026869045254444502"),
    ] {
        assert_eq!(answer.encode(), hex(bytes));
        let (kind, payload) = open(&hex(bytes));
        assert_eq!(Answer::decode(kind, &payload), Ok(answer));
    }
    let data = "003c55013ff80000000000000000000000000000bff91eb851eb851f3ff91eb851eb851f00000000000000003fd00000000000004008000000000000";
    let Ok(Answer::Data(1, values)) = Answer::decode(open(&hex(data)).0, &open(&hex(data)).1) else {
        panic!("no data package");
    };
    let recipe = Recipe {
        fields: vec![
            ("timestamp".to_owned(), FieldType::Double),
            ("actual_q".to_owned(), FieldType::Vector6D),
        ],
    };
    let expected = [Value::Double(1.5), Value::Vector6D([0.0, -1.57, 1.57, 0.0, 0.25, 3.0])];
    assert_eq!(recipe.decode(&values).expect("values"), expected);
    assert!(recipe.decode(&values[1..]).is_err() && recipe.decode(&[values.as_slice(), &[0]].concat()).is_err());
}

// Fails if a value of any type does not come back, or has another size than its type.
#[test]
fn every_type_of_value_comes_back() {
    let values = [
        Value::Bool(true),
        Value::Uint8(7),
        Value::Uint32(4_000_000_000),
        Value::Uint64(1 << 60),
        Value::Int32(-5),
        Value::Double(-0.25),
        Value::Vector3D([1.0, 2.0, 3.0]),
        Value::Vector6D([1.0, 2.0, 3.0, 4.0, 5.0, 6.0]),
        Value::Vector6Int32([-1, 2, -3, 4, -5, 6]),
        Value::Vector6Uint32([1, 2, 3, 4, 5, 6]),
    ];
    for value in values {
        let kind = value.field_type();
        assert_eq!(FieldType::from_name(kind.name()), Ok(kind));
        let mut bytes = Vec::new();
        value.encode(&mut bytes);
        assert_eq!(bytes.len(), kind.size());
        let recipe = Recipe {
            fields: vec![(String::new(), kind)],
        };
        assert_eq!(recipe.decode(&bytes), Ok(vec![value]));
    }
    assert!(FieldType::from_name(NOT_FOUND).is_err());
}

// Fails if a register beyond the last one, or a name that only looks like one, has a type.
#[test]
fn registers_end_where_the_robot_ends_them() {
    for (name, kind) in [
        ("output_bit_register_127", Some(FieldType::Bool)),
        ("output_bit_register_128", None),
        ("output_int_register_0", Some(FieldType::Int32)),
        ("output_int_register_00", None),
        ("output_int_register_+1", None),
        ("output_double_register_47", Some(FieldType::Double)),
        ("output_double_register_48", None),
        ("output_double_register_", None),
        ("input_double_register_24", Some(FieldType::Double)),
        ("actual_q", Some(FieldType::Vector6D)),
        ("actual_Q", None),
    ] {
        assert_eq!(output_type(name), kind, "{name}");
    }
    assert_eq!(input_type("output_int_register_0"), None);
    assert_eq!(input_type("speed_slider_fraction"), Some(FieldType::Double));
}

/// 24 numbers as Python packed them: 0, 1/8, 2/8 ...
fn calibration() -> (KinematicsInfo, Vec<u8>) {
    let eighths = |first: usize| std::array::from_fn(|k| (first + k) as f64 / 8.0);
    let info = KinematicsInfo {
        checksum: [1, 2, 3, 4, 5, 6],
        theta: eighths(0),
        a: eighths(6),
        d: eighths(12),
        alpha: eighths(18),
        status: 7,
    };
    let head = "000000e610000000e105000000010000000200000003000000040000000500000006";
    let mut bytes = hex(head);
    bytes.extend((0..24).flat_map(|k| (f64::from(k) / 8.0).to_be_bytes()));
    bytes.extend([0, 0, 0, 7]);
    (info, bytes)
}

// Fails if the calibration is not found behind other packages and parts, a number has another place, or a broken package
// is taken.
#[test]
fn the_calibration_is_found_in_a_robot_state() {
    let (info, bytes) = calibration();
    assert_eq!(info.encode(), bytes);
    // A message, then a state with a part of four bytes before the calibration.
    let mut received = hex("0000000714aabb");
    let other = hex("000000090011223344");
    received.extend(((bytes.len() + other.len()) as u32).to_be_bytes());
    received.push(16);
    received.extend(&other);
    received.extend(&bytes[5..]);
    let mut take = || take_primary(&mut received).expect("a package").expect("a whole one");
    let (kind, payload) = take();
    assert_eq!(KinematicsInfo::find(kind, &payload), Ok(None));
    let (kind, payload) = take();
    assert_eq!(KinematicsInfo::find(kind, &payload), Ok(Some(info)));
    assert!(KinematicsInfo::find(kind, &payload[..payload.len() - 1]).is_err());
    let nan = KinematicsInfo {
        d: [f64::NAN; 6],
        ..info
    };
    let field = "dh_d";
    assert_eq!(
        KinematicsInfo::find(16, &nan.encode()[5..]),
        Err(WireError::NotFinite { field })
    );
    assert!(take_primary(&mut vec![0xff; 5]).is_err());
}

proptest! {
    // Fails if any bytes make a decoder panic or take more than there is.
    #[test]
    fn hostile_bytes_are_refused(bytes in prop::collection::vec(any::<u8>(), 0..300), kind in 0..8_usize) {
        let mut received = bytes.clone();
        if let Ok(Some((_, payload))) = take_package(&mut received, MAX_REQUEST) {
            prop_assert_eq!(payload.len() + HEADER_SIZE + received.len(), bytes.len());
        }
        // Random bytes are rarely a package, so one of each kind is made of them, and a robot state.
        let size = bytes.len() + HEADER_SIZE;
        let letter = PackageKind::ALL[kind].number() as u8;
        fuzz_decode(&[&[(size >> 8) as u8, size as u8, letter], bytes.as_slice()].concat());
        let (_, mut calibration) = calibration();
        for (place, byte) in calibration[10..].iter_mut().zip(&bytes) {
            *place = *byte;
        }
        fuzz_decode(&calibration);
    }

    // Fails if what a robot side writes is not what a client reads, or a text is cut inside of a letter.
    #[test]
    fn packages_come_back(recipe: u8, values in prop::collection::vec(any::<u8>(), 0..300), message in ".{0,200}") {
        let text = TextMessage { message, source: "é".repeat(200), level: TextLevel::Error };
        for answer in [Answer::Data(recipe, values), Answer::Start(true), Answer::Text(text)] {
            let (kind, payload) = open(&answer.encode());
            let again = Answer::decode(kind, &payload).expect("an answer");
            match (answer, again) {
                (Answer::Text(sent), Answer::Text(read)) => {
                    prop_assert!(sent.message.starts_with(&read.message) && sent.source.starts_with(&read.source));
                    prop_assert!(read.source.len() >= 254);
                }
                (sent, read) => prop_assert_eq!(sent, read),
            }
        }
    }
}
