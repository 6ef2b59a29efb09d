//! What each fuzz target does with its bytes, and what must hold whatever they
//! are. A panic is a finding; so is a hang (libFuzzer's own time limit).
//!
//! Frames carry a checksum, which no fuzzer guesses: behind [`frames`] the bytes
//! are the bodies of messages, and the targets frame them properly.

#![forbid(unsafe_code)]

use std::cell::RefCell;
use std::path::PathBuf;

use embassy_time::Instant;
use spherecal::input::{Labels, read_csv, read_plate};
use spherecal::job::Config;
use spherecal::link::{HostEndpoint, Timing};
use spherecal::robots;
use spherecal::store::{Store, recover};
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
            let mut copies = [frame.to_vec(), frame.to_vec(), frame.to_vec(), frame.to_vec(), frame.to_vec()];
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

fn state(tick: u64, q: &[f64; 7]) -> DriveState {
    DriveState {
        tick,
        q: q.iter().copied().collect(),
        dq: [0.0; 7].into_iter().collect(),
        tau: [0.0; 7].into_iter().collect(),
        status: DriveStatus::Ready,
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
                let configure = Command::Configure {
                    tool: iiwa7_tool(),
                    procedure: Procedure::default(),
                };
                let mut up = vec![0; 8 * MAX_FRAME];
                for (command, tick) in [Command::Hello, Command::Robot(iiwa7()), configure].into_iter().zip(0..) {
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
        let Some((wait, body)) = body.split_first() else { continue };
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
        let Some((kind, body)) = body.split_first() else { continue };
        let Ok(mut state) = postcard::from_bytes::<DriveState>(body) else { continue };
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

/// Any messages of a controller to the host's end: each event once, in order.
pub fn events(data: &[u8]) {
    let mut endpoint = HostEndpoint::new(Timing::default());
    endpoint.send(Command::Hello);
    let mut down = Vec::new();
    let _ = endpoint.transmit(0, &mut down);
    let (mut arrived, mut last, mut now) = (Vec::new(), None, 0);
    for (body, k) in pieces(data).take(64).zip(1..) {
        now += 1000;
        let up = match postcard::from_bytes::<Uplink>(body) {
            Ok(mut message) => {
                if message.session[0] % 4 != 0 {
                    message.session = endpoint.session();
                }
                framed(&message, k)
            }
            Err(_) => body.to_vec(),
        };
        let stored: Result<(), ()> = endpoint.receive(&up, &mut arrived, |batch| {
            for arrival in batch {
                let next = last.map_or(arrival.event, |last: u32| last.wrapping_add(1).max(1));
                assert_eq!(arrival.event, next, "out of order");
                last = Some(arrival.event);
            }
            Ok(())
        });
        assert!(stored.is_ok());
        down.clear();
        let _ = endpoint.transmit(now, &mut down);
    }
}

/// Any table of poses, and any certificate of a plate.
pub fn csv(data: &[u8]) {
    let joints = data.first().map_or(7, |b| if b % 2 == 0 { 6 } else { 7 });
    let mut places = Labels::default();
    if let Ok(table) = read_csv("fuzz.csv", data, joints, Some("note"), &mut places) {
        for row in &table.rows {
            assert_eq!(row.q.len(), joints);
            assert!(row.q.iter().all(|q| q.is_finite()), "{row:?}");
        }
    }
    if let Ok(text) = std::str::from_utf8(data) {
        let _ = read_plate("fuzz.toml", text);
    }
}

/// Any configuration: refused, or one that can be written and read again.
pub fn config(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    let Ok(config) = Config::parse("fuzz.toml", text) else { return };
    if config.check().is_ok() {
        let again = config.to_toml().expect("what was read can be written");
        let read = Config::parse("again.toml", &again).expect("what was written can be read");
        assert!(read.check().is_ok());
    }
}

/// Any robot description, URDF or TOML: refused, or a robot that passes its check.
pub fn robots(data: &[u8]) {
    let Ok(text) = std::str::from_utf8(data) else { return };
    for model in [
        robots::load_urdf_text("fuzz.urdf", text, None),
        robots::toml_file::load("fuzz.toml", text),
    ]
    .into_iter()
    .flatten()
    {
        assert!(model.robot.check().is_ok());
    }
}

/// A folder that the process has to itself.
fn folder() -> PathBuf {
    // In memory where there is such a place: the fuzzer writes thousands of files a second.
    let base = PathBuf::from("/dev/shm");
    let base = if base.is_dir() { base } else { std::env::temp_dir() };
    base.join(format!("spherecal-fuzz-{}", std::process::id()))
}

/// Any file as a database: refused, or read to its end; and what can be
/// recovered of it is a database.
pub fn database(data: &[u8]) {
    let folder = folder();
    std::fs::create_dir_all(&folder).expect("a folder");
    let (file, saved) = (folder.join("fuzz.db"), folder.join("saved.db"));
    for old in [&file, &saved] {
        for end in ["", "-wal", "-shm", "-journal"] {
            let mut name = old.clone().into_os_string();
            name.push(end);
            let _ = std::fs::remove_file(name);
        }
    }
    std::fs::write(&file, data).expect("written");
    if let Ok(mut store) = Store::open(&file) {
        read_all(&mut store);
    }
    // Dearer: only now and then.
    if data.last().is_some_and(|byte| byte % 8 == 1) && recover(&file, &saved).is_ok() {
        read_all(&mut Store::open(&saved).expect("what was recovered can be opened"));
    }
}

fn read_all(store: &mut Store) {
    for info in store.runs().unwrap_or_default() {
        let _ = spherecal::job::read(store, &info);
        let _ = store.recordings(info.run);
        let _ = store.phases(info.run);
        let _ = store.greetings(info.run);
        let _ = store.result(info.run, "summary");
    }
}
