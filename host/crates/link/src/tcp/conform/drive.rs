//! The sentences of `docs/drive-link.md` that a drive can be asked for.

use std::time::Instant;

use spherecal_shared::protocol::drive::{DriveCommand, DriveHello, DriveState, NO_SESSION};
use spherecal_shared::protocol::host::{Command, Downlink};

use super::probe::{OWED, Probe, QUIET, damaged, framed, hex};
use super::{Finding, Sentence, ask};
use crate::check_hello;

/// Periods of a sentence about several of them.
const PERIODS: u64 = 20;
/// How far a joint may move while its brakes are closed, in rad: a hundred steps of a usual encoder.
const STILL_RAD: f64 = 1e-3;

/// Each sentence of the document that a drive can be asked for.
const SENTENCES: [Sentence; 14] = [
    ("The drive sends a hello, its handshake.", |address| {
        Probe::connect(address)?.expect::<DriveHello>("the hello").map(|_| ())
    }),
    ("The fields of the hello are in their ranges.", |address| {
        let hello: DriveHello = Probe::connect(address)?.expect("the hello")?;
        check_hello(&hello, hello.limits.len()).map_err(|error| error.to_string())
    }),
    (
        "After the hello the drive sends its first state without waiting.",
        |address| Talk::begin(address).map(|_| ()),
    ),
    (
        "A state has the session of the hello, and finite values for every joint.",
        |address| {
            let talk = Talk::begin(address)?;
            talk.check(&talk.state)
        },
    ),
    (
        "In lock-step the drive waits for the command of that tick; in real time it sends a state every period.",
        |address| {
            let mut talk = Talk::begin(address)?;
            if talk.hello.lock_step {
                return match talk.probe.next(QUIET) {
                    None => Ok(()),
                    Some(came) => Err(format!("{} without a command", came.words())),
                };
            }
            (0..PERIODS).try_for_each(|_| talk.state_without_command().map(|_| ()))
        },
    ),
    ("The tick grows by one each period.", |address| {
        let mut talk = Talk::begin(address)?;
        for _ in 0..PERIODS {
            let before = talk.state.tick;
            talk.step()?;
            if talk.state.tick != before + 1 {
                return Err(format!("tick {} after tick {before}", talk.state.tick));
            }
        }
        Ok(())
    }),
    (
        "A command with another tick answers an older state and is ignored.",
        |address| {
            let mut talk = Talk::begin(address)?;
            let tick = talk.state.tick;
            let other = DriveCommand {
                tick: tick.wrapping_add(1000),
                ..talk.command()
            };
            if !talk.hello.lock_step {
                // A state comes anyway: the drive must go on.
                talk.probe.send(&DriveCommand { tick: 0, ..other })?;
                return talk.step();
            }
            talk.probe.send(&other)?;
            if let Some(came) = talk.probe.next(QUIET) {
                return Err(format!("{} after a command of tick {}", came.words(), other.tick));
            }
            talk.step()
        },
    ),
    (
        "A command with session 0 is answered with the hello of the session, and the states go on.",
        |address| {
            let mut talk = Talk::begin(address)?;
            let asks = DriveCommand {
                session: NO_SESSION,
                ..talk.command()
            };
            talk.probe.send(&asks)?;
            let begun = Instant::now();
            let mut again = None;
            while again.is_none() && begun.elapsed() < OWED {
                let Some(came) = talk.probe.next(QUIET) else { continue };
                match (came.read::<DriveHello>(), came.read::<DriveState>()) {
                    (Some(hello), _) => again = Some(hello),
                    (_, Some(state)) => talk.state = state,
                    _ => return Err(came.words()),
                }
            }
            let hello = again.ok_or("no hello came")?;
            if hello.session != talk.hello.session {
                return Err(format!(
                    "the hello has session {}, the first one {}",
                    hello.session, talk.hello.session
                ));
            }
            // A drive in lock-step may have taken the command for its answer or not.
            if let Some(state) = talk.probe.next(QUIET).and_then(|came| came.read::<DriveState>()) {
                talk.state = state;
            }
            talk.step()
        },
    ),
    ("A damaged frame is counted and ignored.", |address| {
        let mut talk = Talk::begin(address)?;
        let bytes = damaged(framed(&talk.command(), 7)?);
        talk.probe.write(&bytes)?;
        talk.step().map_err(|seen| format!("after {}: {seen}", hex(&bytes)))
    }),
    (
        "A command with enable 0 closes the brakes: the arm stands still.",
        |address| {
            let mut talk = Talk::begin(address)?;
            talk.step()?;
            let before = talk.state.q.clone();
            for _ in 0..PERIODS {
                talk.step()?;
            }
            for ((was, is), joint) in before.iter().zip(&talk.state.q).zip(1..) {
                if (was - is).abs() > STILL_RAD {
                    return Err(format!("joint {joint} moved from {was} to {is} rad"));
                }
            }
            Ok(())
        },
    ),
    (
        "A command with a NaN is refused as a whole, and the drive goes on.",
        |address| {
            let mut talk = Talk::begin(address)?;
            let mut bad = talk.command();
            bad.tau.iter_mut().for_each(|tau| *tau = f64::NAN);
            talk.probe.send(&bad)?;
            // A drive in lock-step may take the command's tick for an answer or not.
            if talk.hello.lock_step
                && let Some(state) = talk.probe.next(QUIET).and_then(|came| came.read::<DriveState>())
            {
                talk.state = state;
            }
            talk.step()?;
            talk.check(&talk.state)
        },
    ),
    ("A message with an unknown key closes the connection.", |address| {
        let mut talk = Talk::begin(address)?;
        let unknown = Downlink {
            session: [0; 4],
            sequence: 0,
            start_us: 0,
            command: Command::KeepAlive,
        };
        talk.probe.send(&unknown)?;
        talk.probe.expect_close()
    }),
    (
        "Bytes without a valid frame for 5 s or 1 MiB close the connection.",
        |address| Talk::begin(address)?.probe.expect_close_after_noise(),
    ),
    ("Far more messages than one a period close the connection.", |address| {
        let mut talk = Talk::begin(address)?;
        let old = DriveCommand {
            tick: talk.state.tick.wrapping_add(1_000_000),
            ..talk.command()
        };
        talk.probe.expect_close_after(&framed(&old, 1)?.repeat(100), 200)
    }),
];

/// Asks the drive at `HOST:PORT` for each sentence. It never enables the drive.
///
/// The drive must serve one connection after the other, as the document demands.
pub fn of_drive(address: &str) -> Vec<Finding> {
    ask("docs/drive-link.md", &SENTENCES, address)
}

/// A connection after the hello and the first state.
struct Talk {
    probe: Probe,
    hello: DriveHello,
    state: DriveState,
}

impl Talk {
    fn begin(address: &str) -> Result<Self, String> {
        let mut probe = Probe::connect(address)?;
        let hello = probe.expect("the hello")?;
        let state = probe.expect("the first state")?;
        Ok(Self { probe, hello, state })
    }

    /// The command of the present tick, which closes the brakes.
    fn command(&self) -> DriveCommand {
        DriveCommand {
            session: self.hello.session,
            tick: self.state.tick,
            tau: self.state.q.iter().map(|_| 0.0).collect(),
            enable: false,
            ..DriveCommand::default()
        }
    }

    fn state_without_command(&mut self) -> Result<&DriveState, String> {
        self.state = self.probe.expect("a state")?;
        Ok(&self.state)
    }

    /// Answers the present state, and takes the next one.
    fn step(&mut self) -> Result<(), String> {
        let command = self.command();
        self.probe.send(&command)?;
        self.state_without_command().map(|_| ())
    }

    fn check(&self, state: &DriveState) -> Result<(), String> {
        if state.session != self.hello.session {
            return Err(format!(
                "session {}, the hello has {}",
                state.session, self.hello.session
            ));
        }
        for (name, values) in [("q", &state.q), ("dq", &state.dq), ("tau", &state.tau)] {
            if values.len() != self.hello.limits.len() {
                return Err(format!(
                    "{} values of {name} for {} joints",
                    values.len(),
                    self.hello.limits.len()
                ));
            }
            if let Some(value) = values.iter().find(|value| !value.is_finite()) {
                return Err(format!("{name} has {value}"));
            }
        }
        Ok(())
    }
}
