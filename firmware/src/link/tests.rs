//! The controller's end of the host link, with a host that loses, repeats and
//! damages frames.

use embassy_time::Instant;
use spherecal_shared::protocol::SCHEMA;
use spherecal_shared::protocol::drive::DriveState;
use spherecal_shared::protocol::frame::{self, Accumulator, MAX_FRAME};
use spherecal_shared::protocol::host::{Command, Downlink, Event, Refusal, Uplink};
use std::vec::Vec;

use crate::Node;

/// A link, its controller, and the host's side of the wire.
struct Wire {
    node: Node<7>,
    sequence: u32,
    now_ms: u64,
}

impl Wire {
    fn new() -> Self {
        Self {
            node: Node::new("a build whose name is much too long"),
            sequence: 0,
            now_ms: 0,
        }
    }

    fn encode(&mut self, sequence: u32, command: Command) -> Vec<u8> {
        let mut bytes = [0u8; MAX_FRAME];
        let length =
            frame::encode(&Downlink::at_once(sequence, command), self.sequence, 0, &mut bytes).expect("it fits");
        self.sequence += 1;
        bytes[..length].to_vec()
    }

    fn send(&mut self, sequence: u32, command: Command) {
        let bytes = self.encode(sequence, command);
        self.node.receive(&bytes);
    }

    /// Advances the time and returns what was sent, without statistics.
    fn hear(&mut self, after_ms: u64) -> Vec<Uplink> {
        self.now_ms += after_ms;
        let mut bytes = [0u8; 4 * MAX_FRAME];
        let length = self.node.transmit(Instant::from_millis(self.now_ms), &mut bytes);
        let mut heard = Vec::new();
        let mut accumulator = Accumulator::new();
        for byte in &bytes[..length] {
            accumulator.push(*byte, &mut |frame| {
                let (_, uplink) = frame.and_then(frame::decode::<Uplink>).expect("a whole frame");
                if !matches!(uplink.body, Event::Statistics(_)) {
                    heard.push(uplink);
                }
            });
        }
        heard
    }
}

fn events(heard: &[Uplink]) -> Vec<u32> {
    heard.iter().filter(|u| u.event > 0).map(|u| u.event).collect()
}

#[test]
fn nothing_is_said_before_the_host_greets() {
    let mut wire = Wire::new();
    wire.node.controller().record_missed(50);
    assert!(wire.hear(10).is_empty());
    wire.send(1, Command::Hello);
    let heard = wire.hear(1);
    assert!(matches!(&heard[0].body, Event::Banner(b) if b.joints == 7 && b.build.len() == 24));
    assert!(matches!(
        heard[1].body,
        Event::Reply {
            sequence: 1,
            result: Ok(())
        }
    ));
}

/// Fails if an event is forgotten before it is acknowledged, or kept after that.
#[test]
fn events_come_again_until_they_are_acknowledged() {
    let mut wire = Wire::new();
    wire.send(1, Command::Hello);
    wire.node.controller().record_missed(50);
    // A fault and the change of phase that follows.
    assert_eq!(events(&wire.hear(1)), [1, 2]);
    assert!(events(&wire.hear(3)).is_empty(), "not before its time");
    assert_eq!(events(&wire.hear(3)), [1, 2]);
    wire.send(0, Command::Acknowledge { event: 2 });
    assert_eq!(events(&wire.hear(6)), [1], "only what was acknowledged is dropped");
    wire.send(0, Command::Acknowledge { event: 1 });
    assert!(events(&wire.hear(6)).is_empty());
    assert!(wire.node.link().counters().resent >= 3);
}

/// Fails if a repeated command is carried out again or gets another answer.
#[test]
fn a_repeated_command_is_answered_again_and_not_obeyed_twice() {
    let mut wire = Wire::new();
    wire.send(1, Command::Hello);
    wire.hear(1);
    wire.node.controller().record_missed(50);
    wire.send(2, Command::ClearFault);
    wire.node.controller().record_missed(50);
    wire.send(2, Command::ClearFault);
    let heard = wire.hear(1);
    let replies = heard
        .iter()
        .filter(|u| {
            matches!(
                u.body,
                Event::Reply {
                    sequence: 2,
                    result: Ok(())
                }
            )
        })
        .count();
    assert_eq!(replies, 2);
    assert_eq!(wire.node.link().counters().duplicates, 1);
    wire.send(3, Command::Stop);
    let heard = wire.hear(1);
    let refused = Event::Reply {
        sequence: 3,
        result: Err(Refusal::FaultPending),
    };
    assert!(
        heard.iter().any(|u| u.body == refused),
        "the second fault was not cleared"
    );
}

#[test]
fn spoilt_frames_are_counted_and_skipped() {
    let mut wire = Wire::new();
    let mut bytes = wire.encode(1, Command::Hello);
    bytes[3] ^= 0x10;
    bytes.extend(wire.encode(1, Command::Hello));
    wire.node.receive(&bytes);
    assert_eq!(wire.node.link().counters().crc_errors, 1);
    assert_eq!(wire.hear(1).len(), 2, "banner and reply for the good one");
}

/// Fails if a host of another schema gets no answer.
#[test]
fn a_foreign_host_is_told_who_is_here() {
    let mut wire = Wire::new();
    let mut bytes = [0u8; MAX_FRAME];
    let length = frame::encode(&DriveState::default(), 0, 0, &mut bytes).expect("it fits");
    wire.node.receive(&bytes[..length]);
    let heard = wire.hear(1);
    assert!(
        matches!(&heard[..], [Uplink { event: 0, body: Event::Banner(b), .. }] if b.schema == SCHEMA),
        "{heard:?}"
    );
}

/// Fails if a small buffer gets part of a frame, or if an event is lost.
#[test]
fn a_small_buffer_gets_whole_frames_only() {
    let mut wire = Wire::new();
    wire.send(1, Command::Hello);
    wire.node.controller().record_missed(50);
    let mut seen = Vec::new();
    for _ in 0..20 {
        wire.now_ms += 1;
        let mut bytes = [0u8; 100];
        let length = wire.node.transmit(Instant::from_millis(wire.now_ms), &mut bytes);
        let mut accumulator = Accumulator::new();
        for byte in &bytes[..length] {
            accumulator.push(*byte, &mut |frame| {
                let (_, uplink) = frame.and_then(frame::decode::<Uplink>).expect("whole frames only");
                if uplink.event > 0 {
                    seen.push(uplink.event);
                }
            });
        }
    }
    // They are sent again later, and none is left out.
    seen.truncate(4);
    assert_eq!(seen, [1, 2, 1, 2]);
}

// Fails if a command of another session than that of the last handshake is obeyed
// or answered as if it were: its host gets the banner of the present session.
#[test]
fn a_host_of_another_session_is_not_obeyed() {
    let mut wire = Wire::new();
    wire.send(1, Command::Hello);
    wire.hear(1);
    let robot = Command::Robot(spherecal_shared::robot::iiwa7().driven().expect("seven joints"));
    let mut foreign = Downlink::at_once(2, robot.clone());
    foreign.session[0] ^= 1;
    let mut bytes = [0u8; MAX_FRAME];
    let length = frame::encode(&foreign, 1, 0, &mut bytes).expect("it fits");
    wire.node.receive(&bytes[..length]);
    let heard = wire.hear(1);
    assert!(
        matches!(
            &heard[..],
            [Uplink {
                body: Event::Banner(_),
                ..
            }]
        ),
        "{heard:?}"
    );
    let tool = spherecal_shared::robot::iiwa7_tool();
    let procedure = spherecal_shared::procedure::Procedure::default();
    let configure = Command::Configure { tool, procedure };
    // Without the foreign robot there is none.
    wire.send(2, configure);
    let refused = wire.hear(1).into_iter().any(|uplink| {
        let result = Err(Refusal::NotConfigured);
        uplink.body == Event::Reply { sequence: 2, result }
    });
    assert!(refused);
}
