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
use heapless::{Deque, String, Vec};
use spherecal_shared::protocol::frame::{self, Accumulator, FrameError, LinkCounters, MAX_FRAME, SequenceWatch};
use spherecal_shared::protocol::host::{
    Banner, Command, Downlink, Event, MAX_BATCH, Refusal, Sample, SessionId, Statistics, Uplink,
};
use spherecal_shared::protocol::{PROTOCOL_VERSION, SCHEMA};

/// Most events that are sent but not acknowledged.
const PENDING: usize = 8;
/// Most replies that wait to be sent.
const REPLIES: usize = 4;
/// Time after which an unacknowledged event is sent again, unless the board sets
/// another. A host that keeps up acknowledges within two periods.
const RESEND: Duration = Duration::from_millis(5);
/// Interval of the statistics.
const STATISTICS: Duration = Duration::from_millis(1000);

/// The outcome of a command: accepted, or refused and why.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CommandOutcome {
    /// Number of the command.
    pub sequence: u32,
    /// Whether the command was accepted.
    pub result: Result<(), Refusal>,
}

/// The control path, as the host link sees it.
pub trait CommandPort {
    /// Records that something has come from the host.
    fn host_heard(&mut self);

    /// Takes a command that starts at `start_us` (device time, in µs). `false` if
    /// there is no room: the host sends it again.
    fn queue_command(&mut self, sequence: u32, start_us: u64, command: Command) -> bool;

    /// The oldest outcome of a command that was not fetched yet.
    fn command_outcome(&mut self) -> Option<CommandOutcome>;

    /// The next event for the host.
    fn next_event(&mut self) -> Option<Event>;

    /// Number of telemetry samples that wait.
    fn samples_waiting(&self) -> usize;

    /// The next telemetry sample.
    fn next_sample(&mut self) -> Option<Sample>;

    /// The control period, in µs.
    fn period_us(&self) -> u32;

    /// Counters of the control path; the link adds its own.
    fn statistics(&self) -> Statistics;
}

/// An event that the host has not acknowledged.
#[derive(Clone, Debug)]
struct Pending {
    uplink: Uplink,
    /// When it was last sent; `None` if it was not.
    sent: Option<Instant>,
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
    session: Option<SessionId>,
    /// The session before. A late repeat of its handshake does not restore it.
    previous: Option<SessionId>,
    /// Whether a host has spoken yet.
    host_known: bool,
    answered: Option<LastAnswer>,
    replies: Deque<Event, REPLIES>,
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
                    if entry.uplink.event != event {
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
                    Some(result) => self.reply(Event::Reply { sequence, result }),
                    None => self.reply(Event::Held { sequence }),
                }
                return;
            }
        }
        if port.queue_command(sequence, start_us, command) {
            self.answered = Some(LastAnswer { sequence, result: None });
            if start_us > 0 {
                self.reply(Event::Held { sequence });
            }
        } else {
            self.counters.overflow = self.counters.overflow.saturating_add(1);
        }
    }

    /// Makes replies of the outcomes that the control path has given.
    fn collect_outcomes(&mut self, port: &mut impl CommandPort) {
        while !self.replies.is_full()
            && let Some(CommandOutcome { sequence, result }) = port.command_outcome()
        {
            if let Some(answered) = self.answered.as_mut().filter(|a| a.sequence == sequence) {
                answered.result = Some(result);
            }
            self.reply(Event::Reply { sequence, result });
        }
    }

    fn reply_banner(&mut self, period_us: u32) {
        self.host_known = true;
        let banner = self.banner(period_us);
        self.reply(Event::Banner(banner));
    }

    fn session(&self) -> SessionId {
        self.session.unwrap_or_default()
    }

    fn reply(&mut self, event: Event) {
        if self.replies.push_back(event).is_err() {
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
            first_event: self.pending.front().map_or(self.next_event, |p| p.uplink.event),
        }
    }

    /// Writes what is to be sent to `out`, in complete frames, and returns the
    /// number of bytes. Sends nothing before a host has spoken.
    pub fn transmit(&mut self, now: Instant, out: &mut [u8], port: &mut impl CommandPort) -> usize {
        self.collect_outcomes(port);
        if !self.host_known {
            return 0;
        }
        let mut used = 0;
        while let Some(event) = self.replies.front() {
            let uplink = Uplink {
                session: self.session(),
                event: 0,
                body: event.clone(),
            };
            let Some(length) = self.write(&uplink, now, out, used) else {
                return used;
            };
            used += length;
            self.replies.pop_front();
        }
        self.take_events(port);
        used = self.send_pending(now, out, used);
        used = self.send_samples(now, out, used, port);
        let due = self
            .last_statistics
            .is_none_or(|last| now.saturating_duration_since(last) >= STATISTICS);
        if due {
            let mut statistics = port.statistics();
            let overflow = statistics.link.overflow;
            statistics.link = self.counters;
            statistics.link.overflow = statistics.link.overflow.saturating_add(overflow);
            if let Some(length) = self.write(
                &Uplink {
                    session: self.session(),
                    event: 0,
                    body: Event::Statistics(statistics),
                },
                now,
                out,
                used,
            ) {
                used += length;
                self.last_statistics = Some(now);
            }
        }
        used
    }

    /// Numbers new events while there is room among the unacknowledged ones.
    fn take_events(&mut self, port: &mut impl CommandPort) {
        while !self.pending.is_full() {
            let Some(body) = port.next_event() else { break };
            let uplink = Uplink {
                session: self.session(),
                event: self.next_event,
                body,
            };
            self.next_event = self.next_event.wrapping_add(1).max(1);
            let _ = self.pending.push_back(Pending { uplink, sent: None });
        }
    }

    fn send_pending(&mut self, now: Instant, out: &mut [u8], mut used: usize) -> usize {
        for _ in 0..self.pending.len() {
            // Takes and returns each entry, so that no borrow of the queue lasts.
            let Some(mut entry) = self.pending.pop_front() else {
                break;
            };
            let due = entry
                .sent
                .is_none_or(|sent| now.saturating_duration_since(sent) >= self.resend);
            if due && let Some(length) = self.write(&entry.uplink, now, out, used) {
                used += length;
                if entry.sent.is_some() {
                    self.counters.resent = self.counters.resent.saturating_add(1);
                }
                entry.sent = Some(now);
            }
            let _ = self.pending.push_back(entry);
        }
        used
    }

    fn send_samples(&mut self, now: Instant, out: &mut [u8], mut used: usize, port: &mut impl CommandPort) -> usize {
        while port.samples_waiting() >= MAX_BATCH {
            // Starts only if a complete batch certainly fits.
            if out.len().saturating_sub(used) < MAX_FRAME {
                return used;
            }
            let mut batch = Vec::new();
            while !batch.is_full() {
                let Some(sample) = port.next_sample() else { break };
                let _ = batch.push(sample);
            }
            match self.write(
                &Uplink {
                    session: self.session(),
                    event: 0,
                    body: Event::Telemetry(batch),
                },
                now,
                out,
                used,
            ) {
                Some(length) => used += length,
                None => return used,
            }
        }
        used
    }

    /// Encodes one frame after the first `used` bytes of `out`.
    fn write(&mut self, uplink: &Uplink, now: Instant, out: &mut [u8], used: usize) -> Option<usize> {
        let rest = out.get_mut(used..)?;
        let length = frame::encode(uplink, self.sequence, now.as_micros(), rest).ok()?;
        self.sequence = self.sequence.wrapping_add(1);
        Some(length)
    }
}

#[cfg(test)]
mod tests;
