//! What each fuzz target does with its bytes, and what must hold whatever they
//! are. A panic is a finding; so is a hang (libFuzzer's own time limit).
//!
//! Frames carry a checksum, which no fuzzer guesses: behind [`frames`] the bytes
//! are the bodies of messages, and the targets frame them properly.

#![forbid(unsafe_code)]

#[cfg(feature = "host")]
mod host;

use std::cell::RefCell;

use embassy_time::Instant;
#[cfg(feature = "host")]
pub use host::{JOINTS, bag, config, csv, database, events, robots};
use spherecal_firmware::Node;
use spherecal_shared::Joints;
use spherecal_shared::procedure::Procedure;
use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, DriveStatus};
use spherecal_shared::protocol::frame::{self, Accumulator, MAX_FRAME, Message};
use spherecal_shared::protocol::host::{Command, Downlink, Uplink};
use spherecal_shared::robot::{iiwa7, iiwa7_tool};

/// Elbow up, tool straight down, far from every limit, in rad.
const HOME: [f64; 7] = [0.0, 0.7, 0.0, -1.2, 0.0, 1.241_592_653_589_793, 0.0];

fn framed<M: Message>(message: &M, sequence: u32) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(message, sequence, 0, &mut out).unwrap_or(0);
    out[..length].to_vec()
}

/// Splits `data` into pieces, each behind its length in two bytes.
fn pieces(mut data: &[u8]) -> impl Iterator<Item = &[u8]> {
    std::iter::from_fn(move || {
        let (length, rest) = data.split_first_chunk::<2>()?;
        let length = usize::from(u16::from_le_bytes(*length)).min(rest.len());
        let (piece, rest) = rest.split_at(length);
        data = rest;
        Some(piece)
    })
}

/// Joins what [`pieces`] splits.
pub fn joined(pieces: &[Vec<u8>]) -> Vec<u8> {
    let mut out = Vec::new();
    for piece in pieces {
        out.extend(u16::try_from(piece.len()).unwrap_or(u16::MAX).to_le_bytes());
        out.extend(piece);
    }
    out
}

/// Any bytes to the decoders of both links: frames or typed errors.
pub fn frames(data: &[u8]) {
    let mut accumulator = Accumulator::new();
    for &byte in data {
        accumulator.push(byte, &mut |frame| {
            let Ok(frame) = frame else { return };
            let mut copies = [
                frame.to_vec(),
                frame.to_vec(),
                frame.to_vec(),
                frame.to_vec(),
                frame.to_vec(),
            ];
            let [a, b, c, d, e] = &mut copies;
            let _ = frame::decode::<DriveHello>(a);
            let _ = frame::decode::<DriveState>(b);
            let _ = frame::decode::<DriveCommand>(c);
            let _ = frame::decode::<Downlink>(d);
            let _ = frame::decode::<Uplink>(e);
        });
    }
    // The bodies, past the checksum.
    let _ = postcard::from_bytes::<DriveHello>(data);
    let _ = postcard::from_bytes::<DriveState>(data);
    let _ = postcard::from_bytes::<DriveCommand>(data);
    let _ = postcard::from_bytes::<Downlink>(data);
    let _ = postcard::from_bytes::<Uplink>(data);
}

/// Any bytes to the decoders of Franka's interface: messages or typed errors, and what is decoded is encoded alike. The
/// robot's model, too.
pub fn fci(data: &[u8]) {
    spherecal_fci::wire::fuzz_decode(data);
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = spherecal_fci::robot::ArmLimits::from_urdf(text);
    }
}

/// The same for KUKA's interface.
pub fn fri(data: &[u8]) {
    spherecal_fri::wire::fuzz_decode(data);
}

/// The same for the interfaces of Universal Robots.
pub fn ur(data: &[u8]) {
    spherecal_ur::wire::fuzz_decode(data);
}

fn state(tick: u64, q: &[f64; 7]) -> DriveState {
    DriveState {
        session: 1,
        tick,
        q: q.iter().copied().collect(),
        dq: [0.0; 7].into_iter().collect(),
        tau: [0.0; 7].into_iter().collect(),
        status: DriveStatus::Ready,
    }
}

fn hello() -> DriveHello {
    DriveHello {
        lock_step: true,
        ..DriveHello::new(1, iiwa7().joints.iter().map(|joint| joint.limits))
    }
}

/// A controller that has been greeted and configured, and its next tick.
fn controller() -> (Node<7>, u64) {
    thread_local! {
        static READY: RefCell<Option<Node<7>>> = const { RefCell::new(None) };
    }
    let ready = READY.with_borrow_mut(|ready| {
        ready
            .get_or_insert_with(|| {
                let mut node = Node::<7>::new("fuzzed");
                node.controller().connect(&hello()).expect("a drive that fits");
                let configure = Command::Configure {
                    tool: iiwa7_tool(),
                    procedure: Procedure::default(),
                };
                let mut up = vec![0; 8 * MAX_FRAME];
                for (command, tick) in [Command::Hello, Command::Robot(iiwa7().driven().expect("seven joints")), configure]
                    .into_iter()
                    .zip(0..)
                {
                    let down = framed(&Downlink::at_once(tick + 1, command), tick);
                    let tick = u64::from(tick);
                    node.exchange(Instant::from_millis(tick), &state(tick, &HOME), &down, &mut up);
                }
                node
            })
            .clone()
    });
    (ready, 3)
}

/// What must hold of every torque command.
fn check(command: &DriveCommand) {
    let limits = iiwa7();
    assert_eq!(command.tau.len(), 7);
    for (tau, joint) in command.tau.iter().zip(&limits.joints) {
        assert!(tau.is_finite(), "{command:?}");
        // Another robot may have been sent, with other limits.
        assert!(tau.abs() <= joint.limits.torque_nm.max(1e6), "{command:?}");
    }
}

/// Any commands to a configured controller: typed refusals, finite torques.
pub fn commands(data: &[u8]) {
    let (mut node, mut tick) = controller();
    let mut up = vec![0; 8 * MAX_FRAME];
    for (body, k) in pieces(data).take(12).zip(1..) {
        // The first byte says how long the arm goes on before the next one.
        let Some((wait, body)) = body.split_first() else {
            continue;
        };
        let down = match postcard::from_bytes::<Downlink>(body) {
            Ok(mut message) => {
                // Else most would be taken for repeats, or for another host's.
                message.session = Default::default();
                message.sequence = 3 + k;
                framed(&message, k)
            }
            Err(_) => body.to_vec(),
        };
        for step in 0..1 + u64::from(wait % 8) {
            let down = if step == 0 { down.as_slice() } else { &[] };
            let (command, _) = node.exchange(Instant::from_millis(tick), &state(tick, &HOME), down, &mut up);
            check(&command);
            tick += 1;
        }
    }
}

/// Any drive states to a configured controller: finite torques, whatever comes.
pub fn drive(data: &[u8]) {
    let (mut node, mut tick) = controller();
    let mut up = vec![0; 8 * MAX_FRAME];
    for body in pieces(data).take(24) {
        // The first byte says whether the numbers of the ticks are put right.
        let Some((kind, body)) = body.split_first() else {
            continue;
        };
        let Ok(mut state) = postcard::from_bytes::<DriveState>(body) else {
            continue;
        };
        if kind % 4 != 0 {
            state.tick = tick;
        }
        if kind % 8 == 1 && state.q.len() == 7 {
            // Near home, so that more than the first limit is met.
            state.q = HOME
                .iter()
                .zip(&state.q)
                .map(|(home, off)| if off.abs() < 0.1 { home + off } else { *home })
                .collect::<Joints>();
        }
        let (command, _) = node.exchange(Instant::from_millis(tick), &state, &[], &mut up);
        check(&command);
        tick += 1;
    }
}
