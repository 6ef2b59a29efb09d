//! Hellos that come once more, that change, and that do not decode.

use std::io::{Read as _, Write as _};
use std::net::TcpListener;

use crate::tcp::conform::tests::Still;
use spherecal_shared::protocol::frame::{self, MAX_FRAME, Message};

use super::*;

fn framed<M: Message>(message: &M) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(message, 0, 0, &mut out).expect("it fits");
    out[..length].to_vec()
}

fn hello(session: u32) -> DriveHello {
    let limits = JointLimits {
        min_rad: -2.9,
        max_rad: 2.9,
        velocity_rad_s: 1.5,
        torque_nm: 100.0,
    };
    DriveHello {
        lock_step: true,
        ..DriveHello::new(session, [limits; 7])
    }
}

/// A drive that sends these bytes and then reads until the other side goes.
fn drive_that_sends(parts: &[Vec<u8>]) -> String {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address").to_string();
    let bytes = parts.concat();
    std::thread::spawn(move || {
        let (mut stream, _) = listener.accept().expect("a connection");
        stream.write_all(&bytes).expect("sent");
        while matches!(stream.read(&mut [0; 1024]), Ok(count) if count > 0) {}
    });
    address
}

fn state(tick: u64) -> Vec<u8> {
    framed(&DriveState {
        session: 5,
        tick,
        ..DriveState::default()
    })
}

// Fails if the hello of the session ends the run when it comes once more, if one that changes something else than
// the number does, or if the hello of another session is passed over or told as another version.
#[test]
fn a_repeated_hello_has_no_effect_and_another_session_ends_the_link() {
    let mut changed = hello(5);
    changed.period_us = 2000;
    let address = drive_that_sends(&[
        framed(&hello(5)),
        framed(&hello(5)),
        state(1),
        framed(&hello(5)),
        framed(&changed),
        state(2),
        framed(&hello(6)),
    ]);
    let mut drive = RemoteDrive::connect(&address).expect("a drive");
    let mut came = DriveState::default();
    for tick in 1..3 {
        drive.exchange(None, &mut came).expect("a state");
        assert_eq!(came.tick, tick);
    }
    assert_eq!(drive.hello().period_us, 1000);
    let said = drive
        .exchange(None, &mut came)
        .expect_err("another session")
        .to_string();
    assert!(said.contains("session 6 in session 5"), "{said}");
}

/// A hello whose variant of the torque sign is none.
#[derive(serde::Serialize, serde::Deserialize, postcard_schema::Schema)]
struct WrongHello {
    protocol: u16,
    session: u32,
    limits: heapless::Vec<JointLimits, 8>,
    period_us: u32,
    compensates_gravity: bool,
    torque_sign: u8,
    lock_step: bool,
    motor_kg_m2: heapless::Vec<f64, 8>,
    latency_us: u32,
    simulated: bool,
}

impl Message for WrongHello {
    const KEY: [u8; 8] = DriveHello::KEY;
}

// Fails if a variant that the hello does not have is told as another version of the protocol, or without its field.
#[test]
fn a_wrong_variant_is_told_with_its_field() {
    let wrong = WrongHello {
        protocol: 2,
        session: 5,
        limits: hello(5).limits,
        period_us: 1000,
        compensates_gravity: false,
        torque_sign: 7,
        lock_step: true,
        motor_kg_m2: heapless::Vec::new(),
        latency_us: 0,
        simulated: true,
    };
    let address = drive_that_sends(&[framed(&wrong)]);
    let said = RemoteDrive::connect(&address).err().expect("refused").to_string();
    assert!(said.contains("torque_sign does not decode"), "{said}");
}

/// An arm in a machine that once holds its drive up, for 30 ms.
struct HeldUp(Still, u64);

impl Drive for HeldUp {
    fn hello(&self) -> &DriveHello {
        self.0.hello()
    }

    fn exchange(&mut self, command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.1 += 1;
        if self.1 == 100 {
            std::thread::sleep(Duration::from_millis(30));
        }
        self.0.exchange(command, state)
    }
}

// Fails if the clock of a drive in real time slips when its machine holds it up: each later state is late then, and a
// controller takes no late state.
#[test]
fn a_drive_in_real_time_keeps_its_clock() {
    let (listener, address) = crate::tcp::listen("0").expect("a free port");
    std::thread::spawn(move || {
        let _ = crate::tcp::DriveServer::new(Box::new(HeldUp(Still::new(), 0)), true).serve(&listener);
    });
    let mut stream = std::net::TcpStream::connect(address).expect("connects");
    let (mut accumulator, mut buffer) = (frame::Accumulator::new(), [0; 1 << 12]);
    let (mut first, mut kept, begun) = (None, false, std::time::Instant::now());
    while !kept {
        assert!(begun.elapsed() < Duration::from_mins(1), "the clock has slipped");
        let count = std::io::Read::read(&mut stream, &mut buffer).expect("states");
        // It leaves a controller that says nothing after 5 s.
        assert!(count != 0, "the clock has slipped");
        for byte in &buffer[..count] {
            accumulator.push(*byte, &mut |bytes| {
                let Ok((header, state)) = bytes.and_then(frame::decode::<DriveState>) else {
                    return;
                };
                // The first state has the time of a greeting.
                if state.tick < 2 {
                    return;
                }
                let behind_us = header.time_us as i64 - 1000 * state.tick as i64;
                let first = *first.get_or_insert(behind_us);
                kept |= state.tick > 110 && behind_us - first < 15_000;
            });
        }
    }
}
