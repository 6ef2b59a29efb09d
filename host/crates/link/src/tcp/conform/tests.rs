//! What is said of the project's own drive server and controller, and of drives that do one thing wrong.

use std::io::{Read as _, Write as _};
use std::net::{TcpListener, TcpStream};
use std::thread;
use std::time::Duration;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState};
use spherecal_shared::protocol::frame::{self, Accumulator, FrameError, MAX_FRAME, Message};
use spherecal_shared::robot::JointLimits;

use super::*;
use crate::tcp::{DriveServer, controller_server, listen};
use crate::{Drive, LinkError, LocalDevice, controller_in_process};

const LIMITS: JointLimits = JointLimits {
    min_rad: -2.9,
    max_rad: 2.9,
    velocity_rad_s: 1.5,
    torque_nm: 100.0,
};

/// An arm of seven joints that stands still.
pub(in crate::tcp) struct Still {
    hello: DriveHello,
    tick: u64,
}

impl Still {
    pub(in crate::tcp) fn new() -> Self {
        Self {
            hello: DriveHello {
                lock_step: true,
                simulated: true,
                ..DriveHello::new(5, [LIMITS; 7])
            },
            tick: 0,
        }
    }

    pub(in crate::tcp) fn in_real_time() -> Self {
        let mut this = Self::new();
        this.hello.lock_step = false;
        this
    }
}

impl Drive for Still {
    fn hello(&self) -> &DriveHello {
        &self.hello
    }

    fn exchange(&mut self, _command: Option<&DriveCommand>, state: &mut DriveState) -> Result<(), LinkError> {
        self.tick += 1;
        *state = DriveState {
            session: 5,
            tick: self.tick,
            q: [0.1; 7].into_iter().collect(),
            dq: [0.0; 7].into_iter().collect(),
            tau: [0.0; 7].into_iter().collect(),
            ..DriveState::default()
        };
        Ok(())
    }
}

fn failed(findings: &[Finding]) -> Vec<String> {
    let fails = findings.iter().filter(|finding| !finding.holds());
    fails
        .map(|finding| format!("{} {}", finding.sentence, finding.seen.as_deref().unwrap_or_default()))
        .collect()
}

// Fails if the project's own plant, in lock-step or in real time, or its own controller does not do what the documents
// say.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_the_own_plant_and_controller_conform() {
    for real_time in [false, true] {
        let (listener, address) = listen("0").expect("a free port");
        thread::spawn(move || {
            let mut server = DriveServer::new(Box::new(Still::new()), real_time);
            loop {
                let _ = server.serve(&listener);
            }
        });
        let findings = of_drive(&address.to_string());
        assert_eq!(failed(&findings), [""; 0], "real time: {real_time}");
    }
    let (listener, address) = listen("0").expect("a free port");
    thread::spawn(move || {
        let controller = controller_in_process(7).expect("built");
        let mut cell = LocalDevice::new(controller, Box::new(Still::new()), 7).expect("it fits");
        let _ = controller_server::serve_hosts(&mut cell, &listener, false, &mut |_| ());
    });
    let findings = of_controller(&address.to_string());
    assert_eq!(failed(&findings), [""; 0]);
}

/// What a drive does wrong.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Wrong {
    Nothing,
    Protocol,
    ThreeMotors,
    NoFirstState,
    OtherSession,
    DoesNotWait,
    SkipsTicks,
    TakesAnyTick,
    NoSecondHello,
    ClosesForDamage,
    Drifts,
    KeepsAnything,
}

fn framed<M: Message>(message: &M) -> Vec<u8> {
    let mut out = [0; MAX_FRAME];
    let length = frame::encode(message, 0, 0, &mut out).expect("it fits");
    out[..length].to_vec()
}

/// One controller of a lock-step drive.
fn serve(stream: &mut TcpStream, wrong: Wrong) -> std::io::Result<()> {
    let mut hello = Still::new().hello;
    match wrong {
        Wrong::Protocol => hello.protocol = 9,
        Wrong::ThreeMotors => hello.motor_kg_m2 = [0.5; 3].into_iter().collect(),
        _ => {}
    }
    stream.write_all(&framed(&hello))?;
    let mut state = DriveState {
        session: if wrong == Wrong::OtherSession { 6 } else { 5 },
        tick: 1,
        q: [0.1; 7].into_iter().collect(),
        dq: [0.0; 7].into_iter().collect(),
        tau: [0.0; 7].into_iter().collect(),
        ..DriveState::default()
    };
    if wrong != Wrong::NoFirstState {
        stream.write_all(&framed(&state))?;
    }
    if wrong == Wrong::DoesNotWait {
        state.tick += 1;
        stream.write_all(&framed(&state))?;
    }
    let (mut accumulator, mut buffer) = (Accumulator::new(), [0; 1 << 14]);
    let (mut bytes, mut old) = (0usize, 0u32);
    loop {
        let count = stream.read(&mut buffer)?;
        if count == 0 {
            return Ok(());
        }
        bytes += count;
        let mut frames = Vec::new();
        for byte in &buffer[..count] {
            accumulator.push(*byte, &mut |frame| {
                frames.push(frame.and_then(frame::decode::<DriveCommand>));
            });
        }
        for frame in frames {
            let command = match frame {
                Ok((_, command)) => command,
                Err(FrameError::Key) if wrong == Wrong::KeepsAnything => continue,
                Err(FrameError::Key) => return Ok(()),
                Err(_) if wrong == Wrong::ClosesForDamage => return Ok(()),
                Err(_) => continue,
            };
            bytes = 0;
            if command.session == 0 && wrong != Wrong::NoSecondHello {
                stream.write_all(&framed(&hello))?;
            }
            if command.tick != state.tick && wrong != Wrong::TakesAnyTick {
                old += 1;
                if old > 1000 && wrong != Wrong::KeepsAnything {
                    return Ok(());
                }
                continue;
            }
            state.tick += if wrong == Wrong::SkipsTicks { 2 } else { 1 };
            if wrong == Wrong::Drifts {
                state.q.iter_mut().for_each(|q| *q += 0.001);
            }
            stream.write_all(&framed(&state))?;
        }
        if bytes > 1 << 20 && wrong != Wrong::KeepsAnything {
            return Ok(());
        }
    }
}

fn findings_of(wrong: Wrong) -> Vec<String> {
    let listener = TcpListener::bind("127.0.0.1:0").expect("a free port");
    let address = listener.local_addr().expect("an address").to_string();
    thread::spawn(move || {
        for mut stream in listener.incoming().flatten() {
            stream.set_read_timeout(Some(Duration::from_secs(30))).expect("set");
            let _ = serve(&mut stream, wrong);
        }
    });
    failed(&of_drive(&address))
}

// Fails if a drive that does what the document says is found at fault, or if one that does one thing wrong is not, or
// not for that.
#[test]
#[ignore = "timed: the gate runs it"]
fn timed_wrong_drives_are_told_by_their_sentence() {
    let cases = [
        (Wrong::Protocol, "fields of the hello"),
        (Wrong::ThreeMotors, "3 inertias of motors"),
        (Wrong::NoFirstState, "first state without waiting"),
        (Wrong::OtherSession, "session of the hello"),
        (Wrong::DoesNotWait, "waits for the command"),
        (Wrong::SkipsTicks, "tick grows by one"),
        (Wrong::TakesAnyTick, "another tick"),
        (Wrong::NoSecondHello, "no hello came"),
        (Wrong::ClosesForDamage, "damaged frame"),
        (Wrong::Drifts, "arm stands still"),
        (Wrong::KeepsAnything, "unknown key"),
    ];
    let good = thread::spawn(|| findings_of(Wrong::Nothing));
    let threads = cases.map(|(wrong, words)| (wrong, words, thread::spawn(move || findings_of(wrong))));
    assert_eq!(good.join().expect("no panic"), [""; 0]);
    for (wrong, words, findings) in threads {
        let findings = findings.join().expect("no panic");
        assert!(
            findings.iter().any(|seen| seen.contains(words)),
            "{wrong:?}: {findings:?}"
        );
    }
}
