//! The controller's end of the host link: bytes to commands, events to bytes.
//!
//! It sees the control path as a [`CommandPort`]: directly in one thread
//! ([`Node`](crate::Node)), or behind queues on a board, where the link has a
//! lower priority than the control task ([`app`](crate::app)).
//!
//! A command is carried out once, however often it comes. Events are sent in
//! order, and again until the host acknowledges them. Telemetry, replies and
//! statistics are sent once; a host that misses a reply repeats its command.
//!
//! The link obeys only the host of the last handshake. Any other host gets the
//! banner of the present session. It thereby learns that the controller was
//! restarted or that another host has taken over.

use embassy_time::{Duration, Instant};
use heapless::{Deque, String};
use spherecal_shared::protocol::frame::{self, Accumulator, FrameError, LinkCounters, SequenceWatch};
use spherecal_shared::protocol::host::{Banner, Command, Downlink, Refusal, SessionId};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};

use crate::Report;

mod port;
mod send;

pub use port::{CommandOutcome, CommandPort};

/// Most events that are sent but not acknowledged.
const PENDING: usize = 8;
/// Most replies that wait to be sent.
const REPLIES: usize = 4;
/// Time after which an unacknowledged event is sent again, unless the board sets
/// another. A host that keeps up acknowledges within two periods.
const RESEND: Duration = Duration::from_millis(5);
/// Bytes of one telemetry sample on the wire, its share of the frame included: measured by
/// a test.
const SAMPLE_BYTES: u32 = 200;
/// Share of the wire's bandwidth that telemetry may take, in percent. The rest is for events,
/// their repeats and replies.
const TELEMETRY_PERCENT: u32 = 60;

/// An event that the host has not acknowledged.
#[derive(Clone, Debug)]
struct Pending {
    /// Session in which it happened.
    session: SessionId,
    /// Its number.
    event: u32,
    report: Report,
    /// When it was last sent; `None` if it was not.
    sent: Option<Instant>,
}

/// What answers the host's messages: sent once, without a number.
#[derive(Clone, Copy, Debug)]
enum Reply {
    /// [`Event::Banner`], with the control period in µs.
    Banner { period_us: u32 },
    /// [`Event::Held`].
    Held { sequence: u32 },
    /// [`Event::Reply`].
    Outcome(CommandOutcome),
}

/// The answer to the last command, kept for its repeats. `None` while the control
/// path has not given the outcome.
#[derive(Clone, Copy, Debug)]
struct LastAnswer {
    sequence: u32,
    result: Option<Result<(), Refusal>>,
}

/// The controller's end of the host link.
#[derive(Clone, Debug)]
pub struct HostLink {
    accumulator: Accumulator,
    watch: SequenceWatch,
    counters: LinkCounters,
    build: String<24>,
    joints: u8,
    resend: Duration,
    samples_per_s: u32,
    drive: LinkCounters,
    session: Option<SessionId>,
    /// The session before. A late repeat of its handshake does not restore it.
    previous: Option<SessionId>,
    /// Whether a host has spoken yet.
    host_known: bool,
    answered: Option<LastAnswer>,
    replies: Deque<Reply, REPLIES>,
    pending: Deque<Pending, PENDING>,
    next_event: u32,
    sequence: u32,
    last_statistics: Option<Instant>,
}

impl HostLink {
    /// A link of a controller with `joints` joints. The banner states `build`, cut
    /// to 24 bytes.
    pub fn new(build: &str, joints: usize) -> Self {
        let mut text = String::new();
        for c in build.chars() {
            if text.push(c).is_err() {
                break;
            }
        }
        Self {
            accumulator: Accumulator::new(),
            watch: SequenceWatch::default(),
            counters: LinkCounters::default(),
            build: text,
            joints: u8::try_from(joints).unwrap_or(u8::MAX),
            resend: RESEND,
            samples_per_s: u32::MAX,
            drive: LinkCounters::new(),
            session: None,
            previous: None,
            host_known: false,
            answered: None,
            replies: Deque::new(),
            pending: Deque::new(),
            next_event: 1,
            sequence: 0,
            last_statistics: None,
        }
    }

    /// Sets the time after which an unacknowledged event is sent again: for wires
    /// on which a frame takes long.
    pub fn resending_after(mut self, resend: Duration) -> Self {
        self.resend = resend;
        self
    }

    /// Sets the bandwidth of the wire, in bytes per second: telemetry takes at most 60 % of
    /// it. Without this call all telemetry is sent.
    pub fn with_bandwidth(mut self, bytes_per_s: u32) -> Self {
        self.samples_per_s = (bytes_per_s / 100).saturating_mul(TELEMETRY_PERCENT) / SAMPLE_BYTES;
        self
    }

    /// Telemetry samples that the wire has room for, per second.
    pub fn samples_per_s(&self) -> u32 {
        self.samples_per_s
    }

    /// Takes the counters of the drive link, for the statistics.
    pub fn set_drive_counters(&mut self, drive: LinkCounters) {
        self.drive = drive;
    }

    /// Counters of this end of the link.
    pub fn counters(&self) -> &LinkCounters {
        &self.counters
    }

    /// Takes bytes from the host and passes complete commands to the control path.
    pub fn receive(&mut self, bytes: &[u8], port: &mut impl CommandPort) {
        for byte in bytes {
            let mut received = None;
            self.accumulator.push(*byte, &mut |frame| {
                received = Some(frame.and_then(frame::decode::<Downlink>));
            });
            match received {
                None => {}
                Some(Ok((header, downlink))) => {
                    self.watch.record(header.sequence, &mut self.counters);
                    self.take(downlink, port);
                }
                Some(Err(error)) => {
                    self.counters.crc_errors = self.counters.crc_errors.saturating_add(1);
                    if error == FrameError::Key {
                        // The host has another schema. It cannot be understood, but it can
                        // learn which controller this is.
                        self.reply_banner(port.period_us());
                    }
                }
            }
        }
    }

    fn take(&mut self, downlink: Downlink, port: &mut impl CommandPort) {
        let Downlink {
            session,
            sequence,
            start_us,
            command,
        } = downlink;
        let hello = matches!(command, Command::Hello);
        if hello && self.session != Some(session) && self.previous != Some(session) {
            // The events until now belong to the session that ends.
            self.take_events(port);
            self.previous = self.session.replace(session);
            self.answered = None;
            self.replies.clear();
        } else if self.session != Some(session) {
            self.reply_banner(port.period_us());
            return;
        }
        port.host_heard();
        match command {
            Command::KeepAlive => return,
            Command::Acknowledge { event } => {
                for _ in 0..self.pending.len() {
                    let Some(entry) = self.pending.pop_front() else { break };
                    if entry.event != event {
                        let _ = self.pending.push_back(entry);
                    }
                }
                return;
            }
            _ => {}
        }
        self.collect_outcomes(port);
        if hello {
            self.reply_banner(port.period_us());
        }
        if let Some(last) = self.answered {
            // A repeat. If it is the last command, it is answered again. An older
            // one was answered before the last one was sent.
            let overtaken = sequence.wrapping_sub(last.sequence) >= 1 << 31;
            if overtaken || sequence == last.sequence {
                self.counters.duplicates = self.counters.duplicates.saturating_add(1);
                match last.result {
                    _ if overtaken => {}
                    Some(result) => self.reply(Reply::Outcome(CommandOutcome { sequence, result })),
                    None => self.reply(Reply::Held { sequence }),
                }
                return;
            }
        }
        if port.queue_command(sequence, start_us, command) {
            self.answered = Some(LastAnswer { sequence, result: None });
            if start_us > 0 {
                self.reply(Reply::Held { sequence });
            }
        } else {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    /// Makes replies of the outcomes that the control path has given.
    fn collect_outcomes(&mut self, port: &mut impl CommandPort) {
        while !self.replies.is_full()
            && let Some(outcome) = port.command_outcome()
        {
            if let Some(answered) = self.answered.as_mut().filter(|a| a.sequence == outcome.sequence) {
                answered.result = Some(outcome.result);
            }
            self.reply(Reply::Outcome(outcome));
        }
    }

    fn reply_banner(&mut self, period_us: u32) {
        self.host_known = true;
        self.reply(Reply::Banner { period_us });
    }

    fn session(&self) -> SessionId {
        self.session.unwrap_or_default()
    }

    fn reply(&mut self, reply: Reply) {
        if self.replies.push_back(reply).is_err() {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    fn banner(&self, period_us: u32) -> Banner {
        let mut version = String::new();
        let _ = version.push_str(env!("CARGO_PKG_VERSION"));
        Banner {
            protocol: PROTOCOL_VERSION,
            schema: SCHEMA,
            version,
            build: self.build.clone(),
            joints: self.joints,
            period_us,
            first_event: self.pending.front().map_or(self.next_event, |p| p.event),
        }
    }
}

#[cfg(test)]
mod tests;
