//! The rules of the robot side for names, owners and rates, seen by clients that send what they like.

use std::io::{Read as _, Write as _};
use std::time::Duration;

use spherecal_cyclic::Stream;
use spherecal_cyclic::testing::World;
use spherecal_ur::robot::RobotSide;
use spherecal_ur::wire::*;

use crate::common::robot;

/// A client that sends requests as the test wants.
struct Raw {
    stream: Box<dyn Stream>,
    received: Vec<u8>,
}

impl Raw {
    /// Connects and agrees on the protocol.
    fn new(world: &World, side: &RobotSide) -> Self {
        let stream = world
            .machine()
            .connect(side.address(), Duration::from_secs(1))
            .expect("a connection");
        let received = Vec::new();
        let mut raw = Self { stream, received };
        assert_eq!(
            raw.ask(&Request::ProtocolVersion(PROTOCOL)),
            Some(Answer::ProtocolVersion(true))
        );
        raw
    }

    fn send(&mut self, request: &Request) {
        self.stream.write_all(&request.encode()).expect("sent");
    }

    /// The next package within 100 ms.
    fn next(&mut self) -> Option<Answer> {
        self.stream.set_wait(Some(Duration::from_millis(100))).expect("a wait");
        loop {
            if let Some((kind, payload)) = take_package(&mut self.received, MAX_ANSWER).expect("packages") {
                return Some(Answer::decode(kind, &payload).expect("an answer"));
            }
            let mut part = [0; 4096];
            match self.stream.read(&mut part) {
                Ok(count) if count > 0 => self.received.extend(&part[..count]),
                _ => return None,
            }
        }
    }

    fn ask(&mut self, request: &Request) -> Option<Answer> {
        self.send(request);
        self.next()
    }

    fn inputs(&mut self, names: &[&str]) -> Setup {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        match self.ask(&Request::SetupInputs { names }) {
            Some(Answer::SetupInputs(setup)) => setup,
            other => panic!("{other:?}"),
        }
    }

    fn outputs(&mut self, rate_hz: f64, names: &[&str]) -> Setup {
        let names = names.iter().map(|name| (*name).to_owned()).collect();
        match self.ask(&Request::SetupOutputs { rate_hz, names }) {
            Some(Answer::SetupOutputs(setup)) => setup,
            other => panic!("{other:?}"),
        }
    }
}

// Fails if a second client gets a register that has an owner, an unknown name is accepted, a refused setup keeps a register,
// or a register stays taken when its owner has left.
#[test]
fn a_register_has_one_owner() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let (mut first, mut second) = (Raw::new(&world, &side), Raw::new(&world, &side));
    let setup = first.inputs(&["input_int_register_24", "input_double_register_25"]);
    assert_eq!(
        (setup.recipe, setup.types),
        (1, vec!["INT32".to_owned(), "DOUBLE".to_owned()])
    );
    // Its own register in a further recipe is allowed: ur-rtde does so.
    assert_eq!(first.inputs(&["input_int_register_24"]).recipe, 2);
    let setup = second.inputs(&["input_int_register_30", "input_int_register_24"]);
    assert_eq!(
        (setup.recipe, setup.types),
        (0, vec!["INT32".to_owned(), IN_USE.to_owned()])
    );
    let setup = second.inputs(&["input_int_register_48"]);
    assert_eq!((setup.recipe, setup.types), (0, vec![NOT_FOUND.to_owned()]));
    // The refused setup took nothing.
    assert_eq!(first.inputs(&["input_int_register_30"]).recipe, 3);
    drop(first);
    world.machine().sleep(Duration::from_millis(10));
    assert_eq!(second.inputs(&["input_int_register_24"]).recipe, 1);
}

// Fails if an input that a client wrote cannot be read back by another, or a package of a wrong size is taken for one.
#[test]
fn inputs_can_be_read_back() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let (mut writer, mut reader) = (Raw::new(&world, &side), Raw::new(&world, &side));
    writer.inputs(&["input_int_register_24"]);
    writer.send(&Request::Data(1, 77_i32.to_be_bytes().to_vec()));
    assert_eq!(
        reader
            .outputs(500.0, &["input_int_register_24", "output_int_register_0"])
            .recipe,
        1
    );
    assert_eq!(reader.ask(&Request::Start), Some(Answer::Start(true)));
    assert_eq!(reader.next(), Some(Answer::Data(1, vec![0, 0, 0, 77, 0, 0, 0, 0])));
    writer.send(&Request::Data(1, vec![0]));
    assert!(matches!(writer.next(), Some(Answer::Text(_))));
    assert_eq!(writer.next(), None);
    assert_eq!(side.statistics().broken, 1);
}

// Fails if an unknown output is answered with a stream, or a CB3 claims what only e-Series robots have.
#[test]
fn unknown_outputs_are_not_found() {
    let world = World::new(0);
    for (series, found) in [(Series::Cb3, NOT_FOUND), (Series::ESeries, "VECTOR6D")] {
        let (side, _arm) = robot(&world, series);
        let mut client = Raw::new(&world, &side);
        let setup = client.outputs(125.0, &["actual_q", "no_such_field"]);
        assert_eq!(
            (setup.recipe, setup.types),
            (0, vec!["VECTOR6D".to_owned(), NOT_FOUND.to_owned()])
        );
        assert_eq!(client.ask(&Request::Start), Some(Answer::Start(false)));
        assert_eq!(client.outputs(125.0, &["ft_raw_wrench"]).types, [found]);
        let long = "x".repeat(MAX_NAMES + 1);
        assert_eq!(client.outputs(125.0, &[&long]), Setup::default());
    }
}

// Fails if a data package leaves before the answer to start, the rate is not the one that was asked for, or pause does not
// stop the stream.
#[test]
fn the_stream_begins_after_its_answer_at_its_rate() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    for (rate, expected) in [(125.0, 125), (500.0, 500), (9000.0, 500), (0.0, 1)] {
        let mut client = Raw::new(&world, &side);
        client.outputs(rate, &["timestamp"]);
        assert_eq!(client.ask(&Request::Start), Some(Answer::Start(true)));
        let before = side.statistics().packages;
        world.machine().sleep(Duration::from_secs(1));
        let sent = side.statistics().packages - before;
        assert!(sent.abs_diff(expected) <= 1, "{rate} Hz: {sent}");
        client.send(&Request::Pause);
        while client.next() != Some(Answer::Pause(true)) {}
        assert_eq!(client.next(), None);
    }
}

// Fails if a client that skips the protocol, or sends bytes that are no package, is served.
#[test]
fn clients_of_another_protocol_are_told() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let mut client = Raw::new(&world, &side);
    assert_eq!(
        client.ask(&Request::ProtocolVersion(1)),
        Some(Answer::ProtocolVersion(false))
    );
    assert!(
        matches!(client.ask(&Request::Start), Some(Answer::Text(message)) if message.message.contains("protocol 2"))
    );
    client.stream.write_all(b"GET / HTTP/1.1\r\n").expect("sent");
    assert!(matches!(client.next(), Some(Answer::Text(_))));
    assert_eq!(client.next(), None);
    assert_eq!((side.statistics().broken, side.statistics().clients), (1, 0));
}

// Fails if a ninth client is served, or keeps the others from being served.
#[test]
fn eight_clients_are_served() {
    let world = World::new(0);
    let (side, _arm) = robot(&world, Series::ESeries);
    let mut clients: Vec<Raw> = (0..8).map(|_| Raw::new(&world, &side)).collect();
    let mut ninth = world
        .machine()
        .connect(side.address(), Duration::from_secs(1))
        .expect("a connection");
    world.machine().sleep(Duration::from_millis(10));
    assert_eq!(ninth.read(&mut [0]).expect("an end"), 0);
    for client in &mut clients {
        assert!(matches!(
            client.ask(&Request::ControllerVersion),
            Some(Answer::ControllerVersion(_))
        ));
    }
}
