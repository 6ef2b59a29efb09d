//! The sentences of `docs/nothing-lost.md` that a controller can be asked for over its host link.

use std::time::{Duration, Instant};

use spherecal_shared::protocol::drive::DriveHello;
use spherecal_shared::protocol::host::{Command, Downlink, Event, SessionId, Uplink};

use super::probe::{OWED, Probe, QUIET, damaged, framed, hex};
use super::{Finding, Sentence, ask};
use crate::check_hello;

/// Turns of a sentence about several of them.
const TURNS: usize = 20;
/// The session of this host, and one of another.
const SESSION: SessionId = [0x5e, 0x71, 0x0c, 0x9a];
const OTHER: SessionId = [0x11, 0x22, 0x33, 0x44];

/// Each sentence that a controller can be asked for.
const SENTENCES: [Sentence; 8] = [
    ("The server first sends the drive's hello frame.", |address| {
        let hello: DriveHello = Probe::connect(address)?.expect("the hello")?;
        check_hello(&hello, hello.limits.len()).map_err(|error| error.to_string())
    }),
    (
        "A session begins with a handshake: the controller answers with its banner.",
        |address| Host::begin(address).map(|_| ()),
    ),
    ("Each side ends its part of every period with an end mark.", |address| {
        let mut host = Host::begin(address)?;
        (0..TURNS).try_for_each(|_| host.turn(&[]))
    }),
    (
        "Every command has a number; the controller carries out each number once.",
        |address| {
            let mut host = Host::begin(address)?;
            let first = host.reply(&command(SESSION, 2))?;
            let again = host.reply(&command(SESSION, 2))?;
            if first == again {
                Ok(())
            } else {
                Err(format!("{first} first, {again} for the repeat"))
            }
        },
    ),
    ("A command of another session changes nothing.", |address| {
        let mut host = Host::begin(address)?;
        match host.reply(&command(OTHER, 3)) {
            Err(_) => host.reply(&command(SESSION, 2)).map(|_| ()),
            Ok(answer) => Err(format!("it is answered: {answer}")),
        }
    }),
    ("A damaged frame is counted and ignored.", |address| {
        let mut host = Host::begin(address)?;
        let bytes = damaged(framed(&command(SESSION, 2), 9)?);
        host.turn(&bytes)
            .map_err(|seen| format!("after {}: {seen}", hex(&bytes)))?;
        host.reply(&command(SESSION, 2)).map(|_| ())
    }),
    (
        "A host that sends bytes and no valid frame for 5 s or for 1 MiB is disconnected.",
        |address| Host::begin(address)?.probe.expect_close_after_noise(),
    ),
    ("The controller then serves the next host.", |address| {
        drop(Host::begin(address)?);
        Host::begin(address).map(|_| ())
    }),
];

/// Asks the controller whose host link is at `HOST:PORT` for each sentence. It stops what the controller does, and gives
/// no other command.
pub fn of_controller(address: &str) -> Vec<Finding> {
    ask("docs/nothing-lost.md", &SENTENCES, address)
}

/// A command that starts at once: to stop.
fn command(session: SessionId, sequence: u32) -> Downlink {
    Downlink {
        session,
        sequence,
        start_us: 0,
        command: Command::Stop,
    }
}

/// A connection after the handshake.
struct Host {
    probe: Probe,
    /// Messages that have come since the last question.
    came: Vec<Uplink>,
}

impl Host {
    fn begin(address: &str) -> Result<Self, String> {
        let mut probe = Probe::connect(address)?;
        probe.expect::<DriveHello>("the hello")?;
        probe.raw.clear();
        let mut host = Self {
            probe,
            came: Vec::new(),
        };
        let hello = Downlink {
            command: Command::Hello,
            ..command(SESSION, 1)
        };
        let begun = Instant::now();
        while begun.elapsed() < OWED {
            host.turn(&framed(&hello, 0)?)?;
            let ours = |up: &Uplink| up.session == SESSION && matches!(up.body, Event::Banner(_));
            if host.came.iter().any(ours) {
                return Ok(host);
            }
        }
        Err(format!("no banner within {} s", OWED.as_secs()))
    }

    /// One turn: these bytes and an end mark down, everything until an end mark up.
    fn turn(&mut self, down: &[u8]) -> Result<(), String> {
        self.probe.write(down)?;
        self.probe.write(&[0])?;
        let begun = Instant::now();
        loop {
            while let Some(came) = self.probe.next(Duration::ZERO) {
                self.came.extend(came.read::<Uplink>());
            }
            // A zero byte that ends no frame.
            let raw = &self.probe.raw;
            let mark = (0..raw.len()).find(|at| raw[*at] == 0 && (*at == 0 || raw[*at - 1] == 0));
            if let Some(at) = mark {
                self.probe.raw.drain(..=at);
                return Ok(());
            }
            if begun.elapsed() > OWED {
                return Err(format!("no end mark within {} s: {}", OWED.as_secs(), hex(raw)));
            }
            self.probe.read(QUIET);
        }
    }

    /// The answer to a command, as it is printed.
    fn reply(&mut self, command: &Downlink) -> Result<String, String> {
        self.came.clear();
        self.turn(&framed(command, command.sequence)?)?;
        for _ in 0..TURNS {
            let answer = self.came.iter().find_map(|up| match &up.body {
                Event::Reply { sequence, result } if *sequence == command.sequence => Some(format!("{result:?}")),
                _ => None,
            });
            if let Some(answer) = answer {
                return Ok(answer);
            }
            self.turn(&[])?;
        }
        Err(format!("no answer to command {} in {TURNS} turns", command.sequence))
    }
}
